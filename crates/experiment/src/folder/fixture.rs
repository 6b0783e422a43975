//! Folders of one experiment, for tests.

use std::fs;
use std::path::PathBuf;

use super::Folder;
use super::list::RUNS;
use crate::execute::{Execution, execute};
use crate::plan::Plan;
use crate::progress::ExecutionControl;
use crate::subset::Subset;

pub struct Fixture {
    directory: tempfile::TempDir,
    pub plan: Plan,
}

impl Fixture {
    pub fn new(file: &str) -> Self {
        Self {
            directory: tempfile::tempdir().unwrap(),
            plan: Plan::parse(file).unwrap(),
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// Executes runs, such as `1-2`, and returns the folder with this name.
    pub fn execute(&self, name: &str, runs: &str) -> Folder {
        let mut folder = Folder::open(&self.path(name), &self.plan).unwrap();
        let execution = Execution {
            plan: &self.plan,
            subset: &Subset::parse(&self.plan, runs).unwrap(),
            threads: 1,
            checkpoint_every: None,
        };
        let outcome = execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
        assert_eq!(outcome.finished, execution.subset.indices().len());
        folder
    }

    /// Reads the list of runs.
    pub fn list(&self, name: &str) -> String {
        fs::read_to_string(self.path(name).join(RUNS)).unwrap()
    }

    /// Replaces `from` in the list of runs, where it occurs.
    pub fn edit(&self, name: &str, from: &str, to: &str) {
        let text = self.list(name);
        assert!(text.contains(from), "{text}");
        fs::write(self.path(name).join(RUNS), text.replace(from, to)).unwrap();
    }
}
