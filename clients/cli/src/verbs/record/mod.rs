//! `record`: the daemon records every k-th state of a swarm, and a client may fetch the recording
//! into a file; or the client records the published states.

mod daemon;
mod fetch;
mod intake;
mod recover;

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::pin::pin;
use std::time::{Duration, SystemTime};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use jostle_proto::{Event, EventKind, OrderSample, Reply, State, Status, keys};
use jostle_results::recording::{
    About, FROM_PUBLISHED, Format, Frame, Moment, Recorder, RecordingError, SOURCE, Written,
    partial,
};
use serde_json::json;
use serde_json::value::RawValue;
use tokio::time::Instant;
use zenoh::sample::Sample;

pub use self::fetch::check_fetched;
use self::intake::Intake;
pub use self::recover::recover;
use crate::arguments::RecordArguments;
use crate::bus::{Answer, Bus, Samples};
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::verbs::lookout::{BACK, GONE, Lookout, News, reach};

/// How many samples may wait to be written before the oldest are dropped: seconds of them.
const BACKLOG: usize = 512;

/// How often received samples are flushed to the operating system and synced to the disk: a kill of
/// this process or a power failure loses about as much.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);

/// The timeout of a query for the state, since nothing is flushed meanwhile.
const STATE_TIMEOUT: Duration = Duration::from_secs(2);

/// Records a swarm to a file, or does what is asked for with recordings of the daemon.
///
/// # Errors
///
/// Why there is no recording, or why it ended before it should: it is whole even then, unless the
/// message says otherwise.
pub async fn record(bus: &Bus, output: Output, arguments: &RecordArguments) -> Result<(), Failure> {
    match (&arguments.name, &arguments.out, &arguments.fetch) {
        (Some(name), Some(out), _) => {
            let take = Take {
                name,
                out,
                every: arguments.every,
                for_secs: arguments.for_secs,
                steps: arguments.steps,
                force: arguments.force,
            };
            if arguments.published {
                return to_file(bus, output, &take).await;
            }
            match fetch::record(bus, output, &take, arguments).await {
                Err(fetch::Stop::NotPermitted(failure)) => {
                    output.note(&format!("{failure}; recording what is published instead"));
                    to_file(bus, output, &take).await
                }
                Err(fetch::Stop::Failed(failure)) => Err(failure),
                Ok(()) => Ok(()),
            }
        }
        (None, Some(out), Some(recording)) => {
            let fetched = fetch::fetch(bus, output, recording, out, arguments.force);
            interrupt::either(fetched).await
        }
        _ => interrupt::either(daemon::record(bus, output, arguments)).await,
    }
}

/// What to record to which file, and for how long.
struct Take<'a> {
    name: &'a str,
    out: &'a Path,
    every: Option<u64>,
    for_secs: Option<f64>,
    steps: Option<u64>,
    force: bool,
}

async fn to_file(bus: &Bus, output: Output, arguments: &Take<'_>) -> Result<(), Failure> {
    let mut recording = interrupt::either(Recording::begin(bus, output, arguments)).await?;
    let ended = recording.follow(bus).await;
    recording.finish(ended)
}

/// A recording that is being made.
struct Recording<'a> {
    output: Output,
    arguments: &'a Take<'a>,
    recorder: Recorder,
    intake: Intake,
    states: Samples,
    /// Only MCAP holds them.
    orders: Option<Samples>,
    events: Samples,
    lookout: Lookout<'a>,
    end: Option<Instant>,
    /// When to flush.
    flush_due: Instant,
    /// A sync under way, on a thread that may block on the disk.
    syncing: Option<tokio::task::JoinHandle<io::Result<()>>>,
    bar: ProgressBar,
}

/// How a recording came to its end, if nothing went wrong.
enum Ended {
    Enough,
    Interrupted,
    Deleted,
}

