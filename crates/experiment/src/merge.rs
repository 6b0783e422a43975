//! Merges the folders of an experiment's parts into one folder of results.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use jostle_physics::model::MODEL_VERSION;

use crate::digest::Digests;
use crate::files::Files;
use crate::folder::{Folder, FolderError, Part, parts_in, unfinished};
use crate::plan::Plan;
use crate::run::{FinishedRun, execute_run_from};
use crate::subset::Subset;
use crate::trajectory::Trajectories;

mod error;

pub use self::error::{Difference, MergeError};

/// All parts of an experiment: each of its runs is in exactly one of them.
pub struct Parts {
    plan: Plan,
    parts: Vec<Part>,
    /// The part of each run, by the run's index in the plan.
    part_of: Vec<usize>,
    /// The version of the model that executed the runs.
    model_version: u32,
}

impl Parts {
    /// Reads the folders of all parts of an experiment, or folders that contain them.
    ///
    /// # Errors
    ///
    /// [`MergeError`]: a folder cannot be read or is in use, is of another experiment or model
    /// version, contains a run that another one contains, or a run is in none.
    pub fn read(folders: &[PathBuf]) -> Result<Self, MergeError> {
        let folders = &parts_in(folders)?;
        let first = folders.first().ok_or(MergeError::NoParts)?;
        let all = folders.iter().map(|folder| Part::files(folder));
        let all = all.collect::<Result<Vec<_>, _>>()?;
        if all.iter().any(|files| *files != all[0]) {
            // Named are those that differ from the most.
            let count = |files: &Files| all.iter().filter(|it| *it == files).count();
            let usual = all.iter().rev().max_by_key(|files| count(files));
            let (others, usual): (Vec<_>, Vec<_>) =
                (folders.iter().zip(&all)).partition(|(_, files)| Some(*files) != usual);
            let first = usual.first().map_or(first, |(folder, _)| folder).clone();
            let others = others
                .into_iter()
                .map(|(folder, _)| folder.clone())
                .collect();
            return Err(MergeError::OtherExperiment { first, others });
        }
        let mut plan = Plan::stored(all[0].clone()).map_err(|source| MergeError::Plan {
            folder: first.clone(),
            source,
        })?;
        let parts = folders.iter().map(|folder| Part::read(folder, &plan));
        let parts = parts.collect::<Result<Vec<_>, _>>()?;
        let mut versions: BTreeMap<u32, (PathBuf, usize)> = BTreeMap::new();
        for part in parts.iter().filter(|part| part.has_runs()) {
            let path = || (part.path().to_owned(), 0);
            versions.entry(part.model_version()).or_insert_with(path).1 += 1;
        }
        let model_version = *versions.keys().next().unwrap_or(&MODEL_VERSION);
        if versions.len() > 1 {
            return Err(MergeError::OtherModel { versions });
        }
        plan.definitions = parts[0].definitions();
        let others = parts
            .iter()
            .filter(|part| part.definitions() != plan.definitions);
        let others: Vec<_> = others.map(|part| part.path().to_owned()).collect();
        if !others.is_empty() {
            let first = first.clone();
            return Err(MergeError::OtherDefinitions { first, others });
        }
        let mut part_of = vec![None; plan.runs().len()];
        for (number, part) in parts.iter().enumerate() {
            let mut duplicates: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
            for index in part.finished() {
                match part_of[index] {
                    None => part_of[index] = Some(number),
                    Some(other) => duplicates.entry(other).or_default().push(index),
                }
            }
            if let Some((other, runs)) = duplicates.pop_first() {
                return Err(MergeError::Duplicate {
                    first: folders[other].clone(),
                    second: folders[number].clone(),
                    runs: Subset::of(runs),
                });
            }
        }
        let is_missing = |index: &usize| part_of[*index].is_none();
        let missing: Vec<usize> = (0..part_of.len()).filter(is_missing).collect();
        let lacks = |index: &usize| parts.iter().any(|part| part.lacking().contains(index));
        let lacking: Vec<usize> = missing.iter().copied().filter(lacks).collect();
        if !missing.is_empty() && model_version != MODEL_VERSION {
            return Err(MergeError::Unfinishable {
                runs: Subset::of(missing),
                of: plan.runs().len(),
                theirs: model_version,
            });
        }
        if !lacking.is_empty() {
            return Err(MergeError::MissingFiles {
                runs: Subset::of(lacking),
                of: plan.runs().len(),
            });
        }
        if !missing.is_empty() {
            return Err(MergeError::Missing {
                runs: Subset::of(missing),
                of: plan.runs().len(),
            });
        }
        let part_of = part_of.into_iter().flatten().collect();
        Ok(Self {
            plan,
            parts,
            part_of,
            model_version,
        })
    }

