//! Checkpoints of a run: files from which another process resumes it.

use jostle_proto::Snapshot;
use jostle_proto::snapshot::PastFrame;
use serde::{Deserialize, Serialize};

use super::measures::Measures;
use crate::contact_events::ContactMeter;
use crate::protocol::ProtocolProgress;

/// The snapshot of a run at one of its steps, and its measurements so far.
#[derive(Deserialize, Serialize)]
pub struct RunCheckpoint {
    pub(super) run: String,
    pub(super) snapshot: Snapshot,
    pub(super) measures: Measures,
    pub(super) meter: Option<ContactMeter>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) past: Vec<PastFrame>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) protocol: Option<ProtocolProgress>,
    /// The bytes of the frames of the trajectory before this step, if one is recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) recorded: Option<u64>,
    /// The hashes of what is recorded before this step.
    #[serde(default)]
    pub(crate) hashes: RecordedHashes,
}

/// The hashes of the spools of a run, in hexadecimal digits; checkpoints of earlier versions have none.
#[derive(Default, Deserialize, Serialize)]
pub struct RecordedHashes {
    /// Of the frames of the trajectory.
    pub(crate) frames: Option<String>,
    /// Of the rows of each long series, by [`SeriesKind`](crate::SeriesKind).
    pub(crate) rows: [Option<String>; 2],
}

impl RunCheckpoint {
    /// Returns the checkpoint as CBOR.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        jostle_proto::to_cbor(self)
    }

    /// The time series of the run so far.
    #[cfg(feature = "files")]
    pub(crate) fn logs(
        &self,
    ) -> impl Iterator<Item = (crate::series::SeriesKind, &crate::series::SeriesLog)> {
        self.measures.logs()
    }

    /// Parses a checkpoint; none if it is damaged or has another layout.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        ciborium::from_reader(bytes).ok()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::plan::Plan;
    use crate::run::{execute_run, execute_run_from};

    fn plan(seed: u64, more: &str) -> Plan {
        let text = format!(
            "name = \"a\"\nseed = {seed}\nduration = 6\n[measure]\norder_every = 7\nseries_every = 9\ncolumns = \
             [\"drift\", \"msd(0.5)\"]\n{more}\n[spec]\n\
             n = 12\nnoise = 0.1\nrelinearise = 1\n[[grid]]\ninformed = 3\nreplicates = 2\n"
        );
        Plan::parse(&text).unwrap()
    }

    /// The checkpoint of a run after `steps` steps, as its file has it.
    fn checkpoint(plan: &Plan, run: usize, steps: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        execute_run_from(plan, &plan.runs()[run], None, None, |current| {
            bytes = current.checkpoint().to_bytes();
            current.steps() < steps
        });
        bytes
    }

    #[test]
    fn a_run_continues_after_the_step_of_its_checkpoint_with_the_same_result() {
        let plan = plan(1, "touch = true");
        let run = &plan.runs()[0];
        let expected = execute_run(&plan, run, |_| true).unwrap();
        assert!(expected.touch.is_some() && expected.order.is_some() && expected.series.is_some());
        for steps in [1, 150, 299, 300] {
            let checkpoint = RunCheckpoint::from_bytes(&checkpoint(&plan, 0, steps)).unwrap();
            let mut first = None;
            let finished = execute_run_from(&plan, run, Some(checkpoint), None, |current| {
                first.get_or_insert(current.steps());
                true
            });
            assert_eq!(finished.unwrap(), expected, "{steps}");
            assert_eq!(first, (steps < 300).then_some(steps + 1));
        }
    }

    #[test]
    fn a_checkpoint_of_another_run_is_ignored() {
        let first_step = |plan: &Plan, checkpoint: RunCheckpoint| {
            let mut first = None;
            execute_run_from(plan, &plan.runs()[0], Some(checkpoint), None, |current| {
                first = Some(current.steps());
                false
            });
            first.unwrap()
        };
        let read = |bytes: &[u8]| RunCheckpoint::from_bytes(bytes).unwrap();
        let touch = plan(1, "touch = true");
        let bytes = checkpoint(&touch, 0, 10);
        assert_eq!(first_step(&touch, read(&bytes)), 11);
        for other in [plan(2, "touch = true"), plan(1, "")] {
            assert_eq!(first_step(&other, read(&bytes)), 1);
        }
        assert_eq!(first_step(&touch, read(&checkpoint(&touch, 1, 10))), 1);
        let mut changed = read(&bytes);
        changed.snapshot.x[0] += 0.1;
        assert_eq!(first_step(&touch, changed), 1);
        let mut older = read(&bytes);
        older.snapshot.model_version += 1;
        assert_eq!(first_step(&touch, older), 1);
        for end in [0, 1, bytes.len() / 2, bytes.len() - 1] {
            assert!(RunCheckpoint::from_bytes(&bytes[..end]).is_none());
        }
    }
}
