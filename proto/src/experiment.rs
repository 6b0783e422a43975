//! Experiments: grids of runs that a daemon executes, and their results.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::keys::NAME_RULE;
use crate::result_row::ResultRow;
use crate::walk::lenient;
use crate::{LARGEST_WHOLE, Spec, column};

/// A command to an experiment; sent to a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ExperimentArgs {
    /// Execute it after those before it. The same text under the same name is the same experiment:
    /// it resumes if it was cancelled.
    Submit(SubmitArgs),
    /// Pause its runs.
    Pause(ExperimentName),
    /// Resume a paused one; one that was cancelled, failed, or is finished and lacks files is queued again.
    Resume(ExperimentName),
    /// End it; what is finished is kept.
    Cancel(ExperimentName),
    /// Delete one that has ended, with its results.
    Delete(ExperimentName),
    /// Return the commands of a run, which a client can schedule in a swarm. Changes nothing.
    Expand(ExpandArgs),
}

/// A run of an experiment that need not be submitted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExpandArgs {
    /// The file that describes the experiment, TOML.
    pub toml: String,
    /// The contents of the CSV that `points` in the file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// The contents of the snapshot that `start` in the file names, its CBOR as base64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
    /// The contents of the CSV that `setpoints` in the file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoints: Option<String>,
    /// The run, by its name or by its number in the plan, from 1; the first one if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// A run as the swarm and the commands that have its states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExpandedRun {
    /// Its name.
    pub run: String,
    /// The spec of the swarm, with the seed of the run.
    #[serde(deserialize_with = "lenient")]
    pub spec: Spec,
    /// The snapshot from which `restore` creates the swarm, its CBOR as base64; left out if `create`
    /// creates it from `spec`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub snapshot: Option<String>,
    /// The number of its steps, at most.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub steps: u64,
    /// The commands to send, in this order.
    pub commands: Vec<RunCommand>,
    /// The condition that ends the run and pauses the swarm; `null` if there is none.
    pub stop: Option<String>,
}

/// A command of a run, and its `at_step`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunCommand {
    /// The step before which it is executed; `null` if it is executed at once.
    #[schemars(range(max = LARGEST_WHOLE))]
    pub at_step: Option<u64>,
    /// `batch`: the changes of one execution of an `[[at]]` block; `when`: a block with a condition, or
    /// `[stop]`.
    pub verb: String,
    /// The arguments of the verb.
    pub args: Value,
}

/// An experiment to execute.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SubmitArgs {
    /// The file that describes it, TOML.
    pub toml: String,
    /// The contents of the CSV that `points` in the file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// The contents of the snapshot that `start` in the file names, its CBOR as base64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
    /// The contents of the CSV that `setpoints` in the file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoints: Option<String>,
    /// Its name; that in the file if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: Option<String>,
    /// Execute all runs again, beside the experiment of this name, if another version of the model executed
    /// that one's runs: `school` becomes `school-model2` under version 2.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub again: bool,
}

/// Which experiment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExperimentName {
    /// Its name.
    #[schemars(regex(pattern = NAME_RULE))]
    pub name: String,
}

/// The reply to a command about an experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExperimentResult {
    /// Whether the command created it.
    pub created: bool,
    /// Its progress; of a deleted one, its last; with `expand`, that at its beginning.
    pub progress: Progress,
    /// The run of `expand`; left out by other commands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expanded: Option<ExpandedRun>,
}

/// The progress of an experiment, published while it changes, at most twice a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Progress {
    /// The experiment's name.
    pub name: String,
    /// Its phase.
    pub phase: ExperimentPhase,
    /// Number of runs.
    pub runs: u64,
    /// Number of finished runs.
    pub finished: u64,
    /// Number of finished runs that ended early.
    pub faulted: u64,
    /// The finished share of the work, 0 to 1, with that of the present runs.
    pub share: f64,
    /// Seconds that it has run, without pauses.
    pub elapsed_secs: f64,
    /// Seconds that it will still take, without pauses; `null` while there is no estimate.
    pub left_secs: Option<f64>,
    /// The runs that are being executed.
    pub running: Vec<RunUnderWay>,
    /// Why it failed or the daemon paused it, or a remark on its runs; `null` without one.
    pub message: Option<String>,
    /// The version of the model that executed its finished runs, if the daemon has another one: no run is
    /// added to them, and they remain readable. Left out if the daemon has this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model_version: Option<u32>,
    /// The earliest version of the model that computed a part of the snapshot from which its runs start, if
    /// it is before that of the runs. Left out otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_model_version: Option<u32>,
}