impl<'a> Recording<'a> {
    /// Subscribes first and looks then, so that nothing falls in between.
    async fn begin(bus: &'a Bus, output: Output, arguments: &'a Take<'a>) -> Result<Self, Failure> {
        let Take { name, out, .. } = *arguments;
        let format = Format::of(out).map_err(|error| explain(out, error))?;
        let prefix = bus.prefix();
        let states = bus.subscribe(&keys::state(prefix, name), BACKLOG).await?;
        let events = bus.subscribe(&keys::event(prefix, name), BACKLOG).await?;
        let orders = match format {
            Format::Parquet => None,
            Format::Mcap => Some(bus.subscribe(&keys::order(prefix, name), BACKLOG).await?),
        };
        let lookout = Lookout::begin(bus, name).await?;
        let about = about(bus, arguments).await?;
        let first = bus.state(name).await?;
        let recorder = Recorder::to_file(out, arguments.force, about, decode)
            .map_err(|error| explain(out, error))?;
        let mut recording = Recording {
            output,
            arguments,
            recorder,
            intake: Intake::new(arguments.every),
            states,
            orders,
            events,
            lookout,
            end: arguments
                .for_secs
                .map(|secs| Instant::now() + Duration::from_secs_f64(secs)),
            flush_due: Instant::now(),
            syncing: None,
            bar: bar(output, arguments),
        };
        recording.state(&first)?;
        Ok(recording)
    }

    /// Writes what comes until it is enough.
    async fn follow(&mut self, bus: &Bus) -> Result<Ended, Failure> {
        let mut interrupted = pin!(interrupt::asked_to_end());
        while self
            .arguments
            .steps
            .is_none_or(|steps| self.intake.steps < steps)
        {
            tokio::select! {
                biased;
                () = &mut interrupted => return Ok(Ended::Interrupted),
                () = reach(self.end) => return Ok(Ended::Enough),
                () = tokio::time::sleep_until(self.flush_due) => self.flush().await?,
                state = self.states.recv_async() => self.state(&received(state)?)?,
                order = next(self.orders.as_ref()) => self.order(&received(order)?)?,
                event = self.events.recv_async() => {
                    if self.event(&received(event)?)? {
                        return Ok(Ended::Deleted);
                    }
                }
                news = self.lookout.news() => match news {
                    Err(Failure::Deleted { .. }) => return Ok(Ended::Deleted),
                    Err(failure) => return Err(failure),
                    Ok(news) => {
                        let said = if news == News::Gone { GONE } else { BACK };
                        self.bar.suspend(|| self.output.note(said));
                        // One that stands still publishes nothing.
                        let now = bus.state(self.arguments.name);
                        if news != News::Gone
                            && let Ok(Ok(state)) = tokio::time::timeout(STATE_TIMEOUT, now).await
                        {
                            self.state(&state)?;
                        }
                    }
                }
            }
        }
        Ok(Ended::Enough)
    }

    /// Flushes the received samples, and starts a sync unless one is under way.
    async fn flush(&mut self) -> Result<(), Failure> {
        self.flush_due = Instant::now() + FLUSH_INTERVAL;
        let out = self.arguments.out;
        let flushed = self.recorder.flush(&self.counts());
        let file = flushed.map_err(|error| explain(out, error))?;
        if let Some(syncing) = self.syncing.take_if(|it| it.is_finished()) {
            let synced = syncing.await.map_err(Failure::defect)?;
            synced.map_err(|error| file_failure(out, error))?;
        }
        if let (Some(file), None) = (file, &self.syncing) {
            let sync = move || File::sync_data(&file);
            self.syncing = Some(tokio::task::spawn_blocking(sync));
        }
        Ok(())
    }

    /// The metadata that counts recorded and missed states.
    fn counts(&self) -> About {
        About::from([
            (
                "frames".to_owned(),
                self.recorder.written().frames.to_string(),
            ),
            ("missed".to_owned(), self.intake.missed.to_string()),
        ])
    }