    /// Number of parts.
    #[must_use]
    pub fn count(&self) -> usize {
        self.parts.len()
    }

    /// The experiment.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Samples runs to verify: of each part a fraction `share`, within (0, 1], and at least one run.
    /// The selection depends on `seed`.
    #[must_use]
    pub fn sample(&self, share: f64, seed: u64) -> Subset {
        let key = |index: usize| {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&seed.to_le_bytes());
            hasher.update(&(index as u64).to_le_bytes());
            *hasher.finalize().as_bytes()
        };
        let mut sampled = Vec::new();
        for part in &self.parts {
            let mut runs = part.finished();
            runs.sort_by_cached_key(|&index| key(index));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "at most the number of runs"
            )]
            let count = (runs.len() as f64 * share).ceil() as usize;
            sampled.extend(runs.into_iter().take(count));
        }
        Subset::of(sampled)
    }

    /// Executes runs again on this machine and compares their results with those of the parts: rows,
    /// reasons of faults, series, trajectories and contacts. After each run `progress` is called with the number of
    /// runs that were executed.
    ///
    /// # Errors
    ///
    /// [`MergeError::Differs`] with all that differ; [`MergeError::Folder`] if a part cannot be read;
    /// [`MergeError::Unverifiable`] if another version of the model executed the parts.
    pub fn verify(
        &self,
        subset: &Subset,
        threads: usize,
        progress: impl Fn(usize) + Sync,
    ) -> Result<(), MergeError> {
        if self.model_version != MODEL_VERSION {
            let theirs = self.model_version;
            return Err(MergeError::Unverifiable { theirs });
        }
        let indices = subset.indices();
        let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let differences = Mutex::new(Vec::new());
        let work = || -> Result<(), FolderError> {
            while let Some(&index) = indices.get(next.fetch_add(1, Ordering::Relaxed)) {
                let difference = self.execute_again(index)?;
                let mut all = differences.lock().unwrap_or_else(PoisonError::into_inner);
                all.extend(difference.map(|it| (index, it)));
                drop(all);
                progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            }
            Ok(())
        };
        let ended: Vec<_> = thread::scope(|scope| {
            let threads = (0..threads.clamp(1, indices.len().max(1))).map(|_| scope.spawn(work));
            let threads: Vec<_> = threads.collect();
            threads
                .into_iter()
                .map(thread::ScopedJoinHandle::join)
                .collect()
        });
        for result in ended {
            result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        }
        let differences = differences.into_inner();
        let mut differences = differences.unwrap_or_else(PoisonError::into_inner);
        differences.sort_by_key(|(index, _)| *index);
        match differences.is_empty() {
            true => Ok(()),
            false => Err(MergeError::Differs {
                runs: differences.into_iter().map(|(_, it)| it).collect(),
                of: indices.len(),
            }),
        }
    }

    /// Executes a run again; none if its result is that of its part.
    fn execute_again(&self, index: usize) -> Result<Option<Difference>, FolderError> {
        let run = &self.plan.runs()[index];
        let part = &self.parts[self.part_of[index]];
        let (theirs, their_digests) = part.result(&self.plan, index)?;
        let digests = Digests::default();
        let ours = execute_run_from(&self.plan, run, None, Some(&digests), |_| true);
        let ours = ours.unwrap_or_default();
        let is_same = ours == theirs && digests.finish() == their_digests;
        let hash = |result: FinishedRun| result.row.map_or_else(String::new, |row| row.state_hash);
        Ok((!is_same).then(|| Difference {
            run: run.name.clone(),
            folder: part.path().to_owned(),
            theirs: hash(theirs),
            ours: hash(ours),
        }))
    }

    /// Checks that results can be written to `to`.
    ///
    /// # Errors
    ///
    /// [`MergeError::Exists`] if `to` exists and is not an empty folder.
    pub fn check_target(to: &Path) -> Result<(), MergeError> {
        let is_free = match fs::read_dir(to) {
            Ok(mut entries) => entries.next().is_none(),
            Err(error) => error.kind() == io::ErrorKind::NotFound,
        };
        match is_free {
            true => Ok(()),
            false => Err(MergeError::Exists {
                folder: to.to_owned(),
            }),
        }
    }

    /// Writes the folder of results atomically, with the runs in the plan's order: to a temporary
    /// folder, which is then renamed.
    ///
    /// # Errors
    ///
    /// [`MergeError::Exists`] if `to` is not an empty folder; [`FolderError::Rename`], after which the
    /// temporary folder is complete; others if it cannot be written.
    pub fn write(&self, to: &Path) -> Result<Folder, MergeError> {
        Self::check_target(to)?;
        // An empty folder that exists may be a link or the current folder.
        let to = &fs::canonicalize(to).unwrap_or_else(|_| to.to_owned());
        let temporary = unfinished(to, "merge");
        if temporary.exists() {
            // Left by a killed merge. If another process is writing it, `discard` returns `InUse`.
            Folder::discard(&temporary)?;
        }
        let mut folder = Folder::open_of(&temporary, &self.plan, self.model_version)?;
        if let Err(error) = self.fill(&mut folder) {
            // A folder that cannot be removed is discarded by the next merge.
            let _ = fs::remove_dir_all(&temporary);
            return Err(error);
        }
        folder.rename(to)?;
        Ok(folder)
    }

    fn fill(&self, folder: &mut Folder) -> Result<(), MergeError> {
        let Self {
            plan,
            parts,
            part_of,
            ..
        } = self;
        if plan.record_every.is_some() {
            let trajectories = folder.trajectories();
            for (index, &part) in part_of.iter().enumerate() {
                if parts[part].has_row(index) {
                    trajectories.copy(&Trajectories::of(parts[part].path()), index)?;
                }
            }
        }
        let (lines, to) = (part_of.iter().enumerate(), folder.path().to_owned());
        folder.append_copies(
            plan,
            lines.map(|(index, &part)| parts[part].copy(plan, index, &to)),
        )?;
        let (finished, runs) = (folder.finished(), plan.runs().len());
        if finished != runs {
            return Err(MergeError::Incomplete { finished, runs });
        }
        Ok(folder.write_tables(plan)?)
    }
}

/// Returns the runs of `plan` that are finished in none of `folders`, or of the folders in these.
///
/// # Errors
///
/// [`MergeError::ForeignPart`], and [`MergeError::Folder`] for a folder that cannot be read or
/// is in use.
pub fn missing(plan: &Plan, folders: &[PathBuf]) -> Result<Subset, MergeError> {
    let mut is_finished = vec![false; plan.runs().len()];
    for folder in &parts_in(folders)? {
        let is_empty = fs::read_dir(folder).is_ok() && !Part::is_part(folder);
        if is_empty {
            // No part of it is complete.
            continue;
        }
        if Part::files(folder)? != plan.files {
            return Err(MergeError::ForeignPart {
                folder: folder.clone(),
            });
        }
        let part = Part::read(folder, plan)?;
        let theirs = part.model_version();
        if part.has_runs() && theirs != MODEL_VERSION {
            let folder = folder.clone();
            return Err(FolderError::OtherModel { folder, theirs }.into());
        }
        for index in part.finished() {
            is_finished[index] = true;
        }
    }
    let missing = (0..is_finished.len()).filter(|&index| !is_finished[index]);
    Ok(Subset::of(missing.collect()))
}
