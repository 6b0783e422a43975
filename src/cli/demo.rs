//! `jostled demo`: a swarm of fifty bodies, ten of which are informed of a direction at t = 50.
//! Prints a line each second. It is a client of the daemon like any other.

use std::time::Duration;

use jostle_client::{Client, CommandOptions, ConnectOptions, Error as ClientError};
use jostle_experiment::stdout::{self, StdoutError};
use jostle_physics::simulation::steps_in;
use jostle_proto::verbs::{CreateArgs, InformArgs, RunArgs, Select};
use jostle_proto::{ErrorCode, Metrics, NodeReply, Phase, Reply, Spec, Status};
use thiserror::Error;

use crate::config::Config;

/// Prints a line.
macro_rules! print_line {
    ($($text:tt)*) => {
        stdout::unless_closed(stdout::write(format!("{}\n", format_args!($($text)*)).as_bytes()))?
    };
}

const NAME: &str = "demo";
/// A seed with a typical drift: with one in ten seeds the drift is close to zero.
const SEED: u64 = 12;
/// Time units per second of wall clock.
const RATE: f64 = 20.0;
const INFORMED_AT: f64 = 50.0;
const INFORMED: u64 = 10;
/// How long the daemon holds a query for a step.
const HELD: Duration = Duration::from_secs(30);
/// The pause before that query is sent again.
const RETRY_DELAY: Duration = Duration::from_millis(500);
/// The time at the end over which the last line averages.
const LAST: f64 = 200.0;

