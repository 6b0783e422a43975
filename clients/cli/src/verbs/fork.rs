//! `fork`: a copy of a swarm, at its current or an earlier step.

use std::time::Duration;

use jostle_proto::Reply;
use jostle_proto::verbs::{CreateResult, ForkArgs};

use crate::arguments::ForkArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::interrupt;
use crate::verbs::create::describe_copy;

pub async fn fork(context: &Context, arguments: &ForkArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let swarm = &arguments.name;
    let args = ForkArgs {
        name: arguments.copy.clone(),
        step: arguments.at_step,
    };
    let copy = &args.name;
    let left = format!(
        "the daemon may still fork {swarm}: `jostle status {copy}` shows it, `jostle delete {copy}` \
         removes it"
    );
    let forked = client.command(swarm, "fork", &args, &arguments.sender);
    let answer = interrupt::after_grace(Duration::ZERO, &left, forked).await?;
    output.reply(&answer, |reply: &Reply<CreateResult>| {
        describe_copy("forked", &format!(" from {swarm}"), reply)
    })
}
