//! Measurements of a run, and its row in the table of results.

use jostle_convert::hexadecimal;
use jostle_physics::model::{ContactRule, State, body};
use jostle_physics::observables::intervals::Intervals;
use jostle_physics::observables::{self, CommonDirection, Order, RunningMeans};
use jostle_physics::stepper::StepReport;
use jostle_results::table::OrderSeries;
use jostle_results::{Measure, ResultRow};
use serde::{Deserialize, Serialize};

use crate::plan::{Plan, PlannedRun};

/// Measurements of a run, of the state before each step. A checkpoint contains them, except for the
/// means, which are those of its snapshot.
#[derive(Clone, Default, Deserialize, Serialize)]
pub struct Measures {
    /// The common direction of the informed individuals.
    #[serde(skip)]
    common_direction: Option<CommonDirection>,
    #[serde(skip)]
    pub means: RunningMeans,
    #[serde(with = "IntervalsForm")]
    intervals: Intervals,
    /// The most negative gap of two bodies so far, the largest overlap; 0 if there was none.
    worst_gap: f64,
    /// Steps that started with crossed axes.
    crossed: u64,
    worst_residual: f64,
    degraded: u64,
    fallbacks: u64,
    order_every: Option<u64>,
    orders: Vec<f64>,
    drifts: Vec<f64>,
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
    pub fn new(plan: &Plan, state: &State) -> Self {
        Self {
            order_every: plan.order_every,
            ..Self::default().of(state)
        }
    }

    /// Sets `common_direction`, which checkpoints omit: the set of informed individuals does not
    /// change during a run.
    fn of(mut self, state: &State) -> Self {
        self.common_direction = observables::common_direction(&state.configuration);
        self
    }

    /// Returns the measures of a checkpoint, whose snapshot has this state and these means.
    pub fn restored(mut self, state: &State, means: RunningMeans) -> Self {
        self.means = means;
        self.of(state)
    }

    /// Adds a step; `headings` are the n unit vectors before it.
    pub fn add(&mut self, headings: &[[f64; 2]], report: &StepReport) {
        let order = observables::order_of(headings.iter().copied(), self.common_direction);
        if self
            .order_every
            .is_some_and(|every| self.means.count.is_multiple_of(every))
        {
            self.record(&order);
        }
        self.means.add(&order);
        self.intervals.add(order.order);
        if let Some(gap) = report.worst_gap {
            self.worst_gap = self.worst_gap.min(gap);
        }
        self.crossed += u64::from(report.crossed > 0);
        self.worst_residual = self.worst_residual.max(report.residual);
        self.degraded += u64::from(report.degraded);
        self.fallbacks += u64::from(report.fallback > 0);
    }

    /// Adds an entry to the time series.
    fn record(&mut self, order: &Order) {
        self.orders.push(order.order);
        self.drifts.extend(order.drift);
    }

    /// Returns the row and the time series; `state` is the last state.
    pub fn finish(
        mut self,
        plan: &Plan,
        run: &PlannedRun,
        state: &State,
    ) -> (Option<ResultRow>, Option<OrderSeries>) {
        let State {
            parameters,
            configuration,
            step,
            ..
        } = state;
        let series = self.order_every.map(|every| {
            if step.is_multiple_of(every) {
                self.record(&observables::order(configuration));
            }
            let steps: Vec<u64> = (0..self.orders.len() as u64)
                .map(|entry| entry * every)
                .collect();
            OrderSeries {
                run: run.name.clone(),
                times: steps
                    .iter()
                    .map(|&step| step as f64 * parameters.dt)
                    .collect(),
                steps,
                orders: std::mem::take(&mut self.orders),
                drifts: std::mem::take(&mut self.drifts),
            }
        });
        let last = body::gaps(parameters, configuration);
        let mut worst_gap = self.worst_gap.min(last.worst_gap.unwrap_or(0.0));
        if self.crossed > 0 {
            // Bodies with crossed axes overlap by a width, whatever the gaps of their contacts are.
            worst_gap = worst_gap.min(-2.0 * parameters.radius());
        }
        let taken = *step as f64;
        let time_of = |steps: u64| (steps as f64 * parameters.dt).into();
        let row = self.means.mean_order().map(|v| ResultRow {
            run: run.name.clone(),
            seed: run.seed,
            n: configuration.n() as u64,
            pi1: parameters.pi1,
            pi2: parameters.pi2,
            pi3: parameters.pi3,
            pi4: parameters.pi4,
            informed: plan.point(run).informed as u64,
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
                (Measure::V_PD, self.means.mean_drift().into()),
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
        });
        (row, series)
    }
}
