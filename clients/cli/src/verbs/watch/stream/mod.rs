//! One swarm live as lines, through restarts of connections, until it is deleted.

mod view;

use std::pin::pin;
use std::time::Duration;

use jostle_proto::{Event, EventKind, OrderSample, Phase, Reply, State, Status, keys};
use tokio::time::{Instant, interval};
use zenoh::sample::Sample;

use self::view::View;
use crate::arguments::WatchArguments;
use crate::bus::{Answer, Bus, Samples};
use crate::failure::Failure;
use crate::interrupt;
use crate::output::Output;
use crate::verbs::lookout::{BACK, GONE, Lookout, News, reach};
use crate::verbs::watch::sample_of;

/// How many samples may wait to be printed before the oldest are dropped.
const BACKLOG: usize = 64;
/// How often a line is printed where there is no terminal.
const BETWEEN_LINES: Duration = Duration::from_secs(1);

/// Shows live how a swarm is doing.
///
/// # Errors
///
/// Why there is nothing to show, or nothing any more.
pub async fn stream(
    bus: &Bus,
    output: Output,
    swarm: &str,
    arguments: &WatchArguments,
) -> Result<(), Failure> {
    let begin = Watching::begin(bus, output, swarm, arguments);
    let mut watching = interrupt::either(begin).await?;
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
    lookout: Lookout<'a>,
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
        swarm: &'a str,
        arguments: &WatchArguments,
    ) -> Result<Self, Failure> {
        let prefix = bus.prefix();
        let view = View::new(output, arguments.frames);
        let (key, backlog) = match view {
            View::Frames => (keys::state(prefix, swarm), BACKLOG),
            View::Samples => (keys::order(prefix, swarm), BACKLOG),
            // People are shown the latest.
            View::Lines { .. } => (keys::order(prefix, swarm), 1),
        };
        let mut watching = Watching {
            samples: bus.subscribe(&key, backlog).await?,
            events: bus.subscribe(&keys::event(prefix, swarm), BACKLOG).await?,
            lookout: Lookout::begin(bus, swarm).await?,
            bus,
            output,
            swarm,
            view,
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
                        let swarm = self.swarm.into();
                        return Err(Failure::Deleted { swarm });
                    }
                }
                news = self.lookout.news() => self.hear(news?).await?,
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

    async fn hear(&mut self, news: News) -> Result<(), Failure> {
        if news == News::Gone {
            self.output.note(GONE);
            return Ok(());
        }
        self.output.note(BACK);
        // Whatever prevents a look now, the next sample shows how it is.
        match self.look().await {
            Err(failure @ Failure::Pipe) => Err(failure),
            _ => Ok(()),
        }
    }

    fn count(&mut self, shown: u64) {
        self.left = self.left.map(|left| left.saturating_sub(shown));
    }
}

fn received(sample: zenoh::Result<Sample>) -> Result<Sample, Failure> {
    sample.map_err(Failure::defect)
}
