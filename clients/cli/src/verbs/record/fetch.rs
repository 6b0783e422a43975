//! A recording that the daemon makes, fetched part by part and made one file.
//!
//! The parts are stored next to the file until it is complete, so that a client that was killed or
//! lost its connection can resume. The daemon keeps its copy until the file is complete.

use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::time::{Duration, SystemTime};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use indicatif::ProgressBar;
use jostle_proto::{
    BeginRecordingArgs, Event, NodeReply, OrderSample, RecordArgs, Recording, RecordingFormat,
    RecordingName, RecordingPhase, RecordingPiece, Recordings, State,
};
use jostle_results::recording::{
    self, About, FROM_STEPS, Format, Frame, Message, Moment, Recorder, RecordingError, Written,
    parts,
};
use serde_json::json;
use tokio::time::{Instant, sleep};

use super::{Take, bar, decode, explain, frame};
use crate::arguments::{RecordArguments, SenderArguments};
use crate::bus::Bus;
use crate::failure::{Failure, is_unknown_name};
use crate::format;
use crate::interrupt;
use crate::output::Output;
use crate::verbs::lookout::{BACK, GONE, reach};

/// The interval between two queries of the recording's status.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// How long requests are retried if the daemon does not reply while the rest is fetched.
const MAX_SILENCE: Duration = Duration::from_secs(60);

/// How long an interrupted client waits for the reply to the request that begins a recording.
const BEGIN_GRACE: Duration = Duration::from_secs(5);

/// What an interrupted client prints if that reply does not come.
const NO_REPLY: &str = "the daemon did not reply in time; if it records the swarm, \
                        `jostle record --list` names the recording";

/// Why nothing was recorded by the daemon, or not to the end.
pub enum Stop {
    /// This client may not have the daemon record.
    NotPermitted(Failure),
    /// Anything else.
    Failed(Failure),
}

impl From<Failure> for Stop {
    fn from(failure: Failure) -> Self {
        Stop::Failed(failure)
    }
}

/// Has the daemon record a swarm, and fetches what it recorded.
///
/// # Errors
///
/// [`Stop`]; what the daemon has recorded stays with it unless the file is whole.
pub async fn record(
    bus: &Bus,
    output: Output,
    take: &Take<'_>,
    arguments: &RecordArguments,
) -> Result<(), Stop> {
    check(take.out, take.force)?;
    let begin = RecordArgs::Begin(BeginRecordingArgs {
        swarm: take.name.to_owned(),
        recording: None,
        format: None,
        every: take.every,
        steps: take.steps,
        drop_when_behind: arguments.drop_when_behind,
        max_bytes: arguments.max_size,
        temporary: true,
    });
    let sender = SenderArguments::default();
    // Without the name in the reply the recording cannot be stopped.
    let begun = bus.command_node("record", &begin, &sender);
    let begun = interrupt::after_grace(BEGIN_GRACE, NO_REPLY, begun).await;
    let begun: NodeReply<Recording> = match begun {
        Ok(answer) => answer.read()?,
        Err(failure) if failure.code() == "permission_denied" => {
            return Err(Stop::NotPermitted(failure));
        }
        Err(Failure::Refused { error, .. }) if is_unknown_name(&error) => {
            return Err(bus.no_swarm(take.name).await.into());
        }
        Err(failure) => return Err(failure.into()),
    };
    let mut fetching = Fetching {
        bus,
        output,
        out: take.out,
        force: take.force,
        bar: bar(output, take),
        recording: begun.result,
        part: 0,
        is_silent: false,
    };
    let done = fetching.follow(take.for_secs).await;
    fetching.bar.finish_and_clear();
    if done.is_err() {
        let Recording { recording, .. } = &fetching.recording;
        output.note(&format!(
            "the daemon has what was recorded: `jostle record --fetch {recording} -o {}`",
            take.out.display()
        ));
    }
    Ok(done?)
}

/// Fetches a recording of the daemon's that has ended, and deletes it there if it is a temporary one.
///
/// # Errors
///
/// Why it cannot be fetched; what was fetched is not fetched again.
pub async fn fetch(
    bus: &Bus,
    output: Output,
    name: &str,
    out: &Path,
    force: bool,
) -> Result<(), Failure> {
    check(out, force)?;
    let recording = standing(bus, name).await?;
    let wrong = |problem: String| Failure::Argument {
        argument: name.to_owned(),
        problem,
    };
    if recording.phase == RecordingPhase::Recording {
        return Err(wrong(format!(
            "still records: `jostle record --stop {name}` ends it"
        )));
    }
    if recording.format == RecordingFormat::Parquet {
        return Err(wrong(
            "is a folder of tables: Python's `client.fetch_recording` fetches it as it is".into(),
        ));
    }
    let take = Take {
        name,
        out,
        every: None,
        for_secs: None,
        steps: None,
        force,
    };
    let mut fetching = Fetching {
        bus,
        output,
        out,
        force,
        bar: bar(output, &take),
        recording,
        part: 0,
        is_silent: false,
    };
    let done = fetching.finish().await;
    fetching.bar.finish_and_clear();
    done
}

