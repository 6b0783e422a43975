//! `watch`: a swarm live, through restarts of connections, until it is deleted.

mod view;
mod whereabouts;

use std::pin::pin;
use std::time::Duration;

use jostle_proto::{Event, EventKind, OrderSample, Phase, Reply, State, Status, keys};
use tokio::time::{Instant, interval, sleep_until};
use zenoh::sample::{Sample, SampleKind};

use self::view::View;
use self::whereabouts::{News, Whereabouts};
use crate::arguments::WatchArguments;
use crate::bus::{Answer, Bus, Samples, node_of};
use crate::failure::Failure;
use crate::interrupt;
use crate::output::Output;

/// How many samples may wait to be printed before the oldest are dropped.
const BACKLOG: usize = 64;
/// How often a line is printed where there is no terminal.
const BETWEEN_LINES: Duration = Duration::from_secs(1);

/// Shows live how a swarm is doing.
///
/// # Errors
///
/// Why there is nothing to show, or nothing any more.
pub async fn watch(bus: &Bus, output: Output, arguments: &WatchArguments) -> Result<(), Failure> {
    let mut watching = interrupt::either(Watching::begin(bus, output, arguments)).await?;
    match watching.follow().await {
        Err(failure @ Failure::Deleted { .. }) if arguments.count.is_none() => {
            output.note(&failure.to_string());
            Ok(())
        }
        outcome => outcome,
    }
}

/// What is published of a swarm, and what has been shown of it.
struct Watching<'a> {
    bus: &'a Bus,
    output: Output,
    swarm: &'a str,
    view: View,
    samples: Samples,
    events: Samples,
    swarm_tokens: Samples,
    node_tokens: Samples,
    whereabouts: Whereabouts,
    node: Option<String>,
    /// Epoch, step, frame and phase of what was asked for, lest it is printed twice.
    looked: Option<(u64, u64, u64, Phase)>,
    left: Option<u64>,
    end: Option<Instant>,
}

impl<'a> Watching<'a> {
    /// Subscribes first and looks then, so that nothing falls in between.
    async fn begin(
        bus: &'a Bus,
        output: Output,
        arguments: &'a WatchArguments,
    ) -> Result<Self, Failure> {
        let swarm = arguments.name.as_str();
        let prefix = bus.prefix();
        let view = View::new(output, arguments.frames);
        let (key, backlog) = match view {
            View::Frames => (keys::state(prefix, swarm), BACKLOG),
            View::Samples => (keys::order(prefix, swarm), BACKLOG),
            // People are shown the latest.
            View::Panel { .. } | View::Lines { .. } => (keys::order(prefix, swarm), 1),
        };
        let mut watching = Watching {
            samples: bus.subscribe(&key, backlog).await?,
            events: bus.subscribe(&keys::event(prefix, swarm), BACKLOG).await?,
            swarm_tokens: bus
                .subscribe_tokens(&keys::alive(prefix, swarm, "*"), BACKLOG)
                .await?,
            node_tokens: bus
                .subscribe_tokens(&keys::node_alive(prefix, "*"), BACKLOG)
                .await?,
            bus,
            output,
            swarm,
            view,
            whereabouts: Whereabouts::Here,
            node: None,
            looked: None,
            left: arguments.count,
            end: arguments
                .for_secs
                .map(|secs| Instant::now() + Duration::from_secs_f64(secs)),
        };
        watching.look().await?;
        Ok(watching)
    }

    /// Shows what comes until enough was shown, the time is over or the swarm is gone.
    async fn follow(&mut self) -> Result<(), Failure> {
        let mut interrupted = pin!(interrupt::pressed());
        let mut ticks = interval(BETWEEN_LINES);
        ticks.tick().await;
        while self.left != Some(0) {
            tokio::select! {
                biased;
                () = &mut interrupted => return Err(Failure::Interrupted { left: None }),
                () = reach(self.end) => return Ok(()),
                event = self.events.recv_async() => {
                    let event = Answer::from(&received(event)?).read::<Event>();
                    if event.is_ok_and(|event| event.event == (EventKind::Deleted {})) {
                        return Err(self.deleted());
                    }
                }
                token = self.swarm_tokens.recv_async() => self.swarm_token(&received(token)?).await?,
                token = self.node_tokens.recv_async() => self.node_token(&received(token)?),
                () = reach(self.whereabouts.deadline()) => self.judge().await?,
                sample = self.samples.recv_async() => self.sample(&received(sample)?)?,
                _ = ticks.tick() => {
                    let shown = self.view.tick()?;
                    self.count(shown);
                }
            }
        }
        Ok(())
    }

