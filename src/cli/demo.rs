//! `jostled demo`: a swarm of fifty bodies, ten of which are informed of a direction at t = 50.
//! Prints a line each second.

use std::io::Write as _;
use std::sync::Arc;
use std::time::Duration;

use jostle_physics::simulation::steps_in;
use jostle_proto::verbs::CreateArgs;
use jostle_proto::{Request, Spec};
use serde_json::{Value, json};
use thiserror::Error;
use tokio::sync::oneshot;

use crate::app::Server;
use crate::convert::commands::{self, CommandError, create};
use crate::persistence::writer::NewSwarm;
use crate::swarm::command::WaitCondition;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::Frame;
use crate::swarm::handle::{CommandMessage, Handle, Message, Outcome, ReplyTo, SwarmReply, Waiter};

/// Prints and flushes a line. A closed standard output is no error.
macro_rules! say {
    ($($text:tt)*) => {{
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, $($text)*).and_then(|()| out.flush());
    }};
}

const NAME: &str = "demo";
/// A seed with a typical drift: with one in ten seeds the drift is close to zero.
const SEED: u64 = 12;
/// Time units per second of wall clock.
const RATE: f64 = 20.0;
const INFORMED_AT: f64 = 50.0;
const INFORMED: u64 = 10;
/// The pause before a displaced wait is retried.
const RETRY_DELAY: Duration = Duration::from_millis(500);
/// The time at the end over which the last line averages.
const LAST: f64 = 200.0;