/// A request that is retried while the daemon does not reply.
#[derive(Clone, Copy)]
enum Question {
    /// Stop the recording.
    Stop,
    /// Query the recording's status.
    Look,
    /// Fetch the next piece.
    Piece,
}

/// A recording that is being fetched.
struct Fetching<'a> {
    bus: &'a Bus,
    output: Output,
    out: &'a Path,
    force: bool,
    bar: ProgressBar,
    /// The last status received.
    recording: Recording,
    /// The part that is fetched next.
    part: u64,
    /// Whether the daemon does not answer.
    is_silent: bool,
}

impl Fetching<'_> {
    /// Fetches parts while the daemon records, until it is enough; then the rest.
    async fn follow(&mut self, for_secs: Option<f64>) -> Result<(), Failure> {
        let end = for_secs.map(|secs| Instant::now() + Duration::from_secs_f64(secs));
        fs::create_dir_all(self.folder()).map_err(|error| self.file(error))?;
        {
            let mut interrupted = pin!(interrupt::asked_to_end());
            while self.recording.phase == RecordingPhase::Recording {
                tokio::select! {
                    biased;
                    () = &mut interrupted => {
                        self.bar.suspend(|| self.output.note(&self.leaving()));
                        break;
                    }
                    () = reach(end) => break,
                    went_on = self.go_on() => went_on?,
                }
            }
        }
        if self.recording.phase == RecordingPhase::Recording {
            self.patiently(Question::Stop).await?;
            self.patiently(Question::Look).await?;
        }
        self.finish().await
    }

    /// Fetches the next piece if a part is complete; otherwise sleeps and queries the status.
    async fn go_on(&mut self) -> Result<(), Failure> {
        let done = match self.part < self.recording.parts {
            true => self.piece().await,
            false => {
                sleep(POLL_INTERVAL).await;
                self.look().await
            }
        };
        match done {
            Ok(()) => {
                if std::mem::take(&mut self.is_silent) {
                    self.bar.suspend(|| self.output.note(BACK));
                }
                Ok(())
            }
            Err(failure) if is_passing(&failure) => {
                if !std::mem::replace(&mut self.is_silent, true) {
                    self.bar.suspend(|| self.output.note(GONE));
                }
                sleep(POLL_INTERVAL).await;
                Ok(())
            }
            Err(failure) => Err(failure),
        }
    }

    /// Sends a request and retries it while the daemon does not reply, for up to [`MAX_SILENCE`].
    async fn patiently(&mut self, question: Question) -> Result<(), Failure> {
        let deadline = Instant::now() + MAX_SILENCE;
        loop {
            let answered = match question {
                Question::Stop => self.stop().await,
                Question::Look => self.look().await,
                Question::Piece => self.piece().await,
            };
            match answered {
                Err(failure) if is_passing(&failure) && Instant::now() < deadline => {
                    sleep(POLL_INTERVAL).await;
                }
                answered => return answered,
            }
        }
    }

    /// Ends the recording.
    async fn stop(&self) -> Result<(), Failure> {
        let recording = self.recording.recording.clone();
        let stop = RecordArgs::Stop(RecordingName { recording });
        let sender = SenderArguments::default();
        match self.bus.command_node("record", &stop, &sender).await {
            // It has failed meanwhile, as the list says.
            Err(failure) if failure.code() == "incorrect_state" => Ok(()),
            stopped => stopped.map(drop),
        }
    }

    async fn look(&mut self) -> Result<(), Failure> {
        self.recording = standing(self.bus, &self.recording.recording).await?;
        let Recording {
            frames,
            missed,
            every,
            ..
        } = self.recording;
        if self.bar.length().is_some() {
            let steps = frames.saturating_sub(1).saturating_mul(every.unwrap_or(1));
            self.bar.set_position(steps);
        }
        self.bar.set_message(format!(
            "{}{}",
            format::count(frames, "frame"),
            left_out(missed)
        ));
        Ok(())
    }

    /// Fetches the next piece of the part in hand.
    async fn piece(&mut self) -> Result<(), Failure> {
        let path = self.folder().join(format!("part-{:05}.mcap", self.part));
        let offset = fs::metadata(&path).map_or(0, |it| it.len());
        let (name, part) = (&self.recording.recording, self.part);
        let noun = format!("recording?name={name};part={part};offset={offset}");
        let reply: NodeReply<RecordingPiece> = self.bus.get_node(&noun).await?.read()?;
        let piece = reply.result;
        let bytes = STANDARD.decode(&piece.bytes).map_err(Failure::unreadable)?;
        let mut options = OpenOptions::new();
        let file = options.create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(&bytes));
        written.map_err(|error| self.file(error))?;
        if offset + bytes.len() as u64 >= piece.length {
            self.part += 1;
        }
        Ok(())
    }

    /// Fetches the rest, makes it one file, and deletes the parts and the daemon's copy.
    async fn finish(&mut self) -> Result<(), Failure> {
        fs::create_dir_all(self.folder()).map_err(|error| self.file(error))?;
        while self.part < self.recording.parts {
            self.patiently(Question::Piece).await?;
        }
        let written = self.assemble().map_err(|error| {
            // A retry builds the file again from the parts, and fetches those that are missing.
            let _ = fs::remove_file(beside(self.out, recording::PARTIAL));
            self.unassembled(error)
        })?;
        fs::remove_dir_all(self.folder()).map_err(|error| self.file(error))?;
        let is_kept = !self.recording.temporary || self.delete().await.is_err();
        self.tell(written, is_kept)?;
        match (self.recording.phase, &self.recording.reason) {
            (RecordingPhase::Failed, Some(reason)) => Err(Failure::DiskFull {
                problem: format!("the recording on the daemon failed: {reason}"),
            }),
            _ => Ok(()),
        }
    }

    /// Makes one file of the parts.
    fn assemble(&self) -> Result<Written, RecordingError> {
        let about = About::from([("swarm".to_owned(), self.recording.swarm.clone())]);
        let mut recorder = Recorder::to_file(self.out, self.force, about, decode)?;
        let mut closing = About::new();
        for part in parts(&self.folder())? {
            let mut failed = None;
            let read = recording::read(&part, |message| {
                let copied = copy(&mut recorder, &message)?;
                copied.map_err(|error| {
                    let reason = error.to_string();
                    failed = Some(error);
                    reason
                })
            });
            match (read, failed) {
                (_, Some(error)) | (Err(error), None) => return Err(error),
                (Ok(about), None) => closing.extend(about),
            }
        }
        let Recording { missed, .. } = self.recording;
        let frames = recorder.written().frames.to_string();
        closing.extend([
            ("frames".to_owned(), frames),
            ("missed".to_owned(), missed.to_string()),
        ]);
        recorder.finish(&closing)
    }

    /// The error for parts that could not be combined. Deletes damaged parts so that a retry
    /// fetches them again.
    fn unassembled(&self, error: RecordingError) -> Failure {
        let RecordingError::Unreadable { reason, .. } = error else {
            return explain(self.out, error);
        };
        let _ = fs::remove_dir_all(self.folder());
        Failure::Argument {
            argument: self.recording.recording.clone(),
            problem: format!("a part of it is damaged ({reason}): fetch it again"),
        }
    }

    async fn delete(&self) -> Result<(), Failure> {
        let recording = self.recording.recording.clone();
        let delete = RecordArgs::Delete(RecordingName { recording });
        let sender = SenderArguments::default();
        let deleted = self.bus.command_node("record", &delete, &sender).await;
        deleted.map(drop)
    }

    fn tell(&self, written: Written, is_kept: bool) -> Result<(), Failure> {
        let Recording {
            recording,
            swarm,
            every,
            missed,
            reason,
            ..
        } = &self.recording;
        let file = self.out.display().to_string();
        let Written { frames, bytes, .. } = written;
        if self.output.json {
            let said = json!({
                "swarm": swarm, "file": file, "frames": frames, "missed": missed, "bytes": bytes,
                "source": FROM_STEPS, "every": every, "recording": recording, "reason": reason,
                "kept": is_kept,
            });
            return self.output.data(&said.to_string());
        }
        if let Some(reason) = reason.as_ref().filter(|it| *it != "stopped") {
            self.output
                .note(&format!("the recording has ended: {reason}"));
        }
        if is_kept && self.recording.temporary {
            self.output.note(&format!(
                "the daemon still has its copy: `jostle record --delete {recording}`"
            ));
        }
        let which = match every {
            Some(1) => ", every step".to_owned(),
            Some(every) => format!(", every step that is a multiple of {every}"),
            None => String::new(),
        };
        self.output.data(&format!(
            "recorded {} of {swarm} to {file}, {}{which}{}",
            format::count(frames, "frame"),
            format::bytes(bytes),
            left_out(*missed)
        ))
    }

    /// The note after the first Ctrl-C.
    fn leaving(&self) -> String {
        let Recording { recording, .. } = &self.recording;
        format!(
            "fetching the rest; press Ctrl-C again to leave it on the daemon and fetch it later: \
             `jostle record --fetch {recording} -o {}`",
            self.out.display()
        )
    }

    fn file(&self, error: io::Error) -> Failure {
        Failure::File {
            path: self.folder().display().to_string(),
            error,
        }
    }

    /// Where the parts are until the file is whole. A recording that was deleted may have had the same
    /// name.
    fn folder(&self) -> PathBuf {
        let Recording {
            recording,
            began_unix_secs,
            ..
        } = &self.recording;
        beside(self.out, &format!("{recording}-{began_unix_secs}.parts"))
    }
}

