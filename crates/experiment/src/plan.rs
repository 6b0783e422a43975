//! The plan of an experiment: all its runs, checked before the first one starts.

use std::collections::BTreeMap;
use std::sync::Arc;

use jostle_measures::{Measure, MeasureError, check_past};
use jostle_physics::simulation::{Spec, Start, begin, steps_in};
use jostle_proto::{LARGEST_WHOLE, keys};
use toml::Spanned;

use crate::error::PlanError;
use crate::file::{File, Measure as MeasureTable, Source};
use crate::grid::{self, AXES, Choice, Grid};
use crate::limits::{
    MAX_BLOCKS, MAX_BLOCKS_OF_PLAN, MAX_COLUMNS, MAX_ENTRIES, MAX_INDIVIDUALS, MAX_RUNS, MAX_STEPS,
};
use crate::protocol::{Protocol, Setting, Variables, used};
use jostle_convert::spec;
use jostle_convert::value::count;

/// An experiment: common settings and the list of runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The name of the experiment.
    pub name: String,
    /// The seed from which the seeds of all runs are derived.
    pub seed: u64,
    /// The duration of each run, in time units.
    pub duration: f64,
    /// Steps between two entries of the order's time series; none if no series is recorded.
    pub order_every: Option<u64>,
    /// Whether contacts and their effect on bodies are measured.
    pub touch: bool,
    /// The measures whose means are columns of the table of results.
    pub columns: Columns,
    /// The text of the experiment's file, unchanged.
    pub text: String,
    points: Vec<Point>,
    runs: Vec<PlannedRun>,
    /// The indices of all runs, sorted by name.
    by_name: Vec<usize>,
}

/// Measures whose means are columns of the table of results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    /// The measures.
    pub measures: Vec<Measure>,
    /// The time from which they are measured, in time units.
    pub from: f64,
    /// Steps between two measurements.
    pub every: u64,
}

/// The settings that the replicates of a run share.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The spec of the swarm, except for its seed.
    pub spec: Spec,
    /// Number of individuals that are informed from the start.
    pub informed: usize,
    /// Number of steps of a run, at most.
    pub steps: u64,
    /// The values of the variables.
    pub variables: Variables,
    /// The commands of a run, and the condition that ends it.
    pub protocol: Option<Arc<Protocol>>,
}

/// One run of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedRun {
    /// The values that vary and the replicate: `pi1=4 n=50 #0`.
    pub name: String,
    /// The seed of the run, derived from the experiment's seed and the name.
    pub seed: u64,
    point: usize,
}

