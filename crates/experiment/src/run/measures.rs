//! Measurements of a run, and its row in the table of results.

use jostle_convert::hexadecimal;
use jostle_measures::View;
use jostle_physics::model::{ContactRule, State, body};
use jostle_physics::observables::Order;
use jostle_physics::observables::intervals::Intervals;
use jostle_physics::simulation::{Simulation, steps_in};
use jostle_physics::stepper::StepReport;
use jostle_proto::OccasionalColumns;
use jostle_results::table::Series;
use jostle_results::{ExtraValue, Measure, ResultRow, STOPPED_AT, rename_fault};
use serde::{Deserialize, Serialize};

use crate::plan::{Columns, Plan, PlannedRun, Point};
use crate::run::Recorder;
use crate::series::{SeriesKind, SeriesLog};

/// Measurements of a run, of the state before each step. A checkpoint contains them; the means are
/// those of its simulation.
#[derive(Clone, Default, Deserialize, Serialize)]
pub struct Measures {
    #[serde(with = "IntervalsForm")]
    intervals: Intervals,
    /// The most negative gap of two bodies so far, the largest overlap; 0 if there was none.
    worst_gap: f64,
    /// Steps that started with crossed axes.
    crossed: u64,
    worst_residual: f64,
    degraded: u64,
    fallbacks: u64,
    /// The sum and the number of values of each chosen measure.
    #[serde(default)]
    columns: Vec<(f64, u64)>,
    /// The time series that the plan has, by [`SeriesKind`].
    #[serde(default)]
    logs: [Option<SeriesLog>; 2],
}

/// The form of [`Intervals`] in a checkpoint.
#[derive(Deserialize, Serialize)]
#[serde(remote = "Intervals")]
struct IntervalsForm {
    ordered: u64,
    ordered_steps: u64,
    unordered: u64,
    unordered_steps: u64,
    last: Option<bool>,
}

impl Measures {
    pub fn new(plan: &Plan) -> Self {
        let log = |kind: SeriesKind| {
            let measures = kind.is_in(plan).then(|| kind.measures(plan).len());
            measures.map(SeriesLog::new)
        };
        Self {
            columns: vec![(0.0, 0); plan.columns.measures.len()],
            logs: SeriesKind::ALL.map(log),
            ..Self::default()
        }
    }

    /// Returns whether a checkpoint's measures are those of a plan.
    pub fn is_of(&self, plan: &Plan) -> bool {
        let is_of = |(kind, log): (SeriesKind, &Option<SeriesLog>)| match log {
            Some(log) => kind.is_in(plan) && log.is_of(kind.measures(plan).len()),
            None => !kind.is_in(plan),
        };
        self.columns.len() == plan.columns.measures.len()
            && SeriesKind::ALL.into_iter().zip(&self.logs).all(is_of)
    }

    /// The time series that the plan has.
    #[cfg(feature = "files")]
    pub fn logs(&self) -> impl Iterator<Item = (SeriesKind, &SeriesLog)> {
        let logs = SeriesKind::ALL.into_iter().zip(&self.logs);
        logs.filter_map(|(kind, log)| Some((kind, log.as_ref()?)))
    }

    /// Passes rows of the series to the recorder: those of a series that has too many in memory, or
    /// `all` of each series that is long.
    pub fn pass_rows(&mut self, recorder: &dyn Recorder, all: bool) {
        let logs = SeriesKind::ALL.into_iter().zip(&mut self.logs);
        for (kind, log) in logs {
            if let Some(log) = log
                && (log.is_full() || all && log.is_long())
            {
                log.pass_rows(kind, recorder);
            }
        }
    }