    fn state(&mut self, answer: &Answer) -> Result<(), Failure> {
        let state: State = answer.read()?;
        if !self.intake.takes(&state) {
            return Ok(());
        }
        let outcome = self.recorder.frame(&frame(&state, answer.bytes()));
        outcome.map_err(|error| explain(self.arguments.out, error))?;
        if let Some(steps) = self.arguments.steps {
            self.bar.set_position(self.intake.steps.min(steps));
        }
        self.bar.set_message(format!(
            "time {}, {}{}",
            format::time(state.time),
            format::count(self.recorder.written().frames, "frame"),
            missed(self.intake.missed)
        ));
        Ok(())
    }

    fn order(&mut self, answer: &Answer) -> Result<(), Failure> {
        let order: OrderSample = answer.read()?;
        let moment = moment(order.epoch, order.frame, order.time);
        let outcome = self.recorder.order(&moment, answer.bytes());
        outcome.map_err(|error| explain(self.arguments.out, error))
    }

    /// Writes an event; whether it is the last there will be.
    fn event(&mut self, answer: &Answer) -> Result<bool, Failure> {
        let event: Event = answer.read()?;
        let moment = moment(event.epoch, event.number, event.time);
        let outcome = self.recorder.event(&moment, answer.bytes());
        outcome.map_err(|error| explain(self.arguments.out, error))?;
        Ok(event.event == EventKind::Deleted {})
    }

    /// Ends the file, however the recording came to its end, and tells what is in it.
    fn finish(self, ended: Result<Ended, Failure>) -> Result<(), Failure> {
        let Take { name, out, .. } = *self.arguments;
        let missed = self.intake.missed;
        let closing = self.counts();
        self.bar.finish_and_clear();
        let finished = self.recorder.finish(&closing);
        let written = match (finished, &ended) {
            (Ok(written), _) => written,
            (Err(error), _) => {
                let partial = partial(out);
                if fs::exists(&partial).unwrap_or(false) {
                    self.output.note(&format!(
                        "{} holds what was recorded: `jostle record --recover {}` makes a whole \
                         file of it",
                        partial.display(),
                        out.display()
                    ));
                }
                // What went wrong first is the reason.
                return ended.and(Err(explain(out, error)));
            }
        };
        if let Ok(Ended::Deleted) = ended {
            self.output.note(
                &Failure::Deleted {
                    swarm: name.to_owned(),
                }
                .to_string(),
            );
        }
        tell(self.output, self.arguments, written, missed)?;
        ended.map(drop)
    }
}

/// What the recording says of itself.
async fn about(bus: &Bus, arguments: &Take<'_>) -> Result<About, Failure> {
    let name = arguments.name;
    let status: Reply<Status> = bus.get(name, "status").await?.read()?;
    let spec = bus.get(name, "spec").await?;
    let spec: Reply<Box<RawValue>> = spec.read()?;
    let parameters = status.result.parameters;
    let parameters = serde_json::to_string(&parameters).map_err(Failure::defect)?;
    let rate = serde_json::to_string(&status.result.rate).map_err(Failure::defect)?;
    let began = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let mut about = About::from([
        ("swarm".to_owned(), name.to_owned()),
        ("spec".to_owned(), spec.result.get().to_owned()),
        ("parameters".to_owned(), parameters),
        ("rate".to_owned(), rate),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        (
            "began_unix_secs".to_owned(),
            began.unwrap_or_default().as_secs().to_string(),
        ),
        (SOURCE.to_owned(), FROM_PUBLISHED.to_owned()),
    ]);
    if let Some(every) = arguments.every {
        about.insert("every".to_owned(), every.to_string());
    }
    Ok(about)
}

