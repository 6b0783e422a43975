//! `record`: the daemon records every k-th state of a swarm, and a client may fetch the recording
//! into a file; or the client records the published states.

mod daemon;
mod fetch;
mod frame_filter;
mod recover;

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::pin::pin;
use std::time::{Duration, SystemTime};

use indicatif::ProgressBar;
use jostle_client::{Client, EventsFrom, Follow, FollowOptions, Message, Update};
use jostle_proto::{Reply, State};
use jostle_results::recording::{
    About, FROM_PUBLISHED, Format, Frame, Moment, Recorder, RecordingError, SOURCE, partial,
};
use serde_json::json;
use serde_json::value::RawValue;
use tokio::time::Instant;

pub use self::fetch::check_fetched;
use self::frame_filter::FrameFilter;
pub use self::recover::recover;
use crate::arguments::RecordArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::progress;
use crate::verbs::outage::{DAEMON_AWAY, DAEMON_BACK, wait_for_deadline};

/// The capacity of the queue of samples to write, some seconds; the oldest are dropped.
const CAPACITY: usize = 512;

/// How often received samples are flushed to the operating system and synced to the disk: a kill of
/// this process or a power failure loses about as much.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);

/// The template of a recording whose steps are not known.
const SPINNER: &str = "{prefix} {spinner} {elapsed} {msg}";

/// Records a swarm to a file, or manages the recordings of the daemon.
pub async fn record(context: &Context, arguments: &RecordArguments) -> Result<(), Failure> {
    match (&arguments.name, &arguments.out, &arguments.fetch) {
        (Some(swarm), Some(out), _) => {
            let target = Target {
                swarm,
                out,
                arguments,
            };
            if arguments.published {
                return record_published(context, target).await;
            }
            match fetch::record(context, target).await {
                Err(fetch::RecordError::NotPermitted(failure)) => {
                    let note = format!("{failure}; recording what is published instead");
                    context.output.note(&note);
                    record_published(context, target).await
                }
                Err(fetch::RecordError::Failed(failure)) => Err(failure),
                Ok(()) => Ok(()),
            }
        }
        (None, Some(out), Some(recording)) => {
            let fetched = fetch::fetch(context, recording, out, arguments.force);
            interrupt::either(fetched).await
        }
        _ => interrupt::either(daemon::record(context, arguments)).await,
    }
}

/// A swarm to record to a file.
#[derive(Clone, Copy)]
struct Target<'a> {
    swarm: &'a str,
    out: &'a Path,
    arguments: &'a RecordArguments,
}

impl Target<'_> {
    /// A bar over the steps to record, or a spinner.
    fn bar(&self, output: Output) -> ProgressBar {
        let steps = self.arguments.steps;
        let template = match steps {
            Some(_) => progress::STEPS,
            None => SPINNER,
        };
        progress::bar(output, steps, template, self.swarm)
    }

    /// When to end.
    fn deadline(&self) -> Option<Instant> {
        let duration = self.arguments.for_secs.map(Duration::from_secs_f64);
        duration.map(|duration| Instant::now() + duration)
    }
}

/// Records the published states.
async fn record_published(context: &Context, target: Target<'_>) -> Result<(), Failure> {
    let mut recording = interrupt::either(Recording::begin(context, target)).await?;
    interrupt::complete_first(recovers(target.out));
    let ended = recording.follow().await;
    recording.finish(ended)
}

/// A recording that is being made.
struct Recording<'a> {
    output: Output,
    target: Target<'a>,
    recorder: Recorder,
    filter: FrameFilter,
    updates: Follow,
    end: Option<Instant>,
    /// When to flush.
    flush_due: Instant,
    /// A sync in progress, on a thread that may block on the disk.
    syncing: Option<tokio::task::JoinHandle<io::Result<()>>>,
    bar: ProgressBar,
}

/// How a recording ended, if there was no error.
enum Ended {
    Enough,
    Interrupted,
    Deleted,
}

