//! Writes an experiment's file whose run repeats the commands of a swarm.

use std::fmt::Write as _;

use jostle_physics::simulation::steps_in;
use jostle_proto::{Spec, verbs};
use thiserror::Error;
use toml::{Table, Value};

use crate::error::PlanError;
use crate::files::Files;
use crate::limits::{MAX_BLOCKS, MAX_RUNS, MAX_SET_POINTS};
use crate::plan::Plan;
use crate::set_points::SetPointLog;

/// Fields of a spec that change no step, and the one that the file has as `seeds`.
const OMITTED: [&str; 4] = ["measures", "publish_every", "rate", "seed"];

/// A change that was applied to a swarm.
#[derive(Clone, Debug, PartialEq)]
pub struct AppliedChange {
    /// The step at which it was applied.
    pub step: u64,
    /// The key of its random draws.
    pub draw: u64,
    /// The verb and its arguments.
    pub change: verbs::Change,
}

/// A swarm from its start to a step.
#[derive(Clone, Debug, PartialEq)]
pub struct SwarmHistory {
    /// The name of the swarm, which becomes that of the experiment.
    pub name: String,
    /// Its spec, with the seed of its present run.
    pub spec: Spec,
    /// The number of steps that it has taken.
    pub steps: u64,
    /// The hash of its state, in hexadecimal.
    pub state_hash: String,
    /// The changes that were applied to it, in this order.
    pub changes: Vec<AppliedChange>,
    /// The number of later changes that are not in `changes`, which then has more than a file can have.
    pub omitted: u64,
    /// What controllers did with individuals.
    pub set_points: SetPointLog,
}

/// What a file has beside the commands of a swarm.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExportOptions {
    /// The number of runs, with seeds of their own; none is one run with the seed of the swarm.
    pub replicates: Option<u64>,
    /// The name of the CSV of set-points; without it the file contains that CSV.
    pub setpoints: Option<String>,
}

/// The file of an experiment, and the file that it names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportedFiles {
    /// The text of the TOML.
    pub toml: String,
    /// The text of the CSV of set-points, if the TOML names it.
    pub setpoints: Option<String>,
}

/// Why there is no such file.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The swarm has taken no step.
    #[error("it has taken no step: a run has at least one")]
    NoStep,
    /// Its controllers did too much.
    #[error(
        "its controllers steered individuals more than {MAX_SET_POINTS} times: that is the limit of a run"
    )]
    TooManySetPoints,
    /// It was changed too often.
    #[error(
        "it had {0} changes since its start, and a file has at most {MAX_BLOCKS} [[at]]: write its state \
         with `jostle snapshot`, and name that as start of a file with the later changes"
    )]
    TooManyChanges(u64),
    /// The number of runs is invalid.
    #[error("replicates = {0} is outside [1, {MAX_RUNS}]")]
    Replicates(u64),
    /// The file would not be an experiment. Its text is not shown, and so neither is the place of the
    /// error in it.
    #[error("its commands are no experiment: {}", .0.without_place())]
    Plan(#[from] PlanError),
}

/// Returns a file of an experiment with one run, whose last state is that of the swarm, or with runs
/// of other seeds.
///
/// Commands at the present step of the swarm are included. The run then has one more step, since
/// the commands of a run precede a step.
///
/// # Errors
///
/// [`ExportError`].
pub fn experiment_file(
    history: &SwarmHistory,
    options: &ExportOptions,
) -> Result<ExportedFiles, ExportError> {
    let SwarmHistory {
        name,
        spec,
        steps,
        changes,
        omitted,
        set_points,
        ..
    } = history;
    if *steps == 0 {
        return Err(ExportError::NoStep);
    }
    let count = changes.len() as u64 + omitted;
    if count > MAX_BLOCKS as u64 {
        return Err(ExportError::TooManyChanges(count));
    }
    if set_points.is_too_long() {
        return Err(ExportError::TooManySetPoints);
    }
    let replicates = options.replicates;
    if let Some(number) = replicates.filter(|number| !(1..=MAX_RUNS).contains(number)) {
        return Err(ExportError::Replicates(number));
    }
    let last = changes.last().map(|it| it.step).max(set_points.last_step());
    let has_later = last.is_some_and(|it| it >= *steps);
    let end = steps + u64::from(has_later);
    let mut file = heading(history, has_later, replicates);
    let runs = match replicates {
        Some(number) => format!("replicates = {number}"),
        None => format!("seeds = [{}]", spec.seed),
    };
    let duration = duration(end, spec.dt);
    let name = Value::from(name.as_str());
    let _ = writeln!(file, "name = {name}\n{runs}\nduration = {duration}");
    let count = |step| changes.iter().filter(|it| it.step == step).count() as u64;
    let csv = (!set_points.is_empty()).then(|| set_points.csv(count));
    let setpoints = csv.and_then(|csv| match &options.setpoints {
        Some(named) => {
            let _ = writeln!(file, "setpoints = {}", Value::from(named.as_str()));
            Some(csv)
        }
        None => {
            let _ = writeln!(file, "setpoints = '''\n{csv}'''");
            None
        }
    });
    file += "\n[spec]\n";
    for (key, value) in &table(spec) {
        if !OMITTED.contains(&key.as_str()) {
            let _ = writeln!(file, "{key} = {value}");
        }
    }
    for AppliedChange { step, draw, change } in changes {
        let time = *step as f64 * spec.dt;
        let _ = write!(file, "\n[[at]]\nstep = {step}    # t = {time}\n");
        if has_draws(change) {
            let _ = writeln!(file, "draw = {draw}");
        }
        let mut change = table(change);
        let verb = change.remove("verb").unwrap_or_else(|| Value::from(""));
        let mut args = change
            .remove("args")
            .unwrap_or_else(|| Value::Table(Table::new()));
        if let Some(args) = args.as_table_mut() {
            // `false` is the default, also where the field has no meaning.
            args.retain(|_, value| *value != Value::Boolean(false));
        }
        let _ = writeln!(file, "{} = {args}", verb.as_str().unwrap_or_default());
    }
    Plan::of(Files {
        setpoints: setpoints.clone(),
        ..Files::from(file.as_str())
    })?;
    Ok(ExportedFiles {
        toml: file,
        setpoints,
    })
}

