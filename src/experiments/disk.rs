//! The disk space of the experiments: its quota, and the free space that they leave to the swarms.

use std::path::Path;
use std::sync::{Arc, Weak};
use std::{fs, io, thread};

use jostle_experiment::{DiskNeed, DiskWatch, Plan, Subset};
use jostle_proto::ExperimentPhase as Phase;
use rustix::fs::statvfs;
use tracing::warn;

use super::error::ExperimentError;
use super::{ExperimentManager, Shared, State};

/// Free space that experiments leave on the disk, so that swarms can write their journals.
const MIN_FREE_BYTES: u64 = 64 * 1024 * 1024;

/// The share of a small quota below which an experiment stops: what it writes until the next check,
/// and its checkpoints, fit there.
const MIN_LEFT_OF_QUOTA: u64 = 8;

/// How often an execution checks its space while it writes what is left free.
const CHECKS: u64 = 4;

/// Why an execution may not go on.
const REMEDY: &str = "then resume the experiment";

/// The disk space of all experiments, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DiskUsage {
    pub used: u64,
    /// `experiments_quota_mb`; none if they may take the whole disk.
    pub quota: Option<u64>,
}

impl ExperimentManager {
    /// What the experiments take on disk, and their maximum.
    pub fn disk_usage(&self) -> DiskUsage {
        self.0.disk_usage()
    }

    /// The experiments that the daemon has paused, each with the reason.
    pub fn paused_by_daemon(&self) -> Vec<(String, String)> {
        let state = self.lock();
        let entries = state.entries.iter();
        let paused = entries.filter(|(_, it)| it.status.phase == Phase::Paused);
        let reasons = paused.map(|(name, it)| Some((name.clone(), it.status.message.clone()?)));
        reasons.flatten().collect()
    }

    /// Measures the folders of the experiments, which may have very many files, and then resumes the
    /// unfinished ones. Called after the recovery of the swarms, whose memory they leave.
    pub fn resume_all(&self) {
        let manager = self.clone();
        let measure = move || {
            let names: Vec<String> = manager.lock().entries.keys().cloned().collect();
            for name in names {
                let bytes = manager.measure(&name);
                if let Some(entry) = manager.lock().entries.get_mut(&name) {
                    entry.bytes = bytes;
                }
            }
            let mut state = manager.lock();
            state.is_measured = true;
            manager.schedule_next(&mut state);
        };
        let thread = thread::Builder::new().name("experiment-sizes".into());
        if let Err(error) = thread.spawn(measure) {
            warn!(%error, "cannot measure the experiments");
            let mut state = self.lock();
            state.is_measured = true;
            self.schedule_next(&mut state);
        }
    }

    /// The bytes of the files of an experiment.
    pub(super) fn measure(&self, name: &str) -> u64 {
        bytes_in(&self.0.jobs.folder(name)).unwrap_or(0)
    }

    /// What the runs of a plan need on disk.
    pub(super) fn need(&self, plan: &Plan) -> DiskNeed {
        DiskNeed::of(plan, &Subset::all(plan), self.0.threads)
    }

    /// Checks whether an experiment has the space that it needs beside the unfinished ones. Returns a
    /// warning if only the upper bounds of their sizes exceed it.
    pub(super) fn check_need(&self, need: DiskNeed) -> Result<Option<String>, ExperimentError> {
        let (used, others) = {
            let state = self.lock();
            let unfinished = state.entries.values().filter_map(|it| it.left());
            let sum = unfinished.fold((0.0, false), |(bytes, is_at_most), it| {
                (bytes + it.bytes, is_at_most || it.is_at_most)
            });
            (used(&state), sum)
        };
        let needed = rounded(need.bytes);
        let reserved = rounded(others.0);
        let free = free_bytes(&self.0).map_err(ExperimentError::not_stored)?;
        let free = free.saturating_sub(MIN_FREE_BYTES).saturating_sub(reserved);
        let no_room = ExperimentError::NoRoom {
            needed,
            free,
            reserved,
        };
        let quota = self.0.quota_bytes.map(|quota| {
            let usable = quota.saturating_sub(self.0.min_left());
            let left = usable.saturating_sub(used).saturating_sub(reserved);
            (
                left,
                ExperimentError::OverQuota {
                    needed,
                    left,
                    reserved,
                    quota,
                },
            )
        });
        let error = match quota {
            Some((left, over_quota)) if needed > left && left <= free => over_quota,
            _ if needed > free => no_room,
            _ => return Ok(None),
        };
        match need.is_at_most || others.1 {
            true => Ok(Some(error.as_warning())),
            false => Err(error),
        }
    }

    /// Watches the disk for an execution.
    pub(super) fn watch_disk(&self) -> DiskWatch {
        let shared = Arc::downgrade(&self.0);
        let interval = self.0.min_left() / CHECKS;
        DiskWatch::new(interval, move |bytes| has_room(&shared, bytes))
    }
}

impl Shared {
    fn disk_usage(&self) -> DiskUsage {
        DiskUsage {
            used: used(&self.state.lock()),
            quota: self.quota_bytes,
        }
    }

    /// How much of the quota an execution leaves.
    fn min_left(&self) -> u64 {
        let quota = self.quota_bytes.unwrap_or(u64::MAX);
        MIN_FREE_BYTES.min(quota / MIN_LEFT_OF_QUOTA)
    }
}

/// Returns whether so many bytes may be written, or why not.
fn has_room(shared: &Weak<Shared>, bytes: u64) -> Result<(), String> {
    let Some(shared) = shared.upgrade() else {
        return Ok(());
    };
    let DiskUsage { used, quota } = shared.disk_usage();
    if let Some(quota) = quota
        && used.saturating_add(bytes) > quota.saturating_sub(shared.min_left())
    {
        return Err(format!(
            "the experiments take {} of {} MiB (experiments_quota_mb), of which {} stay free{}: delete \
             one that is over, or raise the setting, {REMEDY}",
            used >> 20,
            quota >> 20,
            shared.min_left() >> 20,
            also(bytes),
        ));
    }
    // A write reports the error of the disk.
    let free = free_bytes(&shared).unwrap_or(u64::MAX);
    match free.saturating_sub(bytes) >= MIN_FREE_BYTES {
        true => Ok(()),
        false => Err(format!(
            "the disk of the data folder has {} MiB left, of which {} stay free for the swarms{}: free \
             disk space, {REMEDY}",
            free >> 20,
            MIN_FREE_BYTES >> 20,
            also(bytes),
        )),
    }
}

/// Names what an experiment is about to write.
fn also(bytes: u64) -> String {
    match bytes >> 20 {
        0 => String::new(),
        mebibytes => format!(", and what the experiment writes next needs {mebibytes} MiB"),
    }
}

fn free_bytes(shared: &Shared) -> io::Result<u64> {
    let disk = statvfs(shared.jobs.root())?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

fn used(state: &State) -> u64 {
    state.entries.values().map(|entry| entry.bytes()).sum()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "estimates are positive"
)]
fn rounded(bytes: f64) -> u64 {
    bytes.ceil() as u64
}

/// The lengths of all files below a folder.
fn bytes_in(folder: &Path) -> io::Result<u64> {
    let mut sum = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        // A file may be removed meanwhile.
        match entry.metadata() {
            Ok(it) if it.is_dir() => sum += bytes_in(&entry.path()).unwrap_or(0),
            Ok(it) => sum += it.len(),
            Err(_) => {}
        }
    }
    Ok(sum)
}
