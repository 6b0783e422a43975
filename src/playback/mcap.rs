//! A recording in MCAP: the index of its frames, and its events.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use jostle_physics::model::parameters::Parameters;
use jostle_physics::simulation::{Change, Spec};
use jostle_results::recording::{self, About, FRAMES, Message};

use crate::convert;
use crate::playback::ReplayError;
use crate::playback::source::{FrameIndex, RecordedEvent, RecordedFrame};
use crate::swarm::command::Command;
use crate::swarm::sender::{Origin, OriginKind};
use crate::swarm::watch::Action;

/// Maximum number of frames, and of bytes of events in memory.
const MAX_FRAMES: usize = 4_000_000;
const MAX_EVENT_BYTES: usize = 64 * 1024 * 1024;

/// The memory of the index of a frame, and of an event without its text.
pub(super) const BYTES_PER_ENTRY: usize = 64;

/// Parses a recorded command: its verb and its arguments as JSON.
pub type ReadCommand<'a> = &'a dyn Fn(&str, &str) -> Result<Command, String>;

/// An open recording.
pub struct McapSource {
    pub(super) swarm: Arc<str>,
    pub(super) spec: Spec,
    /// The size of the largest group.
    pub max_individuals: usize,
    files: Vec<File>,
    ranges: Vec<ByteRange>,
    index: Vec<FrameIndex>,
    /// Its events, in order.
    pub events: Vec<RecordedEvent>,
    /// The parameters, each from a frame on.
    parameters: Vec<(usize, Parameters)>,
}

/// Why a recording without a frame is not played.
const NO_FRAME: &str = "it has no frame: while it was recorded the swarm reached no step that it records, \
                        such as while it is paused";

struct ByteRange {
    file: usize,
    offset: u64,
    bytes: usize,
    checksum: u32,
}

impl McapSource {
    /// Opens the parts of a recording, and checks every frame.
    ///
    /// # Errors
    ///
    /// [`ReplayError::Unreadable`].
    pub fn open(paths: &[PathBuf], read_command: ReadCommand<'_>) -> Result<Self, ReplayError> {
        let (mut source, mut event_bytes): (Option<McapSource>, _) = (None, 0);
        for path in paths {
            let unreadable = |reason: String| ReplayError::Unreadable(reason);
            // The metadata precedes the frames in the file, but is returned at the end.
            let about = recording::read(path, |_| Ok(())).map_err(explain)?;
            let source = match &mut source {
                Some(source) => source,
                none => none.insert(McapSource::from_metadata(&about).map_err(unreadable)?),
            };
            source
                .files
                .push(File::open(path).map_err(|error| unreadable(error.to_string()))?);
            recording::read(path, |message| {
                source.read(message, &mut event_bytes, read_command)
            })
            .map_err(explain)?;
        }
        match source {
            Some(source) if !source.index.is_empty() => Ok(source),
            _ => Err(ReplayError::Unreadable(NO_FRAME.to_owned())),
        }
    }

    fn from_metadata(about: &About) -> Result<Self, String> {
        let field = |what: &str| {
            let field = about.get(what);
            field.ok_or_else(|| {
                let why = match about.contains_key("recovered") {
                    // A recording without a part has no other metadata.
                    false if about.get(FRAMES).is_some_and(|it| it == "0") => {
                        return NO_FRAME.to_owned();
                    }
                    true => "it was recovered from a file that ended before them",
                    false => "jostle did not record it",
                };
                format!("it has no {what} in its metadata: {why}")
            })
        };
        let (mut spec, parameters) = convert::decode_spec(field("spec")?, field("parameters")?)?;
        let rate = about.get("rate").and_then(|rate| rate.parse().ok());
        // Without a rate the playback would end at once.
        spec.rate = jostle_convert::value::rate(rate.or(spec.rate))
            .ok()
            .flatten()
            .or(Some(1.0));
        Ok(McapSource {
            swarm: field("swarm")?.as_str().into(),
            spec,
            max_individuals: 0,
            files: Vec::new(),
            ranges: Vec::new(),
            index: Vec::new(),
            events: Vec::new(),
            parameters: vec![(0, parameters)],
        })
    }

