//! A recording of the daemon, fetched in parts and combined into one file.
//!
//! The parts are stored next to the file until it is complete, so that a client that was killed or
//! lost its connection can resume. The daemon keeps its copy until the file is complete.

mod files;

use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use indicatif::ProgressBar;
use jostle_client::{CommandOptions, Error};
use jostle_proto::{
    BeginRecordingArgs, ErrorCode, NodeReply, RecordArgs, RecordedAt, Recording, RecordingFormat,
    RecordingGap, RecordingName, RecordingPhase, RecordingPiece, Recordings,
};
use jostle_results::recording::{
    self, About, FROM_STEPS, Recorder, RecordingError, Written, parts,
};
use serde_json::json;
use tokio::time::{Instant, sleep};

pub use self::files::check_fetched;
use self::files::{check_writable, copy, with_suffix};
use super::{SPINNER, Target, decode, explain};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::interrupt;
use crate::progress;
use crate::verbs::outage::{DAEMON_AWAY, DAEMON_BACK, wait_for_deadline};

/// The interval between two queries of the recording's status.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// How long requests are retried if the daemon does not reply while the rest is fetched.
const MAX_SILENCE: Duration = Duration::from_secs(60);

/// How long an interrupted client waits for the reply to the request that begins a recording.
const BEGIN_GRACE: Duration = Duration::from_secs(5);

/// What an interrupted client prints if that reply does not come.
const NO_REPLY: &str = "the daemon did not reply in time; if it records the swarm, \
                        `jostle record --list` names the recording, and `jostle record --stop NAME` \
                        ends it";

/// Why the daemon did not record, or stopped early.
pub enum RecordError {
    /// This client is not permitted to `record`.
    NotPermitted(Failure),
    /// Any other error.
    Failed(Failure),
}

impl From<Failure> for RecordError {
    fn from(failure: Failure) -> Self {
        RecordError::Failed(failure)
    }
}

/// Records a swarm on the daemon and fetches the recording.
pub async fn record(context: &Context, target: Target<'_>) -> Result<(), RecordError> {
    let Context { client, output } = context;
    let Target {
        swarm,
        out,
        arguments,
    } = target;
    check_writable(out, arguments.force)?;
    let begin = RecordArgs::Begin(BeginRecordingArgs {
        swarm: swarm.to_owned(),
        recording: None,
        format: None,
        every: arguments.every,
        steps: arguments.steps,
        drop_when_behind: arguments.drop_when_behind,
        max_bytes: arguments.max_size,
        temporary: true,
    });
    // The first Ctrl-C fetches the rest, a second one leaves it on the daemon.
    interrupt::complete_first(NO_REPLY);
    // Only the reply has the name by which the recording can be stopped.
    let begun = client.command_node("record", &begin, CommandOptions::default());
    let begun = interrupt::after_grace(BEGIN_GRACE, NO_REPLY, begun).await;
    let begun: NodeReply<Recording> = match begun {
        Ok(answer) => answer.read().map_err(Failure::from)?,
        Err(failure) if failure.code() == "permission_denied" => {
            return Err(RecordError::NotPermitted(failure));
        }
        Err(failure) if failure.is_unknown_name() => {
            return Err(Failure::from(client.no_swarm(swarm).await).into());
        }
        Err(failure) => return Err(failure.into()),
    };
    let mut fetching = Fetching {
        context,
        out,
        force: arguments.force,
        bar: target.bar(*output),
        recording: begun.result,
        part: 0,
        is_silent: false,
    };
    interrupt::complete_first(fetching.left());
    let done = fetching.follow(target.deadline()).await;
    fetching.bar.finish_and_clear();
    if done.is_err() {
        output.note(&fetching.left());
    }
    Ok(done?)
}

/// Fetches a recording that has ended, and deletes it on the daemon if it is temporary.
pub async fn fetch(context: &Context, name: &str, out: &Path, force: bool) -> Result<(), Failure> {
    check_writable(out, force)?;
    let recording = status(context, name).await?;
    let wrong = |problem: String| Failure::argument(name, problem);
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
    let mut fetching = Fetching {
        context,
        out,
        force,
        bar: progress::bar(context.output, None, SPINNER, name),
        recording,
        part: 0,
        is_silent: false,
    };
    let done = fetching.finish().await;
    fetching.bar.finish_and_clear();
    done
}