impl Plan {
    /// Parses and checks an experiment's file.
    ///
    /// Runs are ordered by grid. Within a grid the axes vary in the order of [`AXES`], the last one
    /// fastest, each in the order of its listed values; replicates vary fastest of all. The name of
    /// a run contains every axis of any grid. Adding values to an axis therefore changes no name
    /// and no seed.
    ///
    /// # Errors
    ///
    /// [`PlanError`], with the line or the run.
    pub fn parse(text: &str) -> Result<Self, PlanError> {
        let source = Source(text);
        let file = source.read()?;
        let name = file.name.get_ref();
        if !keys::is_name(name) {
            let reason = format!(
                "invalid name = {name:?}: use 1 to {} lowercase letters, digits, '-' and '_', the \
                 first a letter or digit",
                keys::MAX_NAME_LENGTH
            );
            return Err(source.reject(&file.name.span(), reason));
        }
        let seed = source.whole("seed", file.seed.as_ref(), 0, [0, LARGEST_WHOLE])?;
        let limits = [1, MAX_RUNS];
        let replicates = source.whole("replicates", file.replicates.as_ref(), 1, limits)?;
        let every = file.measure.order_every.as_ref();
        let every = source.whole("order_every", every, 0, [1, MAX_STEPS])?;
        let duration = *file.duration.get_ref();
        if !(duration.is_finite() && duration > 0.0) {
            let reason = format!("duration = {duration} is not a finite number above 0");
            return Err(source.reject(&file.duration.span(), reason));
        }
        let seeds = seeds(source, &file)?;
        let replicates = seeds
            .as_ref()
            .map_or(replicates, |seeds| seeds.len() as u64);
        let columns = columns(source, &file.measure, duration)?;
        if file.measure.touch
            && let Some(first) = file
                .at
                .iter()
                .flat_map(|table| table.keys())
                .map(Spanned::span)
                .min_by_key(|span| span.start)
        {
            let reason = "[[at]] and touch exclude each other: leave out one of them";
            return Err(source.reject(&first, reason));
        }
        check_sizes(source, &file)?;
        let common = grid::common(source, &file.spec)?;
        let used = used(file.at.iter().chain([&file.stop]));
        let grids = grid::grids(source, &file.grid, &used, replicates, MAX_RUNS)?;
        let runs = count_runs(&grids);
        if runs > MAX_RUNS {
            return Err(PlanError::TooManyRuns { runs });
        }
        let points = runs / replicates.max(1);
        if points.saturating_mul(file.at.len() as u64) > MAX_BLOCKS_OF_PLAN as u64 {
            let first = file
                .at
                .iter()
                .flat_map(|table| table.keys())
                .map(Spanned::span);
            let span = first.min_by_key(|span| span.start).unwrap_or(0..0);
            let reason = format!(
                "{} blocks at {points} points of the grid: the limit is {MAX_BLOCKS_OF_PLAN} in all",
                file.at.len()
            );
            return Err(source.reject(&span, reason));
        }
        let mut plan = Self {
            name: name.clone(),
            seed,
            duration,
            order_every: (every > 0).then_some(every),
            touch: file.measure.touch,
            columns,
            text: text.to_owned(),
            points: Vec::new(),
            runs: Vec::new(),
            by_name: Vec::new(),
        };
        let is_varied = |axis: &&str| grids.iter().any(|grid| grid.has(axis));
        let axes = AXES.into_iter().chain(used.iter().map(String::as_str));
        let varied: Vec<&str> = axes.filter(is_varied).collect();
        let mut names = BTreeMap::new();
        for grid in &grids {
            for index in 0..count(grid.size().unwrap_or(0)) {
                let choice = grid.choice(source, &common, index)?;
                let name = choice.name(&varied);
                plan.add_point((source, &file), grid, &choice, &name)?;
                if let Some(seeds) = &seeds {
                    let first = plan.runs.len() - seeds.len();
                    for (run, &seed) in plan.runs[first..].iter_mut().zip(seeds) {
                        run.seed = seed;
                    }
                }
                let new = plan.runs.iter().enumerate().rev();
                for (index, run) in new.take(count(grid.replicates)) {
                    if names.insert(run.name.clone(), index).is_some() {
                        let (line, run) = (source.line(&grid.span), run.name.clone());
                        return Err(PlanError::Repeated { line, run });
                    }
                }
            }
        }
        plan.by_name = names.into_values().collect();
        let entries = plan.runs.iter().map(|run| plan.entries(run));
        match entries.fold(0, u64::saturating_add) {
            entries if entries > MAX_ENTRIES => Err(PlanError::TooManyEntries { entries }),
            _ => Ok(plan),
        }
    }

    /// Returns all runs, in the order of the tables.
    #[must_use]
    pub fn runs(&self) -> &[PlannedRun] {
        &self.runs
    }

    /// Returns the index of the run with this name.
    #[must_use]
    pub fn index(&self, name: &str) -> Option<usize> {
        let by_name = &self.by_name;
        let found = by_name.binary_search_by(|&index| self.runs[index].name.as_str().cmp(name));
        found.ok().map(|position| by_name[position])
    }

    /// Returns the settings that `run` shares with its replicates.
    #[must_use]
    pub fn point(&self, run: &PlannedRun) -> &Point {
        &self.points[run.point]
    }

    /// Returns the spec of the swarm of `run`, with its seed.
    #[must_use]
    pub fn spec(&self, run: &PlannedRun) -> Spec {
        Spec {
            seed: run.seed,
            ..self.point(run).spec.clone()
        }
    }

    /// Returns the number of entries in a run's time series.
    fn entries(&self, run: &PlannedRun) -> u64 {
        let every = self.order_every;
        every.map_or(0, |every| self.point(run).steps / every + 1)
    }