/// Returns the comment at the top of a file.
fn heading(history: &SwarmHistory, has_later: bool, replicates: Option<u64>) -> String {
    let SwarmHistory {
        name,
        spec,
        steps,
        state_hash,
        ..
    } = history;
    let time = *steps as f64 * spec.dt;
    let mut text = format!("# The commands of the swarm {name} up to step {steps}, t = {time}.\n");
    text += &match (replicates, has_later) {
        (Some(_), _) => "# The runs below have other seeds than the swarm.\n".to_owned(),
        (None, false) => format!("# The run below ends with its state_hash:\n# {state_hash}\n"),
        (None, true) => {
            "# Commands were applied at this step: the run below takes one step more, and ends \
             with\n# the state_hash that the swarm has after that step.\n"
                .to_owned()
        }
    };
    if replicates.is_none() {
        text += "# For other seeds, give replicates instead of seeds.\n";
    }
    text
}

/// Whether a change draws individuals or places.
fn has_draws(change: &verbs::Change) -> bool {
    let select = match change {
        verbs::Change::Set(_) => return false,
        verbs::Change::Inject(args) => return args.at.is_none(),
        verbs::Change::Inform(args) => &args.select,
        verbs::Change::Uninform(args) => &args.select,
        verbs::Change::Remove(args) => &args.select,
    };
    matches!(select, verbs::Select::Count(_) | verbs::Select::Fraction(_))
}

/// Returns a duration that is `steps` steps.
fn duration(steps: u64, dt: f64) -> Value {
    let duration = steps as f64 * dt;
    debug_assert_eq!(steps_in(duration, dt), steps);
    Value::from(duration)
}