/// A recording that is being fetched.
struct Fetching<'a> {
    context: &'a Context,
    out: &'a Path,
    force: bool,
    bar: ProgressBar,
    /// The last status received.
    recording: Recording,
    /// The part that is fetched next.
    part: u64,
    /// Whether the daemon does not reply.
    is_silent: bool,
}

impl Fetching<'_> {
    /// Fetches parts while the daemon records, until the end or Ctrl-C, and then the rest.
    async fn follow(&mut self, end: Option<Instant>) -> Result<(), Failure> {
        fs::create_dir_all(self.folder()).map_err(|error| self.file(error))?;
        {
            let mut interrupted = pin!(interrupt::interrupted_or_terminated());
            while self.recording.phase == RecordingPhase::Recording {
                tokio::select! {
                    biased;
                    () = &mut interrupted => {
                        self.note(&format!(
                            "fetching the rest; press Ctrl-C again to leave it on the daemon and \
                             fetch it later: {}",
                            self.command()
                        ));
                        break;
                    }
                    () = wait_for_deadline(end) => break,
                    advanced = self.advance() => advanced?,
                }
            }
        }
        if self.recording.phase == RecordingPhase::Recording {
            retry(async || self.stop().await).await?;
            self.recording = retry(async || self.query_status().await).await?;
        }
        interrupt::complete_first(self.left());
        self.finish().await
    }

    /// Fetches the next piece if a part is complete; otherwise sleeps and queries the status.
    async fn advance(&mut self) -> Result<(), Failure> {
        let done = if self.part < self.recording.parts {
            let piece = self.piece().await;
            piece.map(|is_last| self.part += u64::from(is_last))
        } else {
            sleep(POLL_INTERVAL).await;
            let status = self.query_status().await;
            status.map(|recording| self.recording = recording)
        };
        match done {
            Ok(()) => {
                if std::mem::take(&mut self.is_silent) {
                    self.note(DAEMON_BACK);
                }
                Ok(())
            }
            Err(failure) if may_pass(&failure) => {
                if !std::mem::replace(&mut self.is_silent, true) {
                    self.note(DAEMON_AWAY);
                }
                sleep(POLL_INTERVAL).await;
                Ok(())
            }
            Err(failure) => Err(failure),
        }
    }

    fn note(&self, text: &str) {
        self.bar.suspend(|| self.context.output.note(text));
    }

    /// Ends the recording.
    async fn stop(&self) -> Result<(), Failure> {
        let recording = self.recording.recording.clone();
        let stop = RecordArgs::Stop(RecordingName { recording });
        let client = &self.context.client;
        match client
            .command_node("record", &stop, CommandOptions::default())
            .await
        {
            // The recording has failed meanwhile; its status has the reason.
            Err(Error::Rejected(error)) if error.code == ErrorCode::IncorrectState => Ok(()),
            stopped => Ok(stopped.map(drop)?),
        }
    }

    /// Queries the status, and moves the bar.
    async fn query_status(&self) -> Result<Recording, Failure> {
        let recording = status(self.context, &self.recording.recording).await?;
        let Recording { frames, every, .. } = recording;
        if self.bar.length().is_some() {
            let steps = frames.saturating_sub(1).saturating_mul(every.unwrap_or(1));
            self.bar.set_position(steps);
        }
        let frames = format::count(frames, "frame");
        let missing = missing_note(&recording);
        self.bar.set_message(format!("{frames}{missing}"));
        Ok(recording)
    }

    /// Fetches the next piece of the current part; returns whether the part is complete.
    async fn piece(&self) -> Result<bool, Failure> {
        let path = self.folder().join(format!("part-{:05}.mcap", self.part));
        let offset = fs::metadata(&path).map_or(0, |it| it.len());
        let (name, part) = (&self.recording.recording, self.part);
        let noun = format!("recording?name={name};part={part};offset={offset}");
        let reply: NodeReply<RecordingPiece> = self.context.client.get_node(&noun).await?.read()?;
        let piece = reply.result;
        if piece.parts < self.recording.parts {
            return Err(Failure::new(
                "not_found",
                format!(
                    "{name} has {} of its {} parts left: `jostle record --list` names those that are \
                     missing, {} fetches the rest",
                    piece.parts,
                    self.recording.parts,
                    self.command()
                ),
            ));
        }
        let bytes = STANDARD.decode(&piece.bytes).map_err(Failure::unreadable)?;
        let mut options = OpenOptions::new();
        let file = options.create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(&bytes));
        written.map_err(|error| self.file(error))?;
        Ok(offset + bytes.len() as u64 >= piece.length)
    }

    /// Fetches the rest, combines the parts, and deletes them and the daemon's copy.
    async fn finish(&mut self) -> Result<(), Failure> {
        fs::create_dir_all(self.folder()).map_err(|error| self.file(error))?;
        while self.part < self.recording.parts {
            let is_complete = retry(async || self.piece().await).await?;
            self.part += u64::from(is_complete);
        }
        let written = self.assemble().map_err(|error| {
            // A retry builds the file again from the parts, and fetches those that are missing.
            let _ = fs::remove_file(with_suffix(self.out, recording::PARTIAL));
            self.assemble_failure(error)
        })?;
        fs::remove_dir_all(self.folder()).map_err(|error| self.file(error))?;
        let Recording {
            temporary,
            lost_parts,
            ..
        } = self.recording;
        // What is missing may be put back.
        let is_kept = !temporary || lost_parts > 0 || self.delete().await.is_err();
        self.print(written, is_kept)?;
        match (self.recording.phase, &self.recording.reason) {
            (_, Some(reason)) if lost_parts > 0 => Err(Failure::new(
                "not_found",
                format!("the recording on the daemon lacks files: {reason}"),
            )),
            (RecordingPhase::Failed, Some(reason)) => Err(Failure::disk_full(format!(
                "the recording on the daemon failed: {reason}"
            ))),
            _ => Ok(()),
        }
    }

    /// Combines the parts into one file.
    fn assemble(&self) -> Result<Written, RecordingError> {
        let parts = parts(&self.folder())?;
        // A file that is cut has no metadata at its end: the spec must be at its beginning, too.
        let mut about = match parts.first() {
            Some(part) => recording::read(part, |_| Ok(()))?,
            None => About::new(),
        };
        // Of a part, not of the whole recording.
        let of_part = |key: &str| ["frames", "missed", "counted_to"].contains(&key);
        about.retain(|key, _| !of_part(key));
        about.insert("swarm".to_owned(), self.recording.swarm.clone());
        let mut recorder = Recorder::to_file(self.out, self.force, about, decode)?;
        let mut closing = About::new();
        for part in parts {
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
        let Recording {
            missed, lost_parts, ..
        } = self.recording;
        closing.retain(|key, _| !of_part(key));
        let frames = recorder.written().frames;
        closing.extend(
            [
                ("frames", frames),
                ("missed", missed),
                ("lost_parts", lost_parts),
            ]
            .map(|(key, number)| (key.to_owned(), number.to_string())),
        );
        recorder.finish(&closing)
    }

    /// The error for parts that could not be combined. Deletes damaged parts so that a retry
    /// fetches them again.
    fn assemble_failure(&self, error: RecordingError) -> Failure {
        let RecordingError::Unreadable { reason, .. } = error else {
            return explain(self.out, error);
        };
        let _ = fs::remove_dir_all(self.folder());
        Failure::argument(
            &self.recording.recording,
            format!(
                "a part of it is damaged ({reason}): fetch it again; if that fails, too, the part is \
                 damaged on the daemon's disk, and a backup of the daemon may have it whole"
            ),
        )
    }

    async fn delete(&self) -> Result<(), Failure> {
        let recording = self.recording.recording.clone();
        let delete = RecordArgs::Delete(RecordingName { recording });
        let client = &self.context.client;
        client
            .command_node("record", &delete, CommandOptions::default())
            .await?;
        Ok(())
    }

    fn print(&self, written: Written, is_kept: bool) -> Result<(), Failure> {
        let Recording {
            recording,
            swarm,
            every,
            missed,
            lost,
            gap,
            lost_parts,
            reason,
            ..
        } = &self.recording;
        let file = self.out.display().to_string();
        let Written { frames, bytes, .. } = written;
        let output = self.context.output;
        if output.json {
            return output.document(&json!({
                "swarm": swarm, "file": file, "frames": frames, "missed": missed,
                "lost_parts": lost_parts, "bytes": bytes,
                "source": FROM_STEPS, "every": every, "recording": recording, "reason": reason,
                "kept": is_kept, "lost": lost, "gap": gap,
            }));
        }
        if let Some(reason) = reason.as_ref().filter(|it| *it != "stopped") {
            output.note(&format!("the recording has ended: {reason}"));
        }
        if is_kept && self.recording.temporary {
            output.note(&format!(
                "the daemon still has its copy: `jostle record --delete {recording}`"
            ));
        }
        let which = match every {
            Some(1) => ", every step".to_owned(),
            Some(every) => format!(", every step that is a multiple of {every}"),
            None => String::new(),
        };
        output.data(&format!(
            "recorded {} of {swarm} to {file}, {}{which}{}{}",
            format::count(frames, "frame"),
            format::bytes(bytes),
            missing_note(&self.recording),
            lost_note(*lost_parts)
        ))
    }

    /// What the daemon has or goes on with if the client ends.
    fn left(&self) -> String {
        let Recording {
            recording, phase, ..
        } = &self.recording;
        let fetch = self.command();
        match phase {
            RecordingPhase::Recording => format!(
                "the daemon may record on: `jostle record --stop {recording}` ends it, and {fetch} \
                 fetches what was recorded"
            ),
            _ => format!("the daemon has what was recorded: {fetch}"),
        }
    }

    /// The command that fetches the recording later.
    fn command(&self) -> String {
        let (recording, out) = (&self.recording.recording, self.out.display());
        format!("`jostle record --fetch {recording} -o {out}`")
    }

    fn file(&self, error: io::Error) -> Failure {
        Failure::file(self.folder().display(), error)
    }

    /// The folder of the parts. Its name has the time, since a deleted recording may have had the same
    /// name.
    fn folder(&self) -> PathBuf {
        let Recording {
            recording,
            began_unix_secs,
            ..
        } = &self.recording;
        with_suffix(self.out, &format!("{recording}-{began_unix_secs}.parts"))
    }
}