    /// Asks how the swarm is, because one that stands still publishes nothing.
    async fn look(&mut self) -> Result<(), Failure> {
        let status: Reply<Status> = self.bus.get(self.swarm, "status").await?.read()?;
        let shown = match &mut self.view {
            View::Frames => {
                let state: State = self.bus.state(self.swarm).await?.read()?;
                self.looked = Some((state.epoch, state.step, state.frame, state.phase));
                self.view.state(&state)?
            }
            View::Samples => {
                if status.phase == Phase::Running {
                    return Ok(());
                }
                // The number of the state is the one thing a status does not tell.
                let state: State = self.bus.state(self.swarm).await?.read()?;
                if (state.epoch, state.step) != (status.epoch, status.step) {
                    return Ok(());
                }
                let sample = sample_of(status, state.frame);
                self.looked = Some((sample.epoch, sample.step, sample.frame, sample.phase));
                let text = serde_json::to_string(&sample).map_err(Failure::defect)?;
                self.view.line(&text)?
            }
            _ => self.view.order(sample_of(status, 0))?,
        };
        self.count(shown);
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> Result<(), Failure> {
        let answer = Answer::from(sample);
        let (what, shown) = match &mut self.view {
            View::Frames => {
                let state: State = answer.read()?;
                let what = (state.epoch, state.step, state.frame, state.phase);
                if self.looked == Some(what) {
                    return Ok(());
                }
                (what, self.view.state(&state)?)
            }
            View::Samples => {
                let order: OrderSample = answer.read()?;
                let what = (order.epoch, order.step, order.frame, order.phase);
                if self.looked == Some(what) {
                    return Ok(());
                }
                (what, self.view.line(answer.json()?)?)
            }
            _ => {
                let order: OrderSample = answer.read()?;
                let what = (order.epoch, order.step, order.frame, order.phase);
                (what, self.view.order(order)?)
            }
        };
        self.looked = Some(what);
        self.count(shown);
        Ok(())
    }

    async fn swarm_token(&mut self, token: &Sample) -> Result<(), Failure> {
        let is_alive = token.kind() == SampleKind::Put;
        if is_alive {
            self.node = node_of(self.bus.prefix(), token.key_expr().as_str());
        }
        let news = self.whereabouts.swarm_token(is_alive, Instant::now());
        if news == Some(News::Back) {
            self.view.notice(self.output, None)?;
            if !self.view.is_panel() {
                self.output.note("the daemon is back");
            }
            // Whatever prevents a look now, the next sample shows how it is.
            if let Err(failure @ Failure::Pipe) = self.look().await {
                return Err(failure);
            }
        }
        Ok(())
    }

    fn node_token(&mut self, token: &Sample) {
        if self.is_its_node(node_of(self.bus.prefix(), token.key_expr().as_str()).as_ref()) {
            let is_alive = token.kind() == SampleKind::Put;
            self.whereabouts.node_token(is_alive, Instant::now());
        }
    }

    /// Says what became of a swarm whose token is gone.
    async fn judge(&mut self) -> Result<(), Failure> {
        let nodes = self.bus.nodes().await?;
        let is_node_there = nodes.iter().any(|node| self.is_its_node(Some(node)));
        match self.whereabouts.judge(is_node_there) {
            Some(News::Deleted) => Err(self.deleted()),
            Some(News::LeftBehind) => Err(Failure::LeftBehind {
                swarm: self.swarm.into(),
            }),
            Some(News::Gone) => {
                let text = "the daemon went away; waiting for it to come back";
                self.view.notice(self.output, Some(text))
            }
            Some(News::Back) | None => Ok(()),
        }
    }

    /// Whether a node is the one that hosts the swarm, as far as is known.
    fn is_its_node(&self, node: Option<&String>) -> bool {
        self.node.is_none() || self.node.as_ref() == node
    }

    fn deleted(&self) -> Failure {
        Failure::Deleted {
            swarm: self.swarm.into(),
        }
    }

    fn count(&mut self, shown: u64) {
        self.left = self.left.map(|left| left.saturating_sub(shown));
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

/// Completes at `deadline`; never if there is none.
async fn reach(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}

fn received(sample: zenoh::Result<Sample>) -> Result<Sample, Failure> {
    sample.map_err(Failure::defect)
}