#[derive(Debug, Error)]
pub enum DemoError {
    #[error("a command of the demo was rejected: {0}")]
    Command(#[from] CommandError),
    /// The swarm was deleted or the daemon stops.
    #[error("the swarm {NAME} was deleted")]
    Gone,
}

impl From<SwarmError> for DemoError {
    fn from(error: SwarmError) -> Self {
        match error {
            SwarmError::Gone => DemoError::Gone,
            error => DemoError::Command(error.into()),
        }
    }
}

/// Runs the demo on `server`, for `lasting` if given.
///
/// # Errors
///
/// [`DemoError::Gone`] if the swarm was deleted, [`DemoError::Command`] if a step failed.
pub async fn run(server: &Server, lasting: Option<Duration>) -> Result<(), DemoError> {
    let swarm = create_swarm(server).await?;
    let endpoint = server.endpoints.first().cloned().unwrap_or_default();
    say!("swarm {NAME}: 50 bodies four times as long as wide, {RATE} time units a second;");
    say!("at t = {INFORMED_AT} ten of them get a direction of their own, +x");
    if endpoint == "tcp/127.0.0.1:7447" {
        say!("elsewhere: jostle watch {NAME}, or jostle --help");
    } else {
        say!("elsewhere: jostle -e {endpoint} watch {NAME}");
    }
    say!("     time   order   drift +x   real-time factor   clients");
    tokio::select! {
        ended = play(&swarm, lasting) => ended,
        gone = print_lines(server, &swarm) => gone,
    }
}

/// Sends the commands of the demo, and reports at its end. Without an end, returns only if the swarm
/// was deleted.
async fn play(swarm: &Handle, lasting: Option<Duration>) -> Result<(), DemoError> {
    let end = lasting.map(|lasting| lasting.as_secs_f64() * RATE);
    let until_informed = end.map_or(INFORMED_AT, |end| end.min(INFORMED_AT));
    let dt = swarm.spec.parameters.dt;
    if until_informed == INFORMED_AT {
        // Every run informs the same individuals at the same step.
        let args = json!({"select": {"count": INFORMED}, "direction": 0.0});
        command(swarm, "inform", &args, Some(steps_in(INFORMED_AT, dt))).await?;
    }
    let until = run_on(swarm, end).await?;
    let before = arrival(swarm, steps_in(until_informed, dt)).await?;
    let Some(end) = end else {
        arrival(swarm, u64::MAX).await?;
        return Err(DemoError::Gone);
    };
    let from = steps_in((end - LAST).max(until_informed), dt);
    let rest = async {
        let from = arrival(swarm, from).await?;
        Ok::<_, DemoError>((from, arrival(swarm, until).await?))
    };
    // The demo also ends if a client has paused the swarm.
    let limit = lasting.unwrap_or_default() * 3 / 2 + Duration::from_secs(5);
    let (from, reached) = match tokio::time::timeout(limit, rest).await {
        Ok(rest) => rest?,
        Err(_) => (before.clone(), look(swarm).await?),
    };
    report(&before, &from, &reached);
    Ok(())
}

async fn create_swarm(server: &Server) -> Result<Handle, DemoError> {
    let spec = Spec {
        seed: SEED,
        rate: Some(RATE),
        ..Spec::new(50)
    };
    let args = CreateArgs {
        name: NAME.to_owned(),
        spec,
        exist_ok: false,
    };
    let registry = &server.registry;
    let spec = create::spec(&args, registry.limits())?;
    let register = Box::new(NewSwarm {
        store: server.store.clone(),
        name: NAME.to_owned(),
        spec: spec.clone(),
        identity: None,
    });
    let (reply_to, created) = reply();
    registry
        .create(NAME, spec, false, register, || reply_to)
        .map_err(CommandError::from)?;
    created.await?;
    registry.find(NAME).ok_or(DemoError::Gone)
}

/// Runs to a time or without end; returns the step of that time, or the current step if a client has
/// already gone beyond it.
async fn run_on(swarm: &Handle, until_time: Option<f64>) -> Result<u64, DemoError> {
    let args = json!({"until_time": until_time});
    match command(swarm, "run", &args, None).await {
        Ok(Outcome::Runs(until, _)) => Ok(until.unwrap_or(u64::MAX)),
        Ok(_) => Ok(u64::MAX),
        Err(DemoError::Command(CommandError::Swarm(SwarmError::Past { step, .. }))) => Ok(step),
        Err(error) => Err(error),
    }
}

/// The frame at which the swarm reaches a step.
async fn arrival(swarm: &Handle, step: u64) -> Result<Arc<Frame>, DemoError> {
    loop {
        let (reply_to, reply) = reply();
        swarm.send(Message::Wait(Waiter {
            condition: WaitCondition::Reached(step),
            is_abandoned: Box::new(|| false),
            reply_to,
        }));
        match reply.await {
            Err(DemoError::Command(CommandError::Swarm(SwarmError::Displaced { .. }))) => {
                tokio::time::sleep(RETRY_DELAY).await;
            }
            reply => return frame(reply?),
        }
    }
}

async fn look(swarm: &Handle) -> Result<Arc<Frame>, DemoError> {
    let (reply_to, reply) = reply();
    swarm.send(Message::Query(reply_to));
    frame(reply.await?)
}

fn frame(outcome: Outcome) -> Result<Arc<Frame>, DemoError> {
    match outcome {
        Outcome::State(frame) => Ok(frame),
        _ => Err(DemoError::Gone),
    }
}

async fn print_lines(server: &Server, swarm: &Handle) -> Result<(), DemoError> {
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    tick.tick().await;
    loop {
        tick.tick().await;
        print_line(server, swarm).await?;
    }
}

async fn print_line(server: &Server, swarm: &Handle) -> Result<(), DemoError> {
    let frame = look(swarm).await?;
    let clients = server.sessions();
    let factor = match frame.real_time_factor {
        Some(factor) => format!("{factor:.1} of {RATE}"),
        None => frame.stamp.phase.reason().unwrap_or_default(),
    };
    say!(
        "{:9.1} {:7.3} {:+10.3} {factor:>18} {clients:9}",
        frame.stamp.time,
        frame.order.order,
        frame.order.velocity[0]
    );
    Ok(())
}

/// Prints the mean drift before informing and over the last span, from sums over all steps.
fn report(before: &Frame, from: &Frame, reached: &Frame) {
    let sum = |frame: &Frame| {
        let mean = frame.means.mean_velocity().unwrap_or_default();
        mean[0] * frame.stamp.step as f64
    };
    let (informed_at, end) = (before.stamp.time, reached.stamp.time);
    let uninformed = before.means.mean_velocity().unwrap_or_default()[0];
    let steps = reached.stamp.step.saturating_sub(from.stamp.step);
    if steps == 0 {
        say!(
            "mean drift towards +x: {uninformed:+.3} before informing (t = 0 to {informed_at:.0})"
        );
        return;
    }
    let after = (sum(reached) - sum(from)) / steps as f64;
    say!(
        "mean drift towards +x: {uninformed:+.3} before informing (t = 0 to {informed_at:.0}), \
         {after:+.3} with ten informed (t = {:.0} to {end:.0})",
        from.stamp.time
    );
}

async fn command(
    swarm: &Handle,
    verb: &str,
    args: &Value,
    at_step: Option<u64>,
) -> Result<Outcome, DemoError> {
    let request = json!({"args": args, "at_step": at_step, "client": "jostled demo"});
    let request = Request::from_json(request.to_string().as_bytes()).map_err(CommandError::from)?;
    let (message, _) = commands::read(verb, &request)?;
    let (reply_to, reply) = reply();
    swarm.send(Message::Command(CommandMessage {
        reply_to,
        ..message
    }));
    reply.await
}

/// A receiver for a reply, and the future of that reply.
fn reply() -> (ReplyTo, impl Future<Output = Result<Outcome, DemoError>>) {
    let (sender, receiver) = oneshot::channel::<SwarmReply>();
    let reply = async {
        match receiver.await {
            Ok(Ok((_, outcome))) => Ok(outcome),
            Ok(Err(rejection)) => Err(rejection.error.into()),
            Err(_) => Err(DemoError::Gone),
        }
    };
    (ReplyTo::new(move |it| drop(sender.send(it))), reply)
}