fn tell(
    output: Output,
    arguments: &Take<'_>,
    written: Written,
    missed: u64,
) -> Result<(), Failure> {
    let Written { frames, bytes, .. } = written;
    let (swarm, file) = (arguments.name, arguments.out.display().to_string());
    if output.json {
        let said = json!({
            "swarm": swarm, "file": file, "frames": frames, "missed": missed, "bytes": bytes,
            "source": FROM_PUBLISHED,
        });
        return output.data(&said.to_string());
    }
    output.data(&format!(
        "recorded {} of {swarm} to {file}, {}, of those that it published{}",
        format::count(frames, "frame"),
        format::bytes(bytes),
        self::missed(missed)
    ))
}

/// What is said of states that were published and did not come.
fn missed(missed: u64) -> String {
    match missed {
        0 => String::new(),
        1 => "; 1 was published and did not come".into(),
        _ => format!("; {missed} were published and did not come"),
    }
}

/// Reads a recorded state back.
fn decode(published: &[u8], take: &mut dyn FnMut(&Frame<'_>)) -> Result<(), String> {
    let state = State::from_cbor(published)?;
    take(&frame(&state, published));
    Ok(())
}

/// A state as it is recorded.
fn frame<'a>(state: &'a State, published: &'a [u8]) -> Frame<'a> {
    Frame {
        swarm: &state.swarm,
        moment: moment(state.epoch, state.frame, state.time),
        phase: state.phase.name(),
        step: state.step,
        origin: state.origin,
        id: &state.id,
        x: &state.x,
        y: &state.y,
        alpha: &state.alpha,
        weight: &state.weight,
        direction: &state.direction,
        order: state.order.order,
        drift: state.order.drift,
        worst_gap: state.certificate.worst_gap,
        residual: state.certificate.residual,
        contacts: state.certificate.contacts,
        published,
    }
}

fn moment(epoch: u64, number: u64, time: f64) -> Moment {
    Moment {
        epoch,
        number,
        time,
        taken: SystemTime::now(),
    }
}

/// The next sample of a stream; never one if there is none.
async fn next(samples: Option<&Samples>) -> zenoh::Result<Sample> {
    match samples {
        Some(samples) => samples.recv_async().await,
        None => std::future::pending().await,
    }
}

fn received(sample: zenoh::Result<Sample>) -> Result<Answer, Failure> {
    Ok(Answer::from(&sample.map_err(Failure::defect)?))
}

fn explain(out: &Path, error: RecordingError) -> Failure {
    let wrong = |problem: &str| Failure::Argument {
        argument: out.display().to_string(),
        problem: problem.to_owned(),
    };
    match error {
        RecordingError::UnknownKind { .. } => wrong("its name ends in neither .parquet nor .mcap"),
        RecordingError::Exists { .. } => wrong("is there already: --force replaces it"),
        RecordingError::Unfinished { path, partial } => wrong(&format!(
            "{} is there, left by a recording that was killed: `jostle record --recover {}` \
             turns it into a complete file; if you recovered it already, delete it",
            partial.display(),
            path.display()
        )),
        RecordingError::BeingWritten { path } => wrong(&format!(
            "another recording writes {}: end that first, or choose another name",
            path.display()
        )),
        RecordingError::Unreadable { path, reason } => Failure::Argument {
            argument: path.display().to_string(),
            problem: reason,
        },
        RecordingError::Io { path, source } => file_failure(&path, source),
        RecordingError::Unconverted { source, .. } => explain(out, *source),
        error @ RecordingError::Full { .. } => Failure::DiskFull {
            problem: error.to_string(),
        },
        error => Failure::defect(error),
    }
}

fn file_failure(path: &Path, error: io::Error) -> Failure {
    let path = path.display().to_string();
    Failure::File { path, error }
}

/// What goes on while it goes on; hidden unless stderr is a terminal.
fn bar(output: Output, arguments: &Take<'_>) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let template = match arguments.steps {
        Some(_) => "{prefix} {bar:20} {percent:>3}%  {wide_msg} {eta} left",
        None => "{prefix} {spinner} {elapsed} {msg}",
    };
    let bar = ProgressBar::with_draw_target(arguments.steps, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(arguments.name.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