/// Returns the fields of a message, without those that are null.
fn table(message: &impl serde::Serialize) -> Table {
    // Messages are structs, which have no field that TOML cannot represent.
    Table::try_from(message).unwrap_or_default()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use jostle_convert::{change, hexadecimal, spec};
    use jostle_physics::simulation::Simulation;
    use serde_json::json;

    use super::*;
    use crate::run::execute_run;

    /// A swarm whose commands have the numbers of a daemon's: `run` and `pause` count, too.
    struct Swarm {
        simulation: Simulation,
        history: SwarmHistory,
    }

    impl Swarm {
        fn new(text: &serde_json::Value) -> Self {
            let message: Spec = serde_json::from_value(text.clone()).unwrap();
            let n = usize::try_from(message.n).unwrap();
            Self {
                simulation: Simulation::new(&spec::from_proto(&message, n).unwrap()).unwrap(),
                history: SwarmHistory {
                    name: "school".to_owned(),
                    spec: message,
                    steps: 0,
                    state_hash: String::new(),
                    changes: Vec::new(),
                    omitted: 0,
                    set_points: SetPointLog::default(),
                },
            }
        }

        fn other_commands(&mut self, count: u64) {
            self.simulation.seq += count;
        }

        fn apply(&mut self, verb: &str, args: &serde_json::Value) {
            let message: verbs::Change =
                serde_json::from_value(json!({"verb": verb, "args": args})).unwrap();
            self.history.changes.push(AppliedChange {
                step: self.simulation.state.step,
                draw: self.simulation.seq + 1,
                change: message.clone(),
            });
            let change = change::change(message).unwrap();
            self.simulation.apply(&change).unwrap();
        }

        fn step(&mut self, steps: u64) {
            for _ in 0..steps {
                self.simulation.step().unwrap();
            }
            self.history.steps = self.simulation.state.step;
            self.history.state_hash = hexadecimal(&self.simulation.state.hash());
        }
    }

    fn file_of(history: &SwarmHistory) -> String {
        let files = experiment_file(history, &ExportOptions::default()).unwrap();
        assert_eq!(files.setpoints, None);
        files.toml
    }

    fn last_hash(file: &str) -> String {
        let plan = Plan::parse(file).unwrap();
        assert_eq!(plan.runs().len(), 1);
        let run = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
        assert_eq!(run.fault, None);
        run.row.unwrap().state_hash
    }

    #[test]
    fn the_run_of_the_file_ends_with_the_hash_of_the_swarm() {
        for more in [
            json!({}),
            json!({"noise": 0.2, "attraction": {"kind": "topological", "neighbours": 5}}),
            json!({"dt": 0.07, "pi1": 2.5, "start": {"kind": "disc", "radius": 9.5}}),
        ] {
            let mut text = json!({"n": 20, "seed": 9_007_199_254_740_991_u64, "rate": null});
            let fields = text.as_object_mut().unwrap();
            fields.extend(more.as_object().unwrap().clone());
            let mut swarm = Swarm::new(&text);
            swarm.other_commands(3);
            swarm.apply("set", &json!({"pi3": 1.3, "contacts": "closest"}));
            swarm.apply(
                "inform",
                &json!({"select": {"fraction": 0.3}, "direction": 0.1}),
            );
            swarm.step(31);
            swarm.apply("inject", &json!({"count": 4, "direction": 3}));
            swarm.other_commands(1);
            swarm.apply("remove", &json!({"select": {"count": 6}}));
            swarm.step(17);
            swarm.apply(
                "inform",
                &json!({"select": {"foremost": {"count": 2, "along": 1}}, "direction": -1, "weight": 0.7, "for_time": 0.3}),
            );
            swarm.apply("uninform", &json!({"select": {"count": 1}}));
            swarm.step(40);
            let file = file_of(&swarm.history);
            assert_eq!(last_hash(&file), swarm.history.state_hash, "{file}");
            assert!(file.contains(&swarm.history.state_hash), "{file}");
        }
    }

    #[test]
    fn commands_at_the_present_step_are_followed_by_a_step() {
        let mut swarm = Swarm::new(&json!({"n": 12, "seed": 3}));
        swarm.step(10);
        swarm.apply("inform", &json!({"select": {"count": 4}, "direction": 1}));
        let before = swarm.history.state_hash.clone();
        let file = file_of(&swarm.history);
        assert!(!file.contains(&before), "{file}");
        swarm.step(1);
        assert_eq!(last_hash(&file), swarm.history.state_hash);
    }

    #[test]
    fn a_file_with_replicates_has_runs_with_other_seeds() {
        let mut swarm = Swarm::new(&json!({"n": 12, "seed": 3}));
        swarm.apply("inform", &json!({"select": {"count": 4}, "direction": 1}));
        swarm.step(10);
        let options = |replicates| ExportOptions {
            replicates: Some(replicates),
            ..ExportOptions::default()
        };
        let file = experiment_file(&swarm.history, &options(7)).unwrap().toml;
        assert!(!file.contains(&swarm.history.state_hash), "{file}");
        let seeds: Vec<u64> = Plan::parse(&file)
            .unwrap()
            .runs()
            .iter()
            .map(|run| run.seed)
            .collect();
        assert_eq!(seeds.len(), 7);
        assert!(!seeds.contains(&3));
        for wrong in [0, MAX_RUNS + 1] {
            let error = experiment_file(&swarm.history, &options(wrong)).unwrap_err();
            assert!(error.to_string().contains("outside [1, 100000]"), "{error}");
        }
    }

    #[test]
    fn the_error_of_an_export_names_no_line_of_a_file_that_nobody_sees() {
        let mut swarm = Swarm::new(&json!({"n": 12, "seed": 3}));
        swarm.step(1);
        swarm.history.spec.n = 150_000;
        let error = experiment_file(&swarm.history, &ExportOptions::default()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "its commands are no experiment: n = 150000 is outside [1, 100000]"
        );
    }

    #[test]
    fn a_swarm_without_steps_and_one_with_too_many_commands_are_rejected() {
        let mut swarm = Swarm::new(&json!({"n": 12, "seed": 3}));
        let error = experiment_file(&swarm.history, &ExportOptions::default()).unwrap_err();
        assert!(matches!(error, ExportError::NoStep), "{error}");
        for k in 0..1000 {
            swarm.apply("set", &json!({"pi2": 0.5 + 1e-6 * f64::from(k)}));
        }
        swarm.step(1);
        assert_eq!(file_of(&swarm.history).matches("[[at]]").count(), 1000);
        swarm.apply("set", &json!({"pi2": 0.7}));
        swarm.step(1);
        for omitted in [0, 33] {
            swarm.history.omitted = omitted;
            let error = experiment_file(&swarm.history, &ExportOptions::default());
            let error = error.unwrap_err().to_string();
            let count = format!("it had {} changes since its start", 1001 + omitted);
            for part in [
                &count,
                "at most 1000 [[at]]",
                "`jostle snapshot`",
                "start of a file",
            ] {
                assert!(error.contains(part), "{part}: {error}");
            }
            assert!(!error.contains("line "), "{error}");
        }
    }
}
