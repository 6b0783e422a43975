//! A controller in lock-step: it steers two individuals of a swarm in a circle, and prints the time
//! of a step.
//!
//! ```sh
//! jostle create demo --n 50
//! cargo run --release -p jostle-client --example controller -- demo tcp/127.0.0.1:7447
//! ```

use std::f64::consts::TAU;
use std::process::ExitCode;
use std::time::Instant;

use jostle_client::{Client, ConnectOptions, Error};
use jostle_proto::verbs::{JoinArgs, Mode, OnTimeout, Return, Select, SetPoints};

/// The name of the controller.
const NAME: &str = "circle";

/// How many times it advances.
const EXCHANGES: u32 = 1000;

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(swarm), Some(endpoint)) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: controller SWARM ENDPOINT, such as demo tcp/127.0.0.1:7447");
        return ExitCode::FAILURE;
    };
    match steer(&swarm, &endpoint).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("controller: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn steer(swarm: &str, endpoint: &str) -> Result<(), Error> {
    let client = Client::connect(ConnectOptions::to(endpoint)).await?;
    let join = JoinArgs {
        controller: NAME.into(),
        select: Some(Select::Ids(vec![0, 1])),
        mode: Mode::Lockstep,
        deadline_secs: 5.0,
        on_timeout: OnTimeout::Free,
        driving: false,
        again: true,
    };
    let (mut controller, joined) = client.join(swarm, join).await?;
    let ids = joined.result.ids;
    let start = Instant::now();
    for k in 0..EXCHANGES {
        let direction = TAU * f64::from(k) / f64::from(EXCHANGES);
        let set = SetPoints {
            ids: ids.clone(),
            direction: vec![direction; ids.len()],
            weight: Some(vec![1.0; ids.len()]),
            ..SetPoints::default()
        };
        let reply = controller.advance(1, Some(set), Return::None).await?;
        for miss in &reply.result.news.missed {
            println!("step {}: {} was late", miss.step, miss.controller);
        }
    }
    let time = start.elapsed() / EXCHANGES;
    let step = controller.step();
    println!("{EXCHANGES} exchanges, {time:.1?} each; {swarm} is at step {step}");
    controller.leave().await?;
    client.close().await;
    Ok(())
}