/// Copies a message of a part; the outer error says that it cannot be read.
fn copy(
    recorder: &mut Recorder,
    message: &Message<'_>,
) -> Result<Result<(), RecordingError>, String> {
    let taken = SystemTime::UNIX_EPOCH + Duration::from_nanos(message.header.publish_time);
    let at = |epoch, number, time| Moment {
        epoch,
        number,
        time,
        taken,
    };
    let text = |error: serde_json::Error| error.to_string();
    let bytes = message.bytes;
    Ok(match message.topic {
        "state" => {
            let state = State::from_cbor(bytes).map_err(|error| error.to_string())?;
            recorder.frame(&Frame {
                moment: at(state.epoch, state.frame, state.time),
                ..frame(&state, bytes)
            })
        }
        "order" => {
            let order: OrderSample = serde_json::from_slice(bytes).map_err(text)?;
            recorder.order(&at(order.epoch, order.frame, order.time), bytes)
        }
        "event" => {
            let event: Event = serde_json::from_slice(bytes).map_err(text)?;
            recorder.event(&at(event.epoch, event.number, event.time), bytes)
        }
        _ => Ok(()),
    })
}

/// How a recording of the daemon's stands.
async fn standing(bus: &Bus, name: &str) -> Result<Recording, Failure> {
    let reply: NodeReply<Recordings> = bus.get_node("recordings").await?.read()?;
    let mut recordings = reply.result.recordings.into_iter();
    recordings
        .find(|it| it.recording == name)
        .ok_or_else(|| Failure::Argument {
            argument: name.to_owned(),
            problem: "is no recording of the daemon's: `jostle record --list` shows what there is"
                .to_owned(),
        })
}