    fn read(
        &mut self,
        message: Message<'_>,
        event_bytes: &mut usize,
        read_command: ReadCommand<'_>,
    ) -> Result<(), String> {
        let number = self.index.len() + 1;
        match message.topic {
            "state" => self
                .add_frame(&message)
                .map_err(|problem| format!("frame {number}: {problem}")),
            "event" => {
                *event_bytes += BYTES_PER_ENTRY + message.bytes.len();
                if *event_bytes > MAX_EVENT_BYTES {
                    return Err("it has too many events".to_owned());
                }
                self.add_event(message.bytes, read_command)
                    .map_err(|problem| format!("an event before frame {number}: {problem}"))
            }
            _ => Ok(()),
        }
    }

    fn add_frame(&mut self, message: &Message<'_>) -> Result<(), String> {
        if self.index.len() == MAX_FRAMES {
            return Err(format!("it has more than {MAX_FRAMES} frames"));
        }
        let (mut index, frame) = convert::decode_state(message.bytes, self.parameters[0].1)?;
        index.position = self.index.last().map_or(0.0, |before| {
            before.position + f64::max(index.time - before.time, 0.0)
        });
        self.max_individuals = self.max_individuals.max(frame.configuration.n());
        self.index.push(index);
        self.ranges.push(ByteRange {
            file: self.files.len() - 1,
            offset: message.offset,
            bytes: message.bytes.len(),
            checksum: recording::checksum(message.bytes),
        });
        Ok(())
    }

    fn add_event(&mut self, bytes: &[u8], read_command: ReadCommand<'_>) -> Result<(), String> {
        let (shown, command) = convert::decode_event(bytes)?;
        if let Some((verb, args)) = command {
            // A command that only an older daemon accepts changes no parameters.
            if let Ok(command) = read_command(&verb, &args.to_string()) {
                self.apply(&command);
            }
        }
        let after = self.index.len();
        self.events
            .extend(shown.map(|event| RecordedEvent { after, ..event }));
        Ok(())
    }

    fn apply(&mut self, command: &Command) {
        let before = self.parameters[self.parameters.len() - 1].1;
        let mut now = before;
        match command {
            Command::Change(Change::Set(settings)) => now = settings.of(before),
            Command::Batch { changes, .. } => {
                for change in changes {
                    if let Change::Set(settings) = change {
                        now = settings.of(now);
                    }
                }
            }
            Command::Fired(watch) => {
                if let Action::Batch(changes, _) = &watch.action {
                    for change in changes {
                        if let Change::Set(settings) = change {
                            now = settings.of(now);
                        }
                    }
                }
            }
            Command::Reset(_) => now = self.spec.parameters,
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Change(_)
            | Command::Join(_)
            | Command::Advance { .. }
            | Command::Leave(_)
            | Command::Deadline(_)
            | Command::Lost(_)
            | Command::Idle(_)
            | Command::Control { .. }
            | Command::Annotate
            | Command::Protect(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Delete => {}
        }
        if now != before && now.check(0.0).is_ok() {
            self.parameters.push((self.index.len(), now));
        }
    }

    /// Its frames, at least one; positions never decrease.
    pub fn index(&self) -> &[FrameIndex] {
        &self.index
    }

    /// What a playback of it is made from: its first frame.
    pub fn origin(&self) -> Origin {
        Origin {
            kind: OriginKind::Play,
            swarm: Some(self.swarm.to_string()),
            swarm_id: None,
            step: self.index.first().map_or(0, |it| it.step),
            seq: None,
            state_hash: None,
        }
    }

    /// Reads a frame.
    pub fn frame(&mut self, frame: usize) -> Result<RecordedFrame, String> {
        let range = &self.ranges[frame];
        let bytes = recording::bytes_at(&mut self.files[range.file], range.offset, range.bytes)
            .map_err(|error| format!("frame {} cannot be read: {error}", frame + 1))?;
        if recording::checksum(&bytes) != range.checksum {
            let frame = frame + 1;
            return Err(format!(
                "frame {frame} is damaged: the file has changed since it was opened"
            ));
        }
        let since = self.parameters.partition_point(|(from, _)| *from <= frame);
        let parameters = self.parameters[since - 1].1;
        convert::decode_state(&bytes, parameters).map(|(_, frame)| frame)
    }
}

fn explain(error: recording::RecordingError) -> ReplayError {
    ReplayError::Unreadable(match error {
        recording::RecordingError::Unreadable { reason, .. } => reason,
        error => error.to_string(),
    })
}