impl<'a> Recording<'a> {
    async fn begin(context: &Context, target: Target<'a>) -> Result<Self, Failure> {
        let Context { client, output } = context;
        let Target {
            swarm,
            out,
            arguments,
        } = target;
        let format = Format::of(out).map_err(|error| explain(out, error))?;
        let options = FollowOptions {
            states: Some(CAPACITY),
            // Only MCAP holds order samples.
            order: matches!(format, Format::Mcap).then_some(CAPACITY),
            events: Some(EventsFrom::Now),
            ..FollowOptions::default()
        };
        // Subscribes first: a change of a parameter is in the metadata or among the events.
        let updates = client.follow(swarm, options).await?;
        let about = about(client, swarm, arguments.every).await?;
        let recorder = Recorder::to_file(out, arguments.force, about, decode)
            .map_err(|error| explain(out, error))?;
        let mut recording = Recording {
            updates,
            output: *output,
            target,
            recorder,
            filter: FrameFilter::new(arguments.every),
            end: target.deadline(),
            flush_due: Instant::now(),
            syncing: None,
            bar: target.bar(*output),
        };
        // The present state is available at once.
        if let Some(update) = recording.updates.try_next() {
            recording.write(update?)?;
        }
        Ok(recording)
    }

    /// Writes the updates until the recording ends.
    async fn follow(&mut self) -> Result<Ended, Failure> {
        let mut interrupted = pin!(interrupt::interrupted_or_terminated());
        let steps = self.target.arguments.steps;
        while steps.is_none_or(|steps| self.filter.steps < steps) {
            tokio::select! {
                biased;
                () = &mut interrupted => return Ok(Ended::Interrupted),
                () = wait_for_deadline(self.end) => return Ok(Ended::Enough),
                () = tokio::time::sleep_until(self.flush_due) => self.flush().await?,
                update = self.updates.next() => match update.transpose()? {
                    Some(Update::Deleted) | None => return Ok(Ended::Deleted),
                    Some(update) => self.write(update)?,
                }
            }
        }
        Ok(Ended::Enough)
    }

    /// Flushes the received samples, and starts a sync unless one is in progress.
    async fn flush(&mut self) -> Result<(), Failure> {
        self.flush_due = Instant::now() + FLUSH_INTERVAL;
        let out = self.target.out;
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
            ("missed".to_owned(), self.filter.missed.to_string()),
        ])
    }

    fn write(&mut self, update: Update) -> Result<(), Failure> {
        let written = match update {
            Update::State(state) => return self.state(&state),
            Update::Order(order) => {
                let moment = moment(order.epoch, order.frame, order.time);
                self.recorder.order(&moment, order.payload.bytes())
            }
            Update::Event(event) => {
                let moment = moment(event.epoch, event.number, event.time);
                self.recorder.event(&moment, event.payload.bytes())
            }
            Update::Away | Update::Back => {
                let note = match update {
                    Update::Away => DAEMON_AWAY,
                    _ => DAEMON_BACK,
                };
                self.bar.suspend(|| self.output.note(note));
                Ok(())
            }
            _ => Ok(()),
        };
        written.map_err(|error| explain(self.target.out, error))
    }

    fn state(&mut self, state: &Message<State>) -> Result<(), Failure> {
        if !self.filter.accepts(state) {
            return Ok(());
        }
        let mut frame = frame(state, state.payload.bytes());
        frame.attachment = state.payload.attachment();
        frame.moment.taken = state.published_at().unwrap_or(frame.moment.taken);
        let outcome = self.recorder.frame(&frame);
        outcome.map_err(|error| explain(self.target.out, error))?;
        if let Some(steps) = self.target.arguments.steps {
            self.bar.set_position(self.filter.steps.min(steps));
        }
        self.bar.set_message(format!(
            "time {}, {}{}",
            format::time(state.time),
            format::count(self.recorder.written().frames, "frame"),
            missed_note(self.filter.missed)
        ));
        Ok(())
    }

    /// Ends the file, however the recording ended, and prints what it contains.
    fn finish(self, ended: Result<Ended, Failure>) -> Result<(), Failure> {
        let Target { swarm, out, .. } = self.target;
        let missed = self.filter.missed;
        let closing = self.counts();
        self.bar.finish_and_clear();
        let finished = self.recorder.finish(&closing);
        let written = match finished {
            Ok(written) => written,
            Err(error) => {
                if fs::exists(partial(out)).unwrap_or(false) {
                    self.output.note(&recovers(out));
                }
                // The first error is the reason.
                return ended.and(Err(explain(out, error)));
            }
        };
        if let Ok(Ended::Deleted) = ended {
            self.output.note(&Failure::deleted(swarm).to_string());
        }
        let (frames, bytes) = (written.frames, written.bytes);
        let file = out.display().to_string();
        let document = json!({
            "swarm": swarm, "file": file, "frames": frames, "missed": missed, "bytes": bytes,
            "source": FROM_PUBLISHED,
        });
        let text = format!(
            "recorded {} of {swarm} to {file}, {}, of those that it published{}",
            format::count(frames, "frame"),
            format::bytes(bytes),
            missed_note(missed)
        );
        self.output.print(&document, &text)?;
        ended.map(drop)
    }
}

