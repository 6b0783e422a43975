//! A film that lies in files: where each frame is, and what happened between them.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use jostle_physics::model::parameters::Parameters;
use jostle_physics::simulation::{Change, Spec};
use jostle_results::recording::{self, About, Message};

use crate::convert;
use crate::playback::ReplayError;
use crate::playback::film::{Film, Mark, Shot, Told};
use crate::swarm::order::Order;

/// The most frames of a film, and the most that its events take, in bytes.
const MOST_FRAMES: usize = 4_000_000;
const MOST_TOLD_BYTES: usize = 64 * 1024 * 1024;

/// What a frame or an event takes in memory beside what it says.
const BYTES_PER_ENTRY: usize = 64;

/// Reads what a recorded command ordered: its verb and its arguments, JSON.
pub type ReadOrder<'a> = &'a dyn Fn(&str, &str) -> Result<Order, String>;

/// A recording, opened.
pub struct Reel {
    swarm: Arc<str>,
    recipe: Spec,
    most_individuals: usize,
    files: Vec<File>,
    lies: Vec<Lies>,
    marks: Vec<Mark>,
    told: Vec<Told>,
    /// The parameters in force from a frame on.
    parameters: Vec<(usize, Parameters)>,
}

/// Where a frame's bytes lie.
struct Lies {
    file: usize,
    offset: u64,
    bytes: usize,
}

impl Reel {
    /// Opens the parts of a recording, and looks at every frame.
    ///
    /// # Errors
    ///
    /// [`ReplayError::Unreadable`].
    pub fn open(paths: &[PathBuf], read_order: ReadOrder<'_>) -> Result<Self, ReplayError> {
        let (mut reel, mut told_bytes): (Option<Reel>, _) = (None, 0);
        for path in paths {
            let unreadable = |reason: String| ReplayError::Unreadable(reason);
            // What it says of itself stands before its first frame, but is told when all is read.
            let about = recording::read(path, |_| Ok(())).map_err(explain)?;
            let reel = match &mut reel {
                Some(reel) => reel,
                none => none.insert(Reel::beginning(&about).map_err(unreadable)?),
            };
            reel.files
                .push(File::open(path).map_err(|error| unreadable(error.to_string()))?);
            recording::read(path, |message| {
                reel.take(message, &mut told_bytes, read_order)
            })
            .map_err(explain)?;
        }
        match reel {
            Some(reel) if !reel.marks.is_empty() => Ok(reel),
            _ => Err(ReplayError::Unreadable("it has no frame".to_owned())),
        }
    }

    fn beginning(about: &About) -> Result<Self, String> {
        let said = |what: &str| {
            let said = about.get(what);
            said.ok_or_else(|| format!("it does not say its {what}: jostle did not record it"))
        };
        let (mut recipe, parameters) = convert::recorded(said("spec")?, said("parameters")?)?;
        let rate = about.get("rate").and_then(|rate| rate.parse().ok());
        // What ran as fast as it could would be over in a moment.
        recipe.rate = jostle_convert::value::rate(rate.or(recipe.rate))
            .ok()
            .flatten()
            .or(Some(1.0));
        Ok(Reel {
            swarm: said("swarm")?.as_str().into(),
            recipe,
            most_individuals: 0,
            files: Vec::new(),
            lies: Vec::new(),
            marks: Vec::new(),
            told: Vec::new(),
            parameters: vec![(0, parameters)],
        })
    }

    fn take(
        &mut self,
        message: Message<'_>,
        told_bytes: &mut usize,
        read_order: ReadOrder<'_>,
    ) -> Result<(), String> {
        let number = self.marks.len() + 1;
        match message.topic {
            "state" => self
                .frame(&message)
                .map_err(|problem| format!("frame {number}: {problem}")),
            "event" => {
                *told_bytes += BYTES_PER_ENTRY + message.bytes.len();
                if *told_bytes > MOST_TOLD_BYTES {
                    return Err("it has too many events".to_owned());
                }
                self.event(message.bytes, read_order)
                    .map_err(|problem| format!("an event before frame {number}: {problem}"))
            }
            _ => Ok(()),
        }
    }

    fn frame(&mut self, message: &Message<'_>) -> Result<(), String> {
        if self.marks.len() == MOST_FRAMES {
            return Err(format!("it has more than {MOST_FRAMES} frames"));
        }
        let (mut mark, shot) = convert::shot(message.bytes, self.parameters[0].1)?;
        mark.position = self.marks.last().map_or(0.0, |before| {
            before.position + f64::max(mark.time - before.time, 0.0)
        });
        self.most_individuals = self.most_individuals.max(shot.configuration.n());
        self.marks.push(mark);
        self.lies.push(Lies {
            file: self.files.len() - 1,
            offset: message.offset,
            bytes: message.bytes.len(),
        });
        Ok(())
    }

    fn event(&mut self, bytes: &[u8], read_order: ReadOrder<'_>) -> Result<(), String> {
        let event = convert::recorded_event(bytes)?;
        let after = self.marks.len();
        if let Some((verb, args)) = event.command {
            // What an older daemon let pass and this one does not changes no picture.
            if let Ok(order) = read_order(&verb, &args.to_string()) {
                self.ordered(&order);
            }
        }
        if let Some(what) = event.what {
            self.told.push(Told {
                after,
                step: event.step,
                time: event.time,
                unix_secs: event.unix_secs,
                what: what.into(),
            });
        }
        Ok(())
    }

    /// Keeps the parameters that an order left in force.
    fn ordered(&mut self, order: &Order) {
        let before = self.parameters[self.parameters.len() - 1].1;
        let mut now = before;
        match order {
            Order::Change(Change::Set(settings)) => now = settings.of(before),
            Order::Batch(changes) => {
                for change in changes {
                    if let Change::Set(settings) = change {
                        now = settings.of(now);
                    }
                }
            }
            Order::Reset(_) => now = self.recipe.parameters,
            _ => {}
        }
        if now != before && now.check(0.0).is_ok() {
            self.parameters.push((self.marks.len(), now));
        }
    }

    /// What the recorded swarm was made from.
    pub fn recipe(&self) -> &Spec {
        &self.recipe
    }

    /// The size of the largest group in it.
    pub fn most_individuals(&self) -> usize {
        self.most_individuals
    }

    /// What it takes in memory, beside a frame.
    pub fn bytes(&self) -> u64 {
        let told: usize = self.told.iter().map(|told| told.what.len()).sum();
        let entries = self.told.len() + 2 * self.marks.len();
        (told + BYTES_PER_ENTRY * entries) as u64
    }
}

impl Film for Reel {
    fn swarm(&self) -> &Arc<str> {
        &self.swarm
    }

    fn marks(&self) -> &[Mark] {
        &self.marks
    }

    fn told(&self) -> &[Told] {
        &self.told
    }

    fn shot(&mut self, frame: usize) -> Result<Shot, String> {
        let Lies {
            file,
            offset,
            bytes,
        } = self.lies[frame];
        let bytes = recording::bytes_at(&mut self.files[file], offset, bytes)
            .map_err(|error| format!("frame {} cannot be read: {error}", frame + 1))?;
        let since = self.parameters.partition_point(|(from, _)| *from <= frame);
        let parameters = self.parameters[since - 1].1;
        convert::shot(&bytes, parameters).map(|(_, shot)| shot)
    }
}

fn explain(error: recording::RecordingError) -> ReplayError {
    ReplayError::Unreadable(match error {
        recording::RecordingError::Unreadable { reason, .. } => reason,
        error => error.to_string(),
    })
}
