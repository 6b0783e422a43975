//! A controller in lock-step: it steers two individuals of a swarm in a circle, and says what a
//! step took.
//!
//! ```sh
//! jostle create demo --n 50
//! cargo run --release --example controller -- demo tcp/127.0.0.1:7447
//! ```

use std::error::Error;
use std::f64::consts::TAU;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use jostle_proto::Reply;
use jostle_proto::keys::{self, DEFAULT_PREFIX};
use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, JoinArgs, JoinResult, LeaveArgs, Mode, OnTimeout, Return, Select,
    SetPoints,
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use zenoh::Session;

/// What the controller is called.
const NAME: &str = "circle";

/// How many exchanges it takes.
const EXCHANGES: u32 = 1000;

/// What may go wrong.
type Failure = Box<dyn Error + Send + Sync>;

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> ExitCode {
    match run().await {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("controller: {failure}");
            ExitCode::FAILURE
        }
    }
}

async fn run() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let (Some(swarm), Some(endpoint)) = (arguments.next(), arguments.next()) else {
        return Err("usage: controller SWARM ENDPOINT, such as demo tcp/127.0.0.1:7447".into());
    };
    let mut config = zenoh::Config::default();
    for (setting, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config.insert_json5(setting, &value.to_string())?;
    }
    let session = zenoh::open(config).await.map_err(|_| {
        format!("no daemon answers at {endpoint}: start one with `jostled`, or give its ENDPOINT")
    })?;

    // Held for as long as it steers: if this process ends, nobody waits for it.
    let alive = keys::ctl_alive(DEFAULT_PREFIX, &swarm, NAME);
    let token = session.liveliness().declare_token(alive).await?;
    let join = JoinArgs {
        controller: NAME.into(),
        select: Some(Select::Ids(vec![0, 1])),
        mode: Mode::Lockstep,
        deadline_secs: 5.0,
        on_timeout: OnTimeout::Free,
        driving: false,
        again: true,
    };
    let joined: Reply<JoinResult> = ask(&session, &swarm, "join", None, &join).await?;
    let mut step = joined.step;
    let began = Instant::now();
    for k in 0..EXCHANGES {
        let direction = TAU * f64::from(k) / f64::from(EXCHANGES);
        let advance = AdvanceArgs {
            controller: NAME.into(),
            steps: 1,
            set: Some(SetPoints {
                ids: joined.result.ids.clone(),
                direction: vec![direction; joined.result.ids.len()],
                weight: Some(vec![1.0; joined.result.ids.len()]),
                ..SetPoints::default()
            }),
            return_: Return::None,
        };
        let reply: Reply<AdvanceResult> =
            ask(&session, &swarm, "advance", Some(step), &advance).await?;
        for miss in &reply.result.news.missed {
            println!("step {}: {} was late", miss.step, miss.controller);
        }
        step = reply.step;
    }
    let took = began.elapsed() / EXCHANGES;
    println!("{EXCHANGES} exchanges, {took:.1?} each; {swarm} is at step {step}");
    let leave = LeaveArgs {
        controller: NAME.into(),
    };
    let _: Reply<Value> = ask(&session, &swarm, "leave", None, &leave).await?;
    token.undeclare().await?;
    session.close().await?;
    Ok(())
}

/// Sends a command and reads its answer; `step` is where the swarm is taken to be.
async fn ask<T: DeserializeOwned>(
    session: &Session,
    swarm: &str,
    verb: &str,
    step: Option<u64>,
    args: &impl serde::Serialize,
) -> Result<T, Failure> {
    let mut request = json!({"client": NAME, "timeout_secs": 10, "args": args});
    if let Some(step) = step {
        request["expect_step"] = json!(step);
    }
    let answers = session
        .get(keys::cmd(DEFAULT_PREFIX, swarm, verb))
        .payload(serde_json::to_vec(&request)?)
        .encoding("application/json")
        .timeout(Duration::from_secs(15))
        .await?;
    // A query that no queryable matches ends at once without a reply.
    let answer = answers.recv_async().await.map_err(|_| {
        format!(
            "no swarm {swarm} there: make one with `jostle create {swarm} --n 50`, or give the name \
             of another as SWARM"
        )
    })?;
    match answer.into_result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes())?),
        Err(error) => {
            let error: jostle_proto::Error = serde_json::from_slice(&error.payload().to_bytes())?;
            Err(error.message.into())
        }
    }
}