    /// Measures the chosen columns of the state before a step.
    pub fn observe(&mut self, plan: &Plan, view: &View<'_>) {
        let Columns {
            measures,
            from,
            every,
            series_every,
        } = &plan.columns;
        let state = view.state();
        let first = steps_in(*from, state.parameters.dt);
        let is_mean = state.step >= first && (state.step - first).is_multiple_of(*every);
        let is_entry = series_every.is_some_and(|every| state.step.is_multiple_of(every));
        if measures.is_empty() || !(is_mean || is_entry) {
            return;
        }
        let values = evaluate(plan, view);
        if is_mean {
            for (value, (sum, count)) in values.iter().zip(&mut self.columns) {
                if let Some(value) = value {
                    *sum += value;
                    *count += 1;
                }
            }
        }
        if is_entry {
            self.record_series(state.step, values);
        }
    }

    /// Adds the last state to the time series of the chosen measures.
    pub fn record_last(&mut self, plan: &Plan, view: &View<'_>) {
        let step = view.state().step;
        let [_, log] = &self.logs;
        if log.as_ref().is_some_and(|log| log.last() != Some(step)) {
            self.record_series(step, evaluate(plan, view));
        }
    }

    fn record_series(&mut self, step: u64, values: Vec<Option<f64>>) {
        if let [_, Some(log)] = &mut self.logs {
            // Stored text has no infinite numbers.
            let values = values.into_iter();
            let values = values.map(|value| value.filter(|value| value.is_finite()));
            log.add(step, values.map(|value| value.unwrap_or(f64::NAN)));
        }
    }

    /// Returns a time series; none if the plan does not have it, or it is long and the recorder has it.
    fn series(
        &mut self,
        kind: SeriesKind,
        (plan, run): (&Plan, &PlannedRun),
        recorder: Option<&dyn Recorder>,
    ) -> Option<Series> {
        let log = self.logs[kind as usize].as_mut()?;
        match recorder {
            Some(recorder) if log.is_long() => {
                log.pass_rows(kind, recorder);
                None
            }
            _ => Some(log.series(kind, plan, run)),
        }
    }

    /// Adds step number `count`; `order` is that of the state before it.
    pub fn add(&mut self, plan: &Plan, count: u64, order: &Order, report: &StepReport) {
        self.record(plan, count - 1, order);
        self.intervals.add(order.order);
        if let Some(gap) = report.worst_gap {
            self.worst_gap = self.worst_gap.min(gap);
        }
        self.crossed += u64::from(report.crossed > 0);
        self.worst_residual = self.worst_residual.max(report.residual);
        self.degraded += u64::from(report.degraded);
        self.fallbacks += u64::from(report.fallback > 0);
    }

    /// Adds the order at a step to its time series, if it is due. A drift that is undefined is NaN.
    fn record(&mut self, plan: &Plan, step: u64, order: &Order) {
        let is_due = |every: u64| step.is_multiple_of(every);
        if let [Some(log), _] = &mut self.logs
            && plan.order_every.is_some_and(is_due)
        {
            log.add(step, [order.order, order.drift.unwrap_or(f64::NAN)]);
        }
    }

