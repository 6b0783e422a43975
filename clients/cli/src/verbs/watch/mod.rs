//! `watch`: a full-screen view of all swarms on a terminal, otherwise lines about one swarm.

mod live;
mod stream;

use jostle_proto::{OrderSample, Reply, Status};

pub use self::live::restore as restore_terminal;
use crate::arguments::WatchArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::stdout;

pub async fn watch(
    context: &Context,
    arguments: &WatchArguments,
    timeout: f64,
) -> Result<(), Failure> {
    // Scripts need lines.
    let wants_lines = context.output.json || arguments.frames || arguments.count.is_some();
    if stdout::is_terminal() && !wants_lines {
        return live::show(&context.client, arguments).await;
    }
    match arguments.name.as_deref() {
        Some(swarm) => stream::stream(context, swarm, arguments, timeout).await,
        None => Err(Failure::argument(
            "NAME",
            "is required without a terminal: lines show one swarm; `jostle list` lists the swarms",
        )),
    }
}

/// Converts a status to a sample.
fn sample_of(reply: Reply<Status>, frame: u64) -> OrderSample {
    let status = reply.result;
    OrderSample {
        swarm: reply.swarm,
        epoch: reply.epoch,
        frame,
        step: reply.step,
        time: reply.time,
        phase: reply.phase,
        n: status.n,
        informed: status.informed,
        order: status.order,
        certificate: status.certificate,
        rate: status.rate,
        real_time_factor: status.real_time_factor,
        measures: None,
    }
}