    /// Checks a choice and adds all its replicates.
    fn add_point(
        &mut self,
        (source, file): (Source<'_>, &File),
        grid: &Grid,
        choice: &Choice,
        name: &str,
    ) -> Result<(), PlanError> {
        let reject = |reason: String| source.reject(&grid.span, reason);
        let Choice { spec, informed, .. } = choice;
        if !(1..=MAX_INDIVIDUALS).contains(&spec.n) {
            let reason = format!("n = {} is outside [1, {MAX_INDIVIDUALS}]", spec.n);
            return Err(reject(reason));
        }
        let start =
            spec::from_proto(spec, count(spec.n)).map_err(|error| reject(error.to_string()))?;
        let reject_run = |error| {
            let run = numbered(name, 0);
            PlanError::Run { run, error }
        };
        let parameters = &start.parameters;
        let weight = if *informed > 0 { parameters.pi2 } else { 0.0 };
        let checked = parameters.check(weight);
        checked.map_err(|error| reject_run(error.into()))?;
        // A start in the default disc is not checked: it has room.
        if start.start != Start::Disc(None) {
            begin(&start).map_err(reject_run)?;
        }
        let steps = steps_in(self.duration, parameters.dt);
        if steps > MAX_STEPS {
            let reason = format!("a run has {steps} steps, the limit is {MAX_STEPS}");
            return Err(reject(reason));
        }
        let setting = Setting {
            spec: &start,
            informed: *informed,
            duration: self.duration,
            variables: &choice.variables,
        };
        let protocol = Protocol::resolve(source, &file.at, &file.stop, setting)?;
        let lags = self.columns.measures.iter().map(|it| it.lag(parameters.dt));
        let lag = lags.max().unwrap_or(0);
        check_past(lag, start.n).map_err(|error| {
            let span = file.measure.columns.first().map_or(0..0, Spanned::span);
            source.reject(&span, error.to_string())
        })?;
        for replicate in 0..grid.replicates {
            let name = numbered(name, replicate);
            self.runs.push(PlannedRun {
                seed: derive_seed(self.seed, &name),
                name,
                point: self.points.len(),
            });
        }
        self.points.push(Point {
            spec: start,
            informed: *informed,
            steps,
            variables: choice.variables.clone(),
            protocol,
        });
        Ok(())
    }
}

/// Checks the number of blocks and of columns.
fn check_sizes(source: Source<'_>, file: &File) -> Result<(), PlanError> {
    if let Some(first) = file.at.get(MAX_BLOCKS) {
        let span = first.keys().next().map_or(0..0, Spanned::span);
        return Err(source.reject(&span, format!("a file has at most {MAX_BLOCKS} [[at]]")));
    }
    if let Some(first) = file.measure.columns.get(MAX_COLUMNS) {
        let reason = format!("[measure] has at most {MAX_COLUMNS} columns");
        return Err(source.reject(&first.span(), reason));
    }
    Ok(())
}

/// Reads the seeds of the runs; none if they are derived.
fn seeds(source: Source<'_>, file: &File) -> Result<Option<Vec<u64>>, PlanError> {
    let Some(seeds) = &file.seeds else {
        return Ok(None);
    };
    let first = seeds.first().map_or(0..0, Spanned::span);
    let grids = file.grid.iter().flat_map(|table| table.keys());
    let mut of_grids = grids.filter(|key| key.get_ref() == "replicates");
    let reason = if file.replicates.is_some() || of_grids.next().is_some() {
        "seeds and replicates exclude each other: leave out replicates"
    } else if seeds.is_empty() || seeds.len() as u64 > MAX_RUNS {
        "seeds: give at least one"
    } else if is_repeated(seeds) {
        "seeds: a seed is given twice: its runs would be the same"
    } else {
        let whole = |seed| source.whole("seeds", Some(seed), 0, [0, LARGEST_WHOLE]);
        return seeds.iter().map(whole).collect::<Result<_, _>>().map(Some);
    };
    Err(source.reject(&first, reason))
}

fn is_repeated(seeds: &[Spanned<u64>]) -> bool {
    let mut sorted: Vec<u64> = seeds.iter().map(|seed| *seed.get_ref()).collect();
    sorted.sort_unstable();
    sorted.windows(2).any(|pair| pair[0] == pair[1])
}

/// Reads the chosen columns of `[measure]`.
fn columns(source: Source<'_>, file: &MeasureTable, duration: f64) -> Result<Columns, PlanError> {
    let every = source.whole("every", file.every.as_ref(), 1, [1, MAX_STEPS])?;
    let from = file.from.as_ref().map_or(0.0, |from| *from.get_ref());
    if let Some(given) = &file.from
        && !(from >= 0.0 && from < duration)
    {
        let reason = format!("from = {from} is outside [0, {duration}), the time of a run");
        return Err(source.reject(&given.span(), reason));
    }
    let mut measures: Vec<Measure> = Vec::new();
    for name in &file.columns {
        let reject = |reason: String| source.reject(&name.span(), reason);
        let measure: Measure = name
            .get_ref()
            .parse()
            .map_err(|error: MeasureError| reject(error.to_string()))?;
        if measures.contains(&measure) {
            return Err(reject(format!("{measure} is given twice")));
        }
        measures.push(measure);
    }
    Ok(Columns {
        measures,
        from,
        every,
    })
}

/// Returns the number of runs of all grids; saturates at `u64::MAX`.
fn count_runs(grids: &[Grid]) -> u64 {
    let runs = grids.iter().map(|grid| {
        let points = grid.size().unwrap_or(u64::MAX);
        points.saturating_mul(grid.replicates)
    });
    runs.fold(0, u64::saturating_add)
}

fn numbered(name: &str, replicate: u64) -> String {
    let space = if name.is_empty() { "" } else { " " };
    format!("{name}{space}#{replicate}")
}

/// Returns the seed of a run: the first 53 bits of BLAKE3 over the experiment's seed, as 8
/// little-endian bytes, and the run's name.
fn derive_seed(seed: u64, name: &str) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(name.as_bytes());
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    u64::from_be_bytes(first) >> 11
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use jostle_physics::model::ParametersError;
    use jostle_physics::simulation::ChangeError;

