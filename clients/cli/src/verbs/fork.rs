//! `fork`: a copy of a swarm, at its current or an earlier step.

use jostle_proto::Reply;
use jostle_proto::verbs::{CreateResult, ForkArgs};

use crate::arguments::ForkArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::verbs::create::describe_copy;

pub async fn fork(context: &Context, arguments: &ForkArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let swarm = &arguments.name;
    let args = ForkArgs {
        name: arguments.copy.clone(),
        step: arguments.at_step,
    };
    let answer = client
        .command(swarm, "fork", &args, &arguments.sender)
        .await?;
    output.reply(&answer, |reply: &Reply<CreateResult>| {
        describe_copy("forked", &format!(" from {swarm}"), reply)
    })
}