    /// Returns the row and the time series of the order and of the chosen measures; the simulation has
    /// the last state.
    pub fn finish(
        &mut self,
        (plan, run): (&Plan, &PlannedRun),
        simulation: &Simulation,
        is_stopped: bool,
        recorder: Option<&dyn Recorder>,
    ) -> (Option<ResultRow>, [Option<Series>; 2]) {
        let (state, means) = (&simulation.state, &simulation.means);
        let State {
            parameters,
            configuration,
            step,
            ..
        } = state;
        let extra = self.extra(plan, run, is_stopped.then(|| state.time()));
        if self.logs[0].is_some() {
            self.record(plan, *step, &simulation.order());
        }
        let series = SeriesKind::ALL.map(|kind| self.series(kind, (plan, run), recorder));
        let last = body::gaps(parameters, configuration);
        let mut worst_gap = self.worst_gap.min(last.worst_gap.unwrap_or(0.0));
        if self.crossed > 0 {
            // Bodies with crossed axes overlap by a width, whatever the gaps of their contacts are.
            worst_gap = worst_gap.min(-2.0 * parameters.radius());
        }
        let taken = *step as f64;
        let time_of = |steps: u64| (steps as f64 * parameters.dt).into();
        let point = plan.point(run);
        // The row has the parameters at the start: commands may have changed them.
        let parameters = &point.spec.parameters;
        let row = means.mean_order().map(|v| ResultRow {
            run: run.name.clone(),
            seed: run.seed,
            n: point.spec.n as u64,
            pi1: parameters.pi1,
            pi2: parameters.pi2,
            pi3: parameters.pi3,
            pi4: parameters.pi4,
            informed: point.informed as u64,
            contacts: match parameters.contacts {
                ContactRule::Endpoints => "endpoints",
                ContactRule::Closest => "closest",
                ContactRule::Clamped => "clamped",
            }
            .to_owned(),
            dt: parameters.dt,
            time: state.time(),
            measures: vec![
                (Measure::V, v.into()),
                (Measure::V_PD, means.mean_drift().into()),
                (Measure::ORDERED_INTERVALS, self.intervals.ordered.into()),
                (Measure::ORDERED_TIME, time_of(self.intervals.ordered_steps)),
                (
                    Measure::UNORDERED_INTERVALS,
                    self.intervals.unordered.into(),
                ),
                (
                    Measure::UNORDERED_TIME,
                    time_of(self.intervals.unordered_steps),
                ),
                (Measure::WORST_OVERLAP, (0.0 - worst_gap).into()),
                (Measure::CROSSED_SHARE, (self.crossed as f64 / taken).into()),
                (Measure::WORST_RESIDUAL, self.worst_residual.into()),
                (Measure::DEGRADED, self.degraded.into()),
                (Measure::FALLBACKS, self.fallbacks.into()),
            ],
            steps: *step,
            state_hash: hexadecimal(&state.hash()),
            extra,
            fault: None,
        });
        (row, series)
    }

    /// Returns the columns that only some experiments have: variables, the time at which `[stop]`
    /// ended the run, and the means of chosen measures.
    fn extra(&self, plan: &Plan, run: &PlannedRun, stopped_at: Option<f64>) -> Vec<ExtraValue> {
        let Point {
            variables,
            protocol,
            ..
        } = plan.point(run);
        let names = variables.0.iter().map(|(name, _)| name);
        let mut values: Vec<(String, Option<f64>)> = names
            .map(|name| (name.clone(), variables.number(name)))
            .collect();
        if protocol.as_ref().is_some_and(|it| it.stop.is_some()) {
            values.push((STOPPED_AT.to_owned(), stopped_at));
        }
        for (measure, &(sum, count)) in plan.columns.measures.iter().zip(&self.columns) {
            let mean = (count > 0).then(|| sum / count as f64);
            values.push((measure.to_string(), mean));
        }
        let values = values.into_iter();
        let mut extra: Vec<ExtraValue> = values
            .map(|(name, value)| ExtraValue { name, value })
            .collect();
        rename_fault(&mut extra);
        extra
    }
}

impl Plan {
    /// Returns the columns that the tables of this experiment have, and not those of all.
    #[must_use]
    pub fn occasional_columns(&self) -> OccasionalColumns {
        let mut varied: Vec<String> = Vec::new();
        for run in self.runs() {
            let values = run.name.split(' ').filter_map(|it| it.split_once('='));
            for (name, _) in values {
                if !varied.iter().any(|it| it == name) {
                    varied.push(name.to_owned());
                }
            }
        }
        let series = SeriesKind::Measures;
        OccasionalColumns {
            varied,
            extra: self.extra_columns(),
            series: match series.is_in(self) {
                true => series.measures(self),
                false => Vec::new(),
            },
        }
    }

    /// Returns the names of the columns that only some experiments have, in the order of the table.
    pub fn extra_columns(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let nothing_measured = Measures::new(self);
        for run in self.runs() {
            let extra = nothing_measured.extra(self, run, None).into_iter();
            for name in extra.map(|it| it.name) {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
        }
        names
    }
}

/// Returns the values of the chosen measures.
fn evaluate(plan: &Plan, view: &View<'_>) -> Vec<Option<f64>> {
    let measures = plan.columns.measures.iter();
    measures.map(|measure| measure.evaluate(view)).collect()
}