    const HEAD: &str = "name = \"a\"\nduration = 10\n";

    fn plan(rest: &str) -> Plan {
        Plan::parse(&format!("{HEAD}{rest}")).unwrap()
    }

    fn error(rest: &str) -> PlanError {
        Plan::parse(&format!("{HEAD}{rest}")).unwrap_err()
    }

    /// Returns the line and the reason of a [`PlanError::Field`].
    fn field_error(rest: &str) -> (usize, String) {
        match error(rest) {
            PlanError::Field { line, reason, .. } => (line, reason),
            other => panic!("{other}"),
        }
    }

    fn names(plan: &Plan) -> Vec<&str> {
        plan.runs().iter().map(|run| run.name.as_str()).collect()
    }

    #[test]
    fn the_papers_series_are_planned_under_both_rules() {
        let files = [
            (include_str!("../../../paper/series1.toml"), 2 * 4 * 9 * 16),
            (include_str!("../../../paper/series2.toml"), 2 * 35 * 40),
            (include_str!("../../../paper/animations.toml"), 2 * 6 * 4),
        ];
        for (text, runs) in files {
            let plan = Plan::parse(text).unwrap();
            assert_eq!(plan.runs().len(), runs, "{}", plan.name);
        }
        let plan = Plan::parse(files[1].0).unwrap();
        let run = &plan.runs()[plan.runs().len() - 1];
        assert_eq!(
            run.name,
            "pi1=8 n=40 informed_fraction=0.5 contacts=closest dt=0.1 #7"
        );
        let point = plan.point(run);
        assert_eq!((point.informed, point.steps), (20, 10_000));
        assert_eq!(plan.spec(run).seed, run.seed);
    }

    #[test]
    fn without_a_grid_there_is_one_point() {
        let plan = plan("replicates = 2\n[spec]\nn = 3\n");
        assert_eq!(names(&plan), ["#0", "#1"]);
        assert_eq!(plan.point(&plan.runs()[0]).steps, 500);
    }

    #[test]
    fn axes_vary_in_one_order_and_grids_follow_each_other() {
        let both = plan(
            "replicates = 2\n[[grid]]\nn = [5, 3]\npi1 = [2, 1.5]\n[[grid]]\nreplicates = 1\n\
             pi3 = 0.5\nn = 4",
        );
        let expected = [
            "pi1=2 pi3=1 n=5 #0",
            "pi1=2 pi3=1 n=5 #1",
            "pi1=2 pi3=1 n=3 #0",
            "pi1=2 pi3=1 n=3 #1",
            "pi1=1.5 pi3=1 n=5 #0",
            "pi1=1.5 pi3=1 n=5 #1",
            "pi1=1.5 pi3=1 n=3 #0",
            "pi1=1.5 pi3=1 n=3 #1",
            "pi1=4 pi3=0.5 n=4 #0",
        ];
        assert_eq!(names(&both), expected);
        for (index, run) in both.runs().iter().enumerate() {
            assert_eq!(both.index(&run.name), Some(index));
        }
        assert_eq!(both.index("pi1=2 pi3=1 n=5 #2"), None);
        // A value that does not vary is that of [spec], or the default.
        assert_eq!(both.spec(&both.runs()[8]).parameters.pi3, 0.5);
        let laws = plan(
            "spec = { n = 9 }\ngrid = [{ attraction = [{ kind = \"all\" }, { kind = \
             \"topological\", neighbours = 7 }], relinearise = 1, informed = 2 }]",
        );
        let expected = [
            "informed=2 relinearise=1 attraction=all #0",
            "informed=2 relinearise=1 attraction=topological:7 #0",
        ];
        assert_eq!(names(&laws), expected);
    }