/// What an experiment is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExperimentPhase {
    /// It waits for those before it.
    Queued,
    /// Its runs are carried out.
    Running,
    /// Its runs are paused until it is resumed, also when the daemon restarts.
    Paused,
    /// Every run is over, and the tables are written.
    Finished,
    /// It was ended half way.
    Cancelled,
    /// It cannot go on.
    Failed,
}

impl fmt::Display for ExperimentPhase {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(formatter)
    }
}

impl ExperimentPhase {
    /// Whether nothing more happens to it by itself.
    #[must_use]
    pub fn is_over(self) -> bool {
        matches!(self, Self::Finished | Self::Cancelled | Self::Failed)
    }
}

/// A run that is being executed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunUnderWay {
    /// Its name.
    pub run: String,
    /// The finished share of its steps, 0 to 1.
    pub share: f64,
}

/// The experiments of a daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Experiments {
    /// The experiments, in the order of submission.
    pub experiments: Vec<Progress>,
}

/// Some rows of an experiment's table of results, in the order of its plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResultsPage {
    /// The experiment's name.
    pub name: String,
    /// The rows of the finished runs, faulted ones included, after the requested run.
    pub rows: Vec<ResultRow>,
    /// The number to request the next page after, as `after`; `null` after the last page.
    pub next: Option<u64>,
    /// Number of finished runs.
    pub finished: u64,
    /// The columns that only some experiments have, so that a table without rows has them, too;
    /// left out in replies of earlier
    /// versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub columns: Option<OccasionalColumns>,
}

/// The columns that only the tables of some experiments have, in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OccasionalColumns {
    /// The values that vary in the names of the runs, such as `pi1`.
    pub varied: Vec<String>,
    /// Those of the table of results, as `extra` of a row: variables, `stopped_at`, and means of measures.
    pub extra: Vec<String>,
    /// The measures over time.
    pub series: Vec<String>,
}

/// A run's order over time, if the experiment measures it.
///
/// In CBOR the columns are RFC 8746 typed arrays, little-endian.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OrderPage {
    /// The experiment's name.
    pub name: String,
    /// The run's name.
    pub run: String,
    /// The times of the entries.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub time: Vec<f64>,
    /// The polar order parameter at each.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub order: Vec<f64>,
    /// The drift along the informed individuals' direction at each, `null` (in CBOR NaN) where it is
    /// undefined; empty if it is undefined everywhere.
    #[serde(with = "column::nan_column")]
    #[schemars(with = "Vec<Option<f64>>")]
    pub drift: Vec<f64>,
    /// Where to ask on, as `after`; `null` if there is no more.
    pub next: Option<u64>,
    /// How many entries the run has. Left out by earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total: Option<u64>,
}

/// The chosen measures of a run over time, if the experiment has `series_every`; or with
/// `of=individuals` its trajectory, if the experiment has `record_every`.
///
/// An entry of a trajectory is an individual at a step. Its measures are `id`, `x`, `y` and `alpha`, as in
/// a state but with absolute positions, and `informed`, 1 or 0.
///
/// In CBOR the columns are RFC 8746 typed arrays, little-endian.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SeriesPage {
    /// The experiment's name.
    pub name: String,
    /// The run's name.
    pub run: String,
    /// The steps of the entries.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub step: Vec<f64>,
    /// The times of the entries.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub time: Vec<f64>,
    /// The measures, in the order of the experiment's file.
    pub measures: Vec<MeasureSeries>,
    /// The metadata of a trajectory, in its first page: the `spec` and the `variables` of the run as
    /// JSON, its `seed`, the `units` of the columns as JSON, and the `version` of the daemon.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<Vec<Metadata>>,
    /// Where to ask on, as `after`; `null` if there is no more.
    pub next: Option<u64>,
    /// How many entries the run has. Left out by earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total: Option<u64>,
}

/// A value of the metadata of a trajectory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Metadata {
    /// Its key, such as `seed`.
    pub key: String,
    /// Its value as text.
    pub value: String,
}

/// One measure of a run over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeasureSeries {
    /// Its name, as in the experiment's file.
    pub name: String,
    /// Its value at each entry, `null` (in CBOR NaN) where it is undefined.
    #[serde(with = "column::nan_column")]
    #[schemars(with = "Vec<Option<f64>>")]
    pub value: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::ExperimentPhase::{Cancelled, Failed, Finished, Paused, Queued, Running};

    #[test]
    fn three_phases_end_an_experiment() {
        let all = [Queued, Running, Paused, Finished, Cancelled, Failed];
        let over = all.map(super::ExperimentPhase::is_over);
        assert_eq!(over, [false, false, false, true, true, true]);
    }
}
