//! Why parts cannot be merged.

use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::path::PathBuf;

use jostle_physics::model::MODEL_VERSION;
use thiserror::Error;

use crate::error::PlanError;
use crate::files::EXPERIMENT;
use crate::folder::FolderError;
use crate::subset::Subset;

/// How many runs or folders an error names.
const MAX_NAMED: usize = 10;

/// Why parts cannot be merged.
#[derive(Debug, Error)]
pub enum MergeError {
    /// A folder cannot be read or written.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A part's `experiment.toml` is not an experiment's file.
    #[error("failed to parse {}/{EXPERIMENT}: {source}; copy the part again", folder.display())]
    Plan {
        /// The part.
        folder: PathBuf,
        /// What is wrong.
        source: PlanError,
    },
    /// No parts are given.
    #[error("no parts are given: use the folders that `jostled run --part` wrote")]
    NoParts,
    /// Parts are of another experiment than most parts.
    #[error(
        "parts of another experiment than {}: {}; merge only parts of the same, unchanged {EXPERIMENT}",
        first.display(), join(others.iter().map(|it| it.display().to_string()))
    )]
    OtherExperiment {
        /// The first part of the experiment of most parts.
        first: PathBuf,
        /// The parts that differ from it.
        others: Vec<PathBuf>,
    },
    /// Parts were executed under different definitions of measures.
    #[error(
        "parts with other definitions of drift and front than {}: {}; an earlier version of jostle executed \
         some of them: execute either again, in a new folder, with this one",
        first.display(), join(others.iter().map(|it| it.display().to_string()))
    )]
    OtherDefinitions {
        /// The first part.
        first: PathBuf,
        /// The parts whose definitions are not those of the first.
        others: Vec<PathBuf>,
    },
    /// Parts were executed by different versions of the model.
    #[error(
        "parts of different versions of the model: {}; execute those of one version again, with `jostled run \
         --again` and the other version's program", join(versions.iter().map(of_version))
    )]
    OtherModel {
        /// The first part of each version, and their number.
        versions: BTreeMap<u32, (PathBuf, usize)>,
    },
    /// Runs are in no part, and the parts are of another version of the model.
    #[error(
        "{} of {of} runs are missing, {}, and version {theirs} of the model executed the others, while this \
         program has {MODEL_VERSION}: `jostled run --again` executes all of them again",
        runs.indices().len(), shortened(runs)
    )]
    Unfinishable {
        /// The missing runs.
        runs: Subset,
        /// Number of runs of the experiment.
        of: usize,
        /// The version of the model that executed the others.
        theirs: u32,
    },
    /// Runs of another version of the model were to be executed again.
    #[error(
        "version {theirs} of the model executed the runs, and this program has {MODEL_VERSION}, which \
         computes other states: merge them without --verify"
    )]
    Unverifiable {
        /// The version of the model that executed the runs.
        theirs: u32,
    },
    /// A part is of another experiment.
    #[error(
        "{} contains another experiment: use the file that its runs were executed with",
        folder.display()
    )]
    ForeignPart {
        /// The part.
        folder: PathBuf,
    },
    /// Two parts contain the same runs.
    #[error(
        "{} and {} both contain runs {runs}: leave out one of them, and execute runs that are missing \
         then with `jostled run FILE --runs`", first.display(), second.display()
    )]
    Duplicate {
        /// One part.
        first: PathBuf,
        /// The other part.
        second: PathBuf,
        /// The runs that both contain.
        runs: Subset,
    },
    /// Runs are in no part.
    #[error(
        "{} of {of} runs are missing, {}: execute the same `jostled run --part` again, which resumes an \
         interrupted part; `jostle experiment plan FILE --missing FOLDER...` plans the missing runs \
         as new parts", runs.indices().len(), shortened(runs)
    )]
    Missing {
        /// The missing runs.
        runs: Subset,
        /// Number of runs of the experiment.
        of: usize,
    },
    /// Files of finished runs are missing, and no other part contains these runs.
    #[error(
        "{} of {of} runs lack files, {}: copy their parts again, or execute the same `jostled run` \
         again, which executes these runs again", runs.indices().len(), shortened(runs)
    )]
    MissingFiles {
        /// The runs.
        runs: Subset,
        /// Number of runs of the experiment.
        of: usize,
    },
    /// Runs that were executed again for verification have other results than in their part.
    #[error(
        "{} of {of} runs have another result when they are executed here: {}; compare the versions and \
         the hardware of both machines, and execute these parts again on another one",
        runs.len(), join(runs.iter().map(Difference::to_string))
    )]
    Differs {
        /// The runs that differ.
        runs: Vec<Difference>,
        /// Number of runs that were executed again.
        of: usize,
    },
    /// Not all runs arrived in the merged folder.
    #[error(
        "{finished} of {runs} runs were written, since a part was changed meanwhile: merge again"
    )]
    Incomplete {
        /// Number of runs that were written.
        finished: usize,
        /// Number of runs of the experiment.
        runs: usize,
    },
    /// The folder for the merged results exists.
    #[error("{} exists and is not empty: choose another folder", folder.display())]
    Exists {
        /// The folder.
        folder: PathBuf,
    },
}

impl MergeError {
    /// Returns the version of the model, not that of this program, because of which parts cannot be merged.
    #[must_use]
    pub fn other_model(&self) -> Option<u32> {
        match self {
            Self::OtherModel { versions } => {
                let mut versions = versions.keys().copied();
                versions.find(|version| *version != MODEL_VERSION)
            }
            Self::Unfinishable { theirs, .. }
            | Self::Unverifiable { theirs }
            | Self::Folder(FolderError::OtherModel { theirs, .. }) => Some(*theirs),
            _ => None,
        }
    }
}

fn of_version((version, (first, count)): (&u32, &(PathBuf, usize))) -> String {
    let others = match count - 1 {
        0 => String::new(),
        others => format!(" and {others} more"),
    };
    format!("version {version} in {}{others}", first.display())
}

/// A run with another result when it is executed again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The run.
    pub run: String,
    /// The part that contains it.
    pub folder: PathBuf,
    /// The hash of its last state in that part; empty if it has no row there.
    pub theirs: String,
    /// The hash that was computed here.
    pub ours: String,
}

impl Display for Difference {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [theirs, ours] =
            [&self.theirs, &self.ours].map(|hash| hash.get(..8).unwrap_or("no row"));
        write!(to, "{:?} of {} (", self.run, self.folder.display())?;
        match theirs == ours {
            true => write!(to, "state hash {ours} on both, other measurements)"),
            false => write!(to, "state hash {theirs}, here {ours})"),
        }
    }
}

/// The numbers of missing runs, shortened if there are many separate ones.
fn shortened(runs: &Subset) -> String {
    let text = runs.to_string();
    let ranges: Vec<&str> = text.split(',').collect();
    match ranges.len() {
        ..=MAX_NAMED => text,
        count => {
            let first = ranges[..MAX_NAMED].join(",");
            format!("{first} and {} more ranges", count - MAX_NAMED)
        }
    }
}

/// Joins texts, at most [`MAX_NAMED`] of them.
fn join(texts: impl ExactSizeIterator<Item = String>) -> String {
    let more = texts.len().saturating_sub(MAX_NAMED);
    let mut joined = texts.take(MAX_NAMED).collect::<Vec<_>>().join(", ");
    if more > 0 {
        joined.push_str(&format!(" and {more} more"));
    }
    joined
}
