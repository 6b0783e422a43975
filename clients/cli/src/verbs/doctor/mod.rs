//! `doctor`: checks the connection to a daemon and prints remedies.

mod checks;
mod report;

use std::time::{Duration, Instant};

use jostle_client::{Client, ConnectOptions};

use self::report::{Check, Report};
use crate::arguments::GlobalArguments;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;

/// Executes all checks and prints the report.
pub async fn doctor(output: Output, global: GlobalArguments) -> Result<(), Failure> {
    // It reports the present state, and waits for no daemon.
    let options = ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::from(&global)
    };
    let endpoint = options.resolved_endpoint()?;
    let began = Instant::now();
    let mut report = Report::new(endpoint.clone());
    match Client::connect(options).await {
        Ok(client) => {
            let took = format::millis(began.elapsed().as_secs_f64());
            let text = format!("zenoh answers at {endpoint}, opened in {took}");
            report.add("connection", Ok(Check::passed(text)));
            examine(&client, &mut report).await;
            client.close().await;
        }
        Err(error) => report.add("connection", Err(error.into())),
    }
    report.print(output)
}

/// The checks that need a connection.
async fn examine(client: &Client, report: &mut Report) {
    // Messages arrive while the other checks run.
    let listening = checks::Listening::begin(client).await;
    let nodes = client.nodes().await.unwrap_or_default();
    let node = match checks::find_node(client, &nodes).await {
        Ok(node) => node,
        Err(failure) => return report.add("daemon", Err(failure)),
    };
    match checks::hello(client, &node).await {
        Ok((hello, exchange)) => {
            report.add("daemon", checks::daemon(client, &node).await);
            report.add("versions", Ok(checks::versions(&hello)));
            report.add("clock", Ok(checks::clock(&hello, exchange)));
        }
        Err(failure) => report.add("daemon", Err(failure)),
    }
    report.add("latency", checks::latency(client, &node).await);
    let metrics = checks::metrics(client, &node).await;
    for (name, check) in checks::OF_METRICS {
        report.add(
            name,
            match &metrics {
                Ok(metrics) => Ok(check(metrics)),
                Err(failure) => Ok(Check::of_failure(failure)),
            },
        );
    }
    let swarms = checks::list(client, &node).await;
    let check = match &swarms {
        Ok(swarms) => checks::swarms(swarms),
        Err(failure) => Check::of_failure(failure),
    };
    report.add("swarms", Ok(check));
    let swarms = swarms.unwrap_or_default();
    let swarm = swarms.first().map(|swarm| swarm.swarm.as_str());
    report.add("questions", checks::queries(client, swarm).await);
    report.add(
        "creating",
        Ok(checks::commands_to_node(client, &node).await),
    );
    report.add(
        "commands",
        Ok(checks::commands_to_swarm(client, swarm).await),
    );
    report.add(
        "subscriptions",
        match listening {
            Ok(listening) => Ok(listening.check(!swarms.is_empty()).await),
            Err(failure) => Err(failure),
        },
    );
    let tokens = checks::liveliness(client, &node, &nodes, swarm);
    report.add("liveliness", tokens.await);
}
