//! `watch`: swarms live. On a terminal a view of them all that can steer them, elsewhere lines
//! about one.

mod live;
mod stream;

use std::sync::Arc;

use jostle_proto::{OrderSample, Reply, Status};

pub use self::live::restore as give_back_the_terminal;
use crate::arguments::WatchArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::output::{self, Output};

/// Shows live how swarms are doing.
///
/// # Errors
///
/// Why there is nothing to show, or nothing any more.
pub async fn watch(
    bus: &Arc<Bus>,
    output: Output,
    arguments: &WatchArguments,
) -> Result<(), Failure> {
    // What counts lines or takes them apart wants lines.
    let wants_lines = output.json || arguments.frames || arguments.count.is_some();
    if output::is_terminal() && !wants_lines {
        return live::show(bus, arguments).await;
    }
    match arguments.name.as_deref() {
        Some(swarm) => stream::stream(bus, output, swarm, arguments).await,
        None => Err(Failure::Argument {
            argument: "NAME".into(),
            problem: "lines are about one swarm, so name it; `jostle list` shows what there is"
                .into(),
        }),
    }
}

/// What a status tells, as a sample.
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
    }
}
