//! `doctor`: whether everything works from here and, if not, what to do.

mod checks;
mod report;

use std::time::Instant;

use jostle_proto::keys;

use self::report::{Check, Report};
use crate::arguments::GlobalArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;

/// Checks all there is to check and prints what was found.
///
/// # Errors
///
/// [`Failure::Unwell`] when something is wrong.
pub async fn doctor(output: Output, global: GlobalArguments) -> Result<(), Failure> {
    let endpoint = Bus::endpoint_for(&global)?;
    let began = Instant::now();
    let mut report = Report::new(endpoint.clone());
    match Bus::open(global).await {
        Ok(bus) => {
            let took = format::millis(began.elapsed().as_secs_f64());
            report.add(Check::well(
                "connection",
                format!("zenoh answers at {endpoint}, opened in {took}"),
            ));
            examine(&bus, &mut report).await;
            bus.close().await;
        }
        Err(failure) => report.add(Check::failed("connection", &failure)),
    }
    report.print(output)
}

/// Everything for which there is a connection.
async fn examine(bus: &Bus, report: &mut Report) {
    // Published things take their time; they are waited for beside all the rest.
    let listening = checks::Listening::begin(bus).await;
    let presence = bus.nodes().await.unwrap_or_default();
    let node = match checks::find_node(bus, &presence).await {
        Ok(node) => node,
        Err(failure) => {
            report.add(Check::failed("daemon", &failure));
            return;
        }
    };
    let hello = checks::hello(bus, &node).await;
    report.add(checks::daemon(bus, &node, &hello).await);
    if let Ok((hello, asked)) = &hello {
        report.add(checks::versions(hello));
        report.add(checks::clock(hello, *asked));
    }
    report.add(checks::latency(bus, &node).await);
    let metrics = checks::metrics(bus, &node).await;
    report.add(checks::health(&metrics));
    report.add(checks::recordings(&metrics));
    report.add(checks::recording_space(&metrics));
    let (check, swarms) = checks::swarms(bus, &node).await;
    report.add(check);
    let swarm = swarms.first().map(|swarm| swarm.swarm.as_str());
    report.add(checks::gets(bus, swarm).await);
    let node_cmd = keys::node_cmd(bus.prefix(), &node, checks::UNKNOWN_VERB);
    report.add(checks::commands_to_node(bus, &node, &node_cmd).await);
    report.add(checks::commands_to_swarm(bus, swarm).await);
    report.add(listening.check(!swarms.is_empty()).await);
    report.add(checks::liveliness(bus, &node, &presence, swarm).await);
}