/// What recovers a file that was not completed.
fn recovers(out: &Path) -> String {
    format!(
        "{} holds what was recorded: `jostle record --recover {}` makes a whole file of it",
        partial(out).display(),
        out.display()
    )
}

/// The metadata of the recording.
async fn about(client: &Client, swarm: &str, every: Option<u64>) -> Result<About, Failure> {
    let status = client.status(swarm).await?;
    let spec = client.get(swarm, "spec").await?;
    let spec: Reply<Box<RawValue>> = spec.read()?;
    let parameters = status.result.parameters;
    let parameters = serde_json::to_string(&parameters).map_err(Failure::defect)?;
    let rate = serde_json::to_string(&status.result.rate).map_err(Failure::defect)?;
    let began = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let mut about = About::from([
        ("swarm".to_owned(), swarm.to_owned()),
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
    if let Some(every) = every {
        about.insert("every".to_owned(), every.to_string());
    }
    Ok(about)
}

/// The note about states that were published but not received.
fn missed_note(missed: u64) -> String {
    match missed {
        0 => String::new(),
        1 => "; 1 was published but not received".into(),
        _ => format!("; {missed} were published but not received"),
    }
}

/// Reads a recorded state back.
fn decode(published: &[u8], record: &mut dyn FnMut(&Frame<'_>)) -> Result<(), String> {
    let state = State::from_cbor(published)?;
    record(&frame(&state, published));
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
        attachment: None,
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

fn explain(out: &Path, error: RecordingError) -> Failure {
    let wrong = |problem: &str| Failure::argument(out.display(), problem.to_owned());
    match error {
        RecordingError::UnknownKind { .. } => wrong("its name ends in neither .parquet nor .mcap"),
        RecordingError::Exists { .. } => wrong("already exists: --force replaces it"),
        RecordingError::Unfinished { path, partial } => wrong(&format!(
            "{} exists, left by a recording that was killed: `jostle record --recover {}` \
             turns it into a complete file; if you recovered it already, delete it",
            partial.display(),
            path.display()
        )),
        RecordingError::BeingWritten { path } => wrong(&format!(
            "another recording writes {}: end that first, or choose another name",
            path.display()
        )),
        RecordingError::Unreadable { path, reason } => Failure::argument(path.display(), reason),
        RecordingError::Io { path, source } => file_failure(&path, source),
        RecordingError::Unconverted { source, .. } => explain(out, *source),
        error @ RecordingError::Full { .. } => Failure::disk_full(error),
        error => Failure::defect(error),
    }
}

fn file_failure(path: &Path, error: io::Error) -> Failure {
    Failure::file(path.display(), error)
}