#[derive(Debug, Error)]
pub enum DemoError {
    #[error("a request of the demo failed: {0}")]
    Client(ClientError),
    #[error("the swarm {NAME} was deleted")]
    Deleted,
    #[error(transparent)]
    Output(#[from] StdoutError),
}

impl From<ClientError> for DemoError {
    fn from(error: ClientError) -> Self {
        match error.is_not_found() {
            true => DemoError::Deleted,
            false => DemoError::Client(error),
        }
    }
}

/// Runs the demo on the daemon at `endpoint`, for `lasting` if given.
///
/// # Errors
///
/// [`DemoError::Deleted`] if the swarm was deleted, [`DemoError::Client`] if a request failed,
/// [`DemoError::Output`] if standard output cannot be written.
pub async fn run(
    config: &Config,
    endpoint: &str,
    lasting: Option<Duration>,
) -> Result<(), DemoError> {
    // A daemon with users requires the credentials of one.
    let users = config.auth_dir.as_ref();
    let credentials = users.and_then(|_| std::env::var_os("JOSTLE_CREDENTIALS"));
    let client = Client::connect(ConnectOptions {
        credentials: credentials.map(Into::into),
        node: Some(config.node.clone()),
        prefix: config.prefix.clone(),
        client: Some("jostled demo".to_owned()),
        ..ConnectOptions::to(endpoint)
    })
    .await?;
    let args = CreateArgs {
        name: NAME.to_owned(),
        spec: Spec {
            seed: SEED,
            rate: Some(RATE),
            ..Spec::new(50)
        },
        exist_ok: false,
    };
    client.create(&args).await?;
    print_line!("swarm {NAME}: 50 bodies four times as long as wide, {RATE} time units a second;");
    print_line!("at t = {INFORMED_AT} ten of them get a direction of their own, +x");
    let at = match endpoint == jostle_client::DEFAULT_ENDPOINT {
        true => String::new(),
        false => format!(" -e {endpoint}"),
    };
    print_line!("elsewhere: jostle{at} watch {NAME}, or jostle --help");
    print_line!("repeat it: jostle{at} spec {NAME} | jostle{at} create mine --spec -");
    print_line!("     time   order   drift +x   real-time factor   clients");
    let ended = tokio::select! {
        ended = play(&client, lasting) => ended,
        failed = print_lines(&client) => failed,
    };
    client.close().await;
    ended
}

/// Sends the commands of the demo, and reports at its end. Does not return without an end.
async fn play(client: &Client, lasting: Option<Duration>) -> Result<(), DemoError> {
    let dt = client.status(NAME).await?.result.dt;
    let end = lasting.map(|lasting| lasting.as_secs_f64() * RATE);
    let until_informed = end.map_or(INFORMED_AT, |end| end.min(INFORMED_AT));
    if until_informed == INFORMED_AT {
        let args = InformArgs {
            select: Select::Count(INFORMED),
            direction: 0.0,
            weight: None,
            for_time: None,
        };
        // Every run informs the same individuals at the same step.
        let options = CommandOptions {
            at_step: Some(steps_in(INFORMED_AT, dt)),
            ..CommandOptions::default()
        };
        client.command(NAME, "inform", &args, options).await?;
    }
    let until = run_until(client, end).await?;
    let Some(end) = end else {
        return std::future::pending().await;
    };
    let before = arrival(client, steps_in(until_informed, dt)).await?;
    let from = steps_in((end - LAST).max(until_informed), dt);
    let rest = async {
        // Another query for the same step would return a later status.
        let from = match from > before.step {
            true => arrival(client, from).await?,
            false => before.clone(),
        };
        Ok::<_, DemoError>((from, arrival(client, until).await?))
    };
    // The demo also ends if a client has paused the swarm.
    let limit = lasting.unwrap_or_default() * 3 / 2 + Duration::from_secs(5);
    let (from, reached) = match tokio::time::timeout(limit, rest).await {
        Ok(rest) => rest?,
        Err(_) => (before.clone(), client.status(NAME).await?),
    };
    Ok(report(&before, &from, &reached)?)
}

/// Runs to a time or without end; returns the step of that time, or the current step if a client has
/// already gone beyond it.
async fn run_until(client: &Client, until_time: Option<f64>) -> Result<u64, DemoError> {
    let args = RunArgs {
        until_time,
        ..RunArgs::default()
    };
    match client.execute(NAME, &args).await {
        Ok(reply) => Ok(reply.result.until_step.unwrap_or(u64::MAX)),
        Err(ClientError::Rejected(error)) if error.code == ErrorCode::Conflict => {
            Ok(error.step.unwrap_or_default())
        }
        Err(error) => Err(error.into()),
    }
}

/// The status when the swarm reaches a step.
async fn arrival(client: &Client, step: u64) -> Result<Reply<Status>, DemoError> {
    loop {
        match client.wait(NAME, &format!("step={step}"), HELD).await {
            Ok(reply) => {
                let status: Reply<Status> = reply.read()?;
                if status.step >= step || status.phase == Phase::Faulted {
                    return Ok(status);
                }
            }
            Err(ClientError::Rejected(error)) if error.code == ErrorCode::DeadlineExceeded => {}
            Err(error) => return Err(error.into()),
        }
        // A client has paused it, or too many wait for it.
        tokio::time::sleep(RETRY_DELAY).await;
    }
}

async fn print_lines(client: &Client) -> Result<(), DemoError> {
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    tick.tick().await;
    loop {
        tick.tick().await;
        let status = client.status(NAME).await?;
        let metrics: NodeReply<Metrics> = client.get_node("metrics").await?.read()?;
        // Without the demo itself.
        let clients = metrics.result.sessions.saturating_sub(1);
        let factor = match status.result.real_time_factor {
            Some(factor) => format!("{factor:.1} of {RATE}"),
            None if status.phase == Phase::Paused => "paused".to_owned(),
            None => status.result.reason.unwrap_or_default(),
        };
        print_line!(
            "{:9.1} {:7.3} {:>10} {factor:>18} {clients:9}",
            status.time,
            status.result.order.order,
            signed(status.result.order.velocity[0])
        );
    }
}

/// A drift with its sign, to three decimals; never `-0.000`.
fn signed(drift: f64) -> String {
    format!("{:+.3}", (drift * 1000.0).round() / 1000.0 + 0.0)
}

/// Prints the mean drift before informing and over the last span, from means over all steps.
fn report(
    before: &Reply<Status>,
    from: &Reply<Status>,
    reached: &Reply<Status>,
) -> Result<(), StdoutError> {
    let mean = |status: &Reply<Status>| status.result.order.mean_velocity.unwrap_or_default()[0];
    let sum = |status: &Reply<Status>| mean(status) * status.step as f64;
    let (informed_at, end) = (before.time, reached.time);
    let uninformed = signed(mean(before));
    let steps = reached.step.saturating_sub(from.step);
    if steps == 0 {
        print_line!(
            "mean drift towards +x: {uninformed} before informing (t = 0 to {informed_at:.0})"
        );
        return Ok(());
    }
    let after = signed((sum(reached) - sum(from)) / steps as f64);
    print_line!(
        "mean drift towards +x: {uninformed} before informing (t = 0 to {informed_at:.0}), \
         {after} with ten informed (t = {:.0} to {end:.0})",
        from.time
    );
    Ok(())
}
