//! `delete`: deletes swarms by name, by pattern, or by what holds for them.

use jostle_proto::Reply;
use jostle_proto::verbs::{DeleteArgs, EmptyResult};

use crate::arguments::SwarmsArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::verbs::which;

/// Deletes swarms; if one cannot be deleted, continues with the others.
pub async fn delete(context: &Context, arguments: &SwarmsArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let sending = &arguments.sending;
    let is_late = [sending.at_step, sending.expect_epoch, sending.expect_step];
    if client.named_node().is_some() && is_late.iter().any(Option::is_some) {
        return Err(Failure::argument(
            "--node",
            "deletes a daemon's swarm at once: leave out --at-step and --expect-…",
        ));
    }
    let swarms = which::chosen(context, "delete", arguments).await?;
    let delete = async |swarm: &str| {
        let answer = match client.named_node() {
            Some(_) => client.discard(swarm, &sending.sender).await?,
            None => {
                let args = DeleteArgs {};
                client.command(swarm, "delete", &args, sending).await?
            }
        };
        output.outcome(&answer, "delete", |reply: &Reply<EmptyResult>| {
            let (swarm, time) = (&reply.swarm, format::time(reply.time));
            format!("deleted {swarm} at step {}, time {time}", reply.step)
        })
    };
    which::each(*output, "delete", &swarms, delete).await
}