/// Sends a request and retries it while the daemon does not reply, for up to [`MAX_SILENCE`].
async fn retry<T>(request: impl AsyncFn() -> Result<T, Failure>) -> Result<T, Failure> {
    let deadline = Instant::now() + MAX_SILENCE;
    loop {
        match request().await {
            Err(failure) if may_pass(&failure) && Instant::now() < deadline => {
                sleep(POLL_INTERVAL).await;
            }
            answered => return answered,
        }
    }
}

/// Queries the status of a recording.
async fn status(context: &Context, name: &str) -> Result<Recording, Failure> {
    let answer = context.client.get_node("recordings").await?;
    let reply: NodeReply<Recordings> = answer.read()?;
    let mut recordings = reply.result.recordings.into_iter();
    recordings.find(|it| it.recording == name).ok_or_else(|| {
        Failure::argument(
            name,
            "is no recording of the daemon: `jostle record --list` lists them",
        )
    })
}

/// Whether the daemon may reply to a retry.
fn may_pass(failure: &Failure) -> bool {
    failure.cause().is_some_and(|error| match error {
        Error::Rejected(error) => error.code == ErrorCode::Busy,
        Error::UnknownNode { .. } => true,
        error => error.is_transient(),
    })
}

/// A note about finished parts that the daemon no longer has.
pub fn lost_note(parts: u64) -> String {
    match parts {
        0 => String::new(),
        _ => format!(
            "; without {}, which the daemon lacks",
            format::count(parts, "finished part")
        ),
    }
}

/// A note about the states that are missing, and where the last of those were that the daemon lost.
pub fn missing_note(recording: &Recording) -> String {
    let Recording {
        swarm,
        frames,
        missed,
        lost,
        gap,
        every,
        ..
    } = recording;
    let mut note = match missed.saturating_sub(*lost) {
        0 if *frames == 0 => {
            let every = every.unwrap_or(1);
            format!(
                "; {swarm} reached no step that is a multiple of {every}: `jostle run {swarm}` runs one \
                 that is paused"
            )
        }
        0 => String::new(),
        dropped => format!("; {dropped} were left out because the disk was behind"),
    };
    if *lost > 0 {
        note.push_str(&format!("; {lost} were lost when the daemon ended"));
    }
    if let Some(RecordingGap { after, until, .. }) = gap {
        let at = |at: &RecordedAt| format!("step {} of epoch {}", at.step, at.epoch);
        note.push_str(&match after {
            Some(after) => format!(", the last between {} and {}", at(after), at(until)),
            None => format!(", the last before {}", at(until)),
        });
    }
    note
}