    #[test]
    fn a_seed_depends_on_the_name_and_the_experiments_seed_alone() {
        let seeds = |plan: &Plan| -> Vec<(String, u64)> {
            let runs = plan.runs().iter();
            runs.map(|run| (run.name.clone(), run.seed)).collect()
        };
        let few = seeds(&plan("seed = 7\n[[grid]]\nn = [3]\npi1 = [4]"));
        // If the derivation of seeds changes, the results of all experiments change.
        assert_eq!(
            few,
            [("pi1=4 n=3 #0".to_owned(), derive_seed(7, "pi1=4 n=3 #0"))]
        );
        assert!(few[0].1 <= LARGEST_WHOLE);
        let many = plan("seed = 7\nreplicates = 3\n[[grid]]\nn = [50, 3]\npi1 = [1.5, 4.0]");
        assert!(seeds(&many).contains(&few[0]), "more values changed a seed");
        let other = seeds(&plan("seed = 8\n[[grid]]\nn = [3]\npi1 = [4]"));
        assert_ne!(few[0].1, other[0].1);
        let mut distinct: Vec<u64> = many.runs().iter().map(|run| run.seed).collect();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), many.runs().len());
    }

    #[test]
    fn invalid_fields_and_values_are_rejected_with_their_line() {
        for (rest, line, part) in [
            ("colour = 1\n", 3, "colour"),
            ("[spec]\nn = 3\npi5 = 2\n", 5, "pi5"),
            ("[spec]\nn = 3\npi1 = \"long\"\n", 5, "pi1"),
            ("[spec]\nseed = 3\n", 4, "seed"),
            ("[spec]\nstart = { kind = \"ring\" }\n", 4, "ring"),
            (
                "[[grid]]\nn = 3\n[[grid]]\nn = 4\n\nspeed = [1, 2]\n",
                8,
                "speed",
            ),
            ("[[grid]]\nn = [3,\n \"x\"]\n", 4, "n: "),
            (
                "[[grid]]\nn = 3\ncontacts = [\"endpoint\"]\n",
                5,
                "endpoint",
            ),
            ("[[grid]]\nn = []\n", 4, "no value"),
            ("[[grid]]\nn = 3\nreplicates = 0\n", 5, "replicates = 0"),
            ("[measure]\norder_each = 3\n", 4, "order_each"),
            ("[measure]\norder_every = 0\n", 4, "order_every = 0"),
            ("replicates = -1\n", 3, "-1"),
            ("seed = 9007199254740992\n", 3, "seed = 9007199254740992"),
            ("[spec\n", 3, ""),
            ("[spec]\nn = 10.5\n", 4, "10.5`: give a whole number"),
            ("[[grid]]\nn = [10.5]\n", 4, "10.5`: give a whole number"),
            ("replicates = 1.5\n", 3, "1.5`: give a whole number"),
            ("[spec]\nn = 3\npi1 = \"4\"\n", 5, "\"4\": give a number"),
            ("[grid]\nn = [3]\n", 3, "write [[grid]]"),
            ("[at]\ntime = 3\n", 3, "write [[at]]"),
            ("[[grid]]\npi1 = 3\n", 4, "n is given neither"),
            ("[[grid]]\nn = 3\ninformed = 4\n", 5, "more than n = 3"),
            ("[[grid]]\nn = 3\ninformed = -1\n", 5, "informed"),
            (
                "[[grid]]\nn = 3\ninformed_fraction = 0.1\n",
                5,
                "selects no individual",
            ),
            (
                "[[grid]]\nn = 3\ninformed_fraction = 1.1\n",
                5,
                "within [0, 1]",
            ),
            ("[[grid]]\nn = 3\ninformed = 1\npi2 = 0\n", 5, "pi2"),
            (
                "[[grid]]\ninformed = 1\nn = 3\ninformed_fraction = 0.5\n",
                4,
                "exclude each other",
            ),
            ("[spec]\nn = 3\nrelinearise = 2\n", 1, "relinearise"),
        ] {
            let (at, reason) = field_error(rest);
            assert!(reason.contains(part), "{rest}: {reason}");
            assert_eq!(at, line, "{rest}: {reason}");
        }
        for head in ["duration = 1", "name = \"a\"", "name = \"A\"\nduration = 1"] {
            assert!(matches!(
                Plan::parse(head),
                Err(PlanError::Field { line: 1, .. })
            ));
        }
        let unnamed = Plan::parse("name = \"\"\nduration = 1").unwrap_err();
        let unnamed = unnamed.to_string();
        assert!(
            unnamed.contains("use 1 to 64 lowercase letters"),
            "{unnamed}"
        );
        assert!(!unnamed.contains('^'), "{unnamed}");
        for duration in ["0", "-1", "nan", "inf"] {
            let text = format!("name = \"a\"\nduration = {duration}\nspec = {{ n = 3 }}");
            assert!(matches!(
                Plan::parse(&text),
                Err(PlanError::Field { line: 2, .. })
            ));
        }
    }

    #[test]
    fn excessive_sizes_are_rejected() {
        let list = (1..=1000)
            .map(|k| k.to_string())
            .collect::<Vec<_>>()
            .join(", ");
        let text = format!("[[grid]]\nn = [{list}]\npi3 = [{list}]\npi4 = [{list}]");
        match error(&text) {
            PlanError::TooManyRuns { runs } => assert_eq!(runs, 1_000_000_000),
            other => panic!("{other}"),
        }
        assert!(
            field_error("spec = { n = 1000000000 }")
                .1
                .contains("n = 1000000000")
        );
        let (_, reason) = field_error("replicates = 1000000000");
        assert!(reason.contains("replicates"), "{reason}");
        let (_, reason) = field_error("spec = { n = 2, dt = 1e-12 }");
        assert!(reason.contains("steps"), "{reason}");
        let text = "spec = { n = 2, dt = 1e-7 }\nreplicates = 20\nmeasure = { order_every = 1 }";
        match error(text) {
            PlanError::TooManyEntries { entries } => assert_eq!(entries, 2_000_000_020),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn the_parameters_of_a_run_are_checked_with_its_weights() {
        // dt (1 + h ω) <= 2 r: 0.12 is short enough only without informed individuals.
        let text = "[spec]\npi1 = 8\n[[grid]]\nn = 10\ndt = 0.12\ninformed = ";
        plan(&format!("{text}0"));
        match error(&format!("{text}[0, 1]")) {
            PlanError::Run {
                run,
                error: ChangeError::Parameters(ParametersError::StepTooLong { .. }),
            } => assert_eq!(run, "n=10 informed=1 dt=0.12 #0"),
            other => panic!("{other}"),
        }
        let start = "[spec]\nn = 2\nstart = { kind = \"given\", x = [0, 9], y = [0, 0], alpha = \
                     [0, 0] }\n";
        plan(start);
        assert!(
            field_error(&start.replace("n = 2", "n = 3"))
                .1
                .contains("n is 3")
        );
        let crossed = start.replace("[0, 9]", "[0, 0]");
        assert!(matches!(error(&crossed), PlanError::Run { .. }));
    }

    #[test]
    fn a_repeated_run_is_rejected() {
        for text in [
            "[[grid]]\nn = [3, 3.0]",
            "[[grid]]\nn = [3, 4]\n[[grid]]\nn = 4",
            "[[grid]]\nn = 4\ninformed = 0\n[[grid]]\nn = [4, 3]\ninformed = [1, 0]",
        ] {
            match error(text) {
                PlanError::Repeated { .. } => {}
                PlanError::Field { reason, .. } => assert!(reason.contains("3.0"), "{reason}"),
                other => panic!("{other}"),
            }
        }
    }

    #[test]
    fn informed_fractions_round_half_up() {
        let plan = plan("[[grid]]\nn = [10, 5]\ninformed_fraction = [0, 0.1, 0.25, 0.5, 1]");
        let counts: Vec<usize> = plan
            .runs()
            .iter()
            .map(|run| plan.point(run).informed)
            .collect();
        assert_eq!(counts, [0, 1, 3, 5, 10, 0, 1, 1, 3, 5]);
    }
}