/// Refuses a file that could not be written at the end, before anything is recorded.
fn check(out: &Path, force: bool) -> Result<(), Failure> {
    Format::of(out).map_err(|error| explain(out, error))?;
    if !force && fs::symlink_metadata(out).is_ok() {
        let path = out.to_owned();
        return Err(explain(out, RecordingError::Exists { path }));
    }
    let partial = beside(out, recording::PARTIAL);
    if fs::symlink_metadata(&partial).is_ok() {
        let path = out.to_owned();
        let error = match recording::is_being_written(&partial) {
            true => RecordingError::BeingWritten { path: partial },
            false => RecordingError::Unfinished { path, partial },
        };
        return Err(explain(out, error));
    }
    // The folder must be there and writable. A client that was killed here has left its probe.
    let probe = beside(out, "parts");
    let made = match fs::create_dir(&probe) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        made => made,
    };
    let made = made.and_then(|()| fs::remove_dir(&probe));
    made.map_err(|error| Failure::File {
        path: out.display().to_string(),
        error,
    })
}

/// The error for a file that does not exist because its recording is still to be fetched from the
/// daemon: its parts are next to it.
///
/// # Errors
///
/// [`Failure::Argument`], with the command that fetches it.
pub fn check_fetched(out: &Path) -> Result<(), Failure> {
    if out.exists() {
        return Ok(());
    }
    let Some(recording) = unfetched(out) else {
        return Ok(());
    };
    let argument = out.display().to_string();
    Err(Failure::Argument {
        problem: format!(
            "does not exist, but the daemon has the recording: run `jostle record --fetch \
             {recording} -o {argument}`"
        ),
        argument,
    })
}

/// The recording whose parts are next to `out`.
fn unfetched(out: &Path) -> Option<String> {
    let start = beside(out, "");
    let start = start.file_name()?.to_str()?;
    let folder = out.parent().filter(|it| !it.as_os_str().is_empty());
    let entries = fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let mut names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.find_map(|name| {
        let of_recording = name.strip_prefix(start)?.strip_suffix(".parts")?;
        let (recording, _) = of_recording.rsplit_once('-')?;
        Some(recording.to_owned())
    })
}

/// The file's name with an ending.
fn beside(out: &Path, ending: &str) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(ending);
    out.with_file_name(name)
}

/// Whether the daemon may answer later.
fn is_passing(failure: &Failure) -> bool {
    let is_silent = matches!(
        failure,
        Failure::Silent { .. } | Failure::UnknownNode { .. }
    );
    is_silent || (failure.code() != "permission_denied" && failure.is_passing())
}

/// What is said of states that the daemon left out.
pub fn left_out(missed: u64) -> String {
    match missed {
        0 => String::new(),
        _ => format!("; {missed} were left out because the disk was behind"),
    }
}
