//! Finished parts of a recording that are missing or have another length than its status says.
//!
//! The status has the number of finished parts and their bytes. A recording that lacks some of them is
//! shown as failed unless it is running, with the counts of what is there. Its stored status is not
//! changed: once the files are back, it is complete again.

use std::collections::HashSet;
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use jostle_proto::RecordingPhase as Phase;
use jostle_results::recording::{Extent, RecordingError, Written, number_of, part_name, parts};
use tracing::warn;

use super::status::{Entry, Lost, Status};
use super::{RecordError, Recordings, State};
use crate::jobs::StatusFile as _;

/// The number of parts that a reason names.
const MAX_NAMED: usize = 5;

/// A folder may change again without another time of its last change; so long after a change it cannot.
const TIME_RESOLUTION: Duration = Duration::from_secs(1);

/// Compares the files of a recording with its status. `None` if all finished parts are there; parts that
/// the status does not count yet are not compared.
pub fn lost(folder: &Path, status: &Status) -> Option<Lost> {
    // Without a folder there are no parts.
    let mut files = match folder.exists() {
        false => Vec::new(),
        true => match parts(folder) {
            Ok(files) => files,
            Err(error) => return Some(Lost::all(status, error.to_string())),
        },
    };
    // Those of earlier versions may have any numbers.
    if status.part_bytes.is_some() {
        let next = status.parts.saturating_add(status.skipped);
        files.retain(|it| number_of(it).is_some_and(|number| number < next));
    }
    files.truncate(usize::try_from(status.parts).unwrap_or(usize::MAX));
    let lengths = files
        .iter()
        .map(|it| fs::metadata(it).map_or(0, |it| it.len()));
    let bytes: u64 = lengths.sum();
    let missing = status.parts - files.len() as u64;
    // Those of a running recording of an earlier version may include a part that is not finished.
    let expected = match status.part_bytes {
        None if status.phase == Phase::Ended => Some(status.bytes),
        known => known,
    };
    if missing == 0 && expected.is_none_or(|it| it == bytes) {
        return None;
    }
    let (mut there, mut damaged) = (Written::default(), Vec::new());
    for file in &files {
        match Extent::of(file) {
            Ok(extent) => {
                there.frames += extent.frames;
                there.parts += 1;
                there.bytes += extent.bytes;
            }
            Err(_) => damaged.push(name_of(file)),
        }
    }
    let are = |count: u64| if count == 1 { "is" } else { "are" };
    let mut problems = Vec::new();
    if missing > 0 {
        let names: HashSet<String> = files.iter().map(|it| name_of(it)).collect();
        let absent = (0..).map(|number| part_name(number, status.format));
        let absent = absent.filter(|it| !names.contains(it));
        let few = usize::try_from(missing).unwrap_or(MAX_NAMED).min(MAX_NAMED);
        let absent = absent.take(few);
        let named = named(&absent.collect::<Vec<_>>(), missing);
        problems.push(format!("{missing} {} missing ({named})", are(missing)));
    }
    if !damaged.is_empty() {
        let count = damaged.len() as u64;
        problems.push(format!(
            "{count} {} damaged ({})",
            are(count),
            named(&damaged, count)
        ));
    }
    if problems.is_empty() {
        let expected = status.part_bytes?;
        problems.push(format!("they have {bytes} of {expected} bytes"));
    }
    let parts = missing + damaged.len() as u64;
    Some(Lost {
        parts: parts.max(1),
        reason: format!(
            "of its {} finished parts {}: put back the files, or fetch the rest",
            status.parts,
            problems.join(", ")
        ),
        there,
    })
}

impl Lost {
    fn all(status: &Status, reason: String) -> Self {
        Lost {
            parts: status.parts.max(1),
            reason,
            there: Written::default(),
        }
    }
}

fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// The first names of `count`.
fn named(names: &[String], count: u64) -> String {
    let few = &names[..names.len().min(MAX_NAMED)];
    match count - few.len() as u64 {
        0 => few.join(", "),
        others => format!("{} and {others} more", few.join(", ")),
    }
}

/// Which finished parts a recording lacks that no daemon has open. None if it has no status that can be
/// read, which the daemon reports.
pub fn lost_parts(folder: &Path) -> Option<String> {
    let status = fs::read(folder.join(Status::NAME)).ok()?;
    let status = serde_json::from_slice(&status).ok()?;
    Some(lost(folder, &status)?.reason)
}

/// Fails if a recording lacks finished parts.
pub(super) fn complete(folder: &Path, status: &Status) -> Result<(), RecordingError> {
    match lost(folder, status) {
        None => Ok(()),
        Some(lost) => Err(RecordingError::Unreadable {
            path: folder.to_owned(),
            reason: lost.reason,
        }),
    }
}

impl Entry {
    /// The status as clients see it: of a recording that lacks finished parts, with the counts of those
    /// that are there.
    pub(super) fn shown(&self) -> Status {
        let mut status = self.report();
        let Some(lost) = &self.lost else {
            return status;
        };
        status.lost_parts = lost.parts;
        let Written {
            frames,
            parts,
            bytes,
        } = lost.there;
        (status.frames, status.parts, status.bytes) = (frames, parts, bytes);
        status.reason = Some(match status.reason {
            Some(reason) if reason.contains(&lost.reason) => reason,
            Some(reason) => format!("{reason}; {}", lost.reason),
            None => lost.reason.clone(),
        });
        if status.phase == Phase::Ended {
            status.phase = Phase::Failed;
        }
        status
    }
}

impl Recordings {
    /// Compares the files of each recording with its status, as [`Recordings::check`].
    pub fn check_all(&self) {
        let names: Vec<String> = self.lock().entries.keys().cloned().collect();
        names.iter().for_each(|name| self.check(name));
    }

    /// Compares the files of a recording with its status if its folder has changed since the last
    /// comparison.
    pub(super) fn check(&self, name: &str) {
        let entry = |state: &State| {
            let entry = state.entries.get(name)?;
            Some((entry.report(), entry.checked))
        };
        let Some((status, checked)) = entry(&self.lock()) else {
            return;
        };
        let folder = self.0.jobs.folder(name);
        // The time is read first: what changes later is compared again.
        let changed = fs::metadata(&folder).and_then(|it| it.modified()).ok();
        if changed.is_some() && changed == checked {
            return;
        }
        let lost = lost(&folder, &status);
        let is_settled = |it: &SystemTime| it.elapsed().is_ok_and(|it| it > TIME_RESOLUTION);
        if let Some(entry) = self.lock().entries.get_mut(name) {
            entry.checked = changed.filter(is_settled);
            if let Some(lost) = lost.as_ref().filter(|it| Some(*it) != entry.lost.as_ref()) {
                warn!(
                    recording = name,
                    reason = lost.reason,
                    "lacks finished parts"
                );
            }
            if entry.subscription.is_none() {
                entry.size = lost
                    .as_ref()
                    .map_or(entry.status.bytes, |it| it.there.bytes);
            }
            entry.lost = lost;
        }
    }

    /// The status of a recording, as clients see it.
    pub(super) fn shown(&self, name: &str) -> Result<Status, RecordError> {
        let state = self.lock();
        let entry = state.entries.get(name).map(Entry::shown);
        entry.ok_or_else(|| RecordError::Unknown(name.to_owned()))
    }
}
