//! Prints the updates of one swarm as lines until it is deleted.

mod view;

use std::collections::BTreeMap;
use std::pin::pin;
use std::time::Duration;

use jostle_client::{Client, FollowOptions, Update};
use jostle_proto::{Measures, Phase, Reply, State, Status};
use tokio::time::{Instant, interval};

use self::view::View;
use crate::arguments::WatchArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::interrupt;
use crate::verbs::outage::{DAEMON_AWAY, DAEMON_BACK, wait_for_deadline};
use crate::verbs::watch::sample_of;

/// How many states or samples may wait to be printed before the oldest are dropped.
const CAPACITY: usize = 64;
/// The interval of the lines for people.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

/// Prints the updates of a swarm.
pub async fn stream(
    context: &Context,
    swarm: &str,
    arguments: &WatchArguments,
    timeout: f64,
) -> Result<(), Failure> {
    let Context { client, output } = context;
    let view = View::new(*output, arguments.frames);
    // Lines for people show the newest sample.
    let capacity = if output.json { CAPACITY } else { 1 };
    let options = FollowOptions {
        status: true,
        states: arguments.frames.then_some(CAPACITY),
        order: (!arguments.frames).then_some(capacity),
        ..FollowOptions::default()
    };
    let mut updates = interrupt::either(client.follow(swarm, options)).await?;
    let mut printer = Printer {
        client,
        view,
        last: None,
        phase: None,
    };
    let end = arguments.for_secs.map(Duration::from_secs_f64);
    let end = end.map(|lasting| Instant::now() + lasting);
    let mut left = arguments.count;
    // A swarm that does not run publishes nothing: `--count` would never be reached.
    let most = Duration::from_secs_f64(timeout);
    let mut idle_since = Instant::now();
    let mut interrupted = pin!(interrupt::interrupted());
    let mut ticks = interval(LINE_INTERVAL);
    ticks.tick().await;
    while left != Some(0) {
        let shown = tokio::select! {
            biased;
            () = &mut interrupted => return Err(Failure::interrupted()),
            () = wait_for_deadline(end) => return Ok(()),
            () = wait_for_deadline(printer.counts_in_vain(left).then(|| idle_since + most)) => {
                let (count, left) = (arguments.count.unwrap_or_default(), left.unwrap_or_default());
                return Err(Failure::not_counted(swarm, count - left, count, timeout));
            }
            update = updates.next() => match update.transpose()? {
                Some(Update::Deleted) => {
                    let deleted = Failure::deleted(swarm);
                    if left.is_some() {
                        return Err(deleted);
                    }
                    output.note(&deleted.to_string());
                    return Ok(());
                }
                Some(update @ (Update::Away | Update::Back)) => {
                    output.note(if matches!(update, Update::Away) { DAEMON_AWAY } else { DAEMON_BACK });
                    0
                }
                Some(update) => printer.print(update).await?,
                None => return Ok(()),
            },
            _ = ticks.tick() => printer.view.tick()?,
        };
        if shown > 0 {
            idle_since = Instant::now();
        }
        left = left.map(|left| left.saturating_sub(shown));
    }
    Ok(())
}

struct Printer<'a> {
    client: &'a Client,
    view: View,
    /// Epoch, step, frame and phase of the last update: a queried state may be published, too.
    last: Option<(u64, u64, u64, Phase)>,
    /// That of the last status.
    phase: Option<Phase>,
}

impl Printer<'_> {
    /// Whether lines are counted of a swarm that does not run.
    fn counts_in_vain(&self, left: Option<u64>) -> bool {
        left.is_some() && self.phase.is_some_and(|phase| phase != Phase::Running)
    }

    /// Prints an update; returns the number of lines.
    async fn print(&mut self, update: Update) -> Result<u64, Failure> {
        if let Update::Status(status) = &update {
            self.phase = Some(status.phase);
        }
        match (update, &mut self.view) {
            (Update::Status(status), View::Samples) => self.status(*status).await,
            (Update::Status(status), view) => view.order(sample_of(*status, 0)),
            (Update::State(state), _) => {
                match self.is_new((state.epoch, state.step, state.frame, state.phase)) {
                    true => self.view.state(&state),
                    false => Ok(0),
                }
            }
            (Update::Order(order), View::Samples) => {
                match self.is_new((order.epoch, order.step, order.frame, order.phase)) {
                    true => self.view.line(order.payload.json()?),
                    false => Ok(0),
                }
            }
            (Update::Order(order), view) => view.order(order.value),
            _ => Ok(0),
        }
    }

    /// Prints the sample of a swarm that does not run, and so publishes none.
    async fn status(&mut self, status: Reply<Status>) -> Result<u64, Failure> {
        if status.phase == Phase::Running {
            return Ok(0);
        }
        // A status lacks the number of the state.
        let state: State = self.client.state(&status.swarm).await?.read()?;
        let place = (state.epoch, state.step, state.frame, state.phase);
        if (state.epoch, state.step) != (status.epoch, status.step) || !self.is_new(place) {
            return Ok(0);
        }
        let measures = self.measures(&status).await;
        let mut sample = sample_of(status, state.frame);
        sample.measures = measures;
        self.view
            .line(&serde_json::to_string(&sample).map_err(Failure::defect)?)
    }

    /// The measures that a swarm which does not run would publish; none if it has changed.
    async fn measures(&self, status: &Reply<Status>) -> Option<BTreeMap<String, Option<f64>>> {
        let names = status.result.parameters.measures.as_ref()?.join(",");
        let noun = format!("measures?names={names}");
        let answer = self.client.get(&status.swarm, &noun).await.ok()?;
        let reply: Reply<Measures> = answer.read().ok()?;
        let is_same = (reply.epoch, reply.step) == (status.epoch, status.step);
        let measures = reply.result.measures.into_iter();
        is_same.then(|| measures.map(|it| (it.name, it.value)).collect())
    }

    fn is_new(&mut self, place: (u64, u64, u64, Phase)) -> bool {
        self.last.replace(place) != Some(place)
    }
}
