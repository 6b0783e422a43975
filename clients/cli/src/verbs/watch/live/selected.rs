//! The selected swarm: its last status, state and events.

use std::collections::VecDeque;

use jostle_measures::Measure;
use jostle_proto::{Event, OrderSample, Phase, Reply, State, Status, SwarmSummary};

use super::camera::Camera;
use super::history::{History, Point};
use super::measured;
use crate::verbs::watch::sample_of;

/// The number of events kept.
const MAX_EVENTS: usize = 64;

#[derive(Debug)]
pub struct Selected {
    pub name: String,
    /// Its numbers, after the first status.
    pub numbers: Option<OrderSample>,
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// Length over width of a body.
    pub pi1: f64,
    /// Its last state.
    pub state: Option<State>,
    /// The chosen measure of the last state.
    pub measured: Option<f64>,
    /// Order, drift and the chosen measure over time.
    pub history: History,
    /// Its events, oldest first.
    pub events: VecDeque<Event>,
}

impl Selected {
    /// A swarm without a status yet.
    pub fn new(name: String) -> Self {
        Selected {
            name,
            numbers: None,
            reason: None,
            pi1: 4.0,
            state: None,
            measured: None,
            history: History::default(),
            events: VecDeque::new(),
        }
    }

    /// Applies a status and returns whether anything visible changed.
    pub fn set_status(&mut self, reply: Reply<Status>) -> bool {
        let is_late = |numbers: &OrderSample| {
            (reply.epoch, reply.step) < (numbers.epoch, numbers.step)
                && reply.phase == Phase::Running
        };
        self.pi1 = reply.result.parameters.pi1;
        if self.numbers.as_ref().is_some_and(is_late) {
            return false;
        }
        let reason = reply.result.reason.clone();
        let numbers = sample_of(reply, 0);
        let is_changed = self.numbers.as_ref() != Some(&numbers) || self.reason != reason;
        self.numbers = Some(numbers);
        self.reason = reason;
        self.record_order();
        is_changed
    }

    /// Applies a state and returns whether it is new.
    pub fn set_state(
        &mut self,
        state: State,
        camera: &mut Camera,
        measure: Option<Measure>,
    ) -> bool {
        if self.state.as_ref() == Some(&state) {
            return false;
        }
        camera.track(&state);
        self.measured = measure.and_then(|it| measured::evaluate(it, &state, self.pi1));
        if let Some(numbers) = &mut self.numbers {
            numbers.epoch = state.epoch;
            (numbers.step, numbers.time) = (state.step, state.time);
            numbers.phase = state.phase;
            numbers.n = state.id.len() as u64;
            numbers.informed = state.weight.iter().filter(|weight| **weight > 0.0).count() as u64;
            (numbers.order, numbers.certificate) = (state.order, state.certificate);
            self.record_order();
        }
        self.state = Some(state);
        true
    }

    /// Applies an entry of the list, which has the rate, and returns whether anything changed.
    pub fn set_summary(&mut self, summary: &SwarmSummary) -> bool {
        let Some(numbers) = &mut self.numbers else {
            return false;
        };
        let before = (numbers.phase, numbers.rate, numbers.real_time_factor);
        let reason = self.reason.clone();
        (numbers.rate, numbers.real_time_factor) = (summary.rate, summary.real_time_factor);
        if summary.step >= numbers.step {
            numbers.phase = summary.phase;
            self.reason.clone_from(&summary.reason);
        }
        let now = (numbers.phase, numbers.rate, numbers.real_time_factor);
        before != now || reason != self.reason
    }

    /// Draws another measure from now on.
    pub fn choose(&mut self, measure: Option<Measure>) {
        let (state, pi1) = (self.state.as_ref(), self.pi1);
        let value = measure.zip(state);
        self.measured = value.and_then(|(measure, state)| measured::evaluate(measure, state, pi1));
        self.history.forget_measure();
        self.record_order();
    }

    pub fn push_event(&mut self, event: Event) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// Adds the current order to the history.
    fn record_order(&mut self) {
        if let Some(numbers) = &self.numbers {
            let point = Point {
                time: numbers.time,
                order: numbers.order.order,
                drift: numbers.order.drift,
                measure: self.measured,
            };
            self.history.add(numbers.epoch, point);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn another_measure_has_none_of_the_values_of_the_one_before() {
        let mut selected = Selected::new("demo".to_owned());
        let mut camera = Camera::default();
        let [first, second] = ["radius_of_gyration", "milling"].map(|it| it.parse().ok());
        selected.set_status(fixtures::status());
        let mut state = fixtures::state();
        for _ in 0..3 {
            state.step += 50;
            state.time += 1.0;
            selected.set_state(state.clone(), &mut camera, first);
        }
        let values = |selected: &Selected| -> Vec<Option<f64>> {
            let points = selected.history.points().iter();
            points.map(|it| it.measure).collect()
        };
        let before = values(&selected);
        assert!(before.iter().flatten().count() > 1, "{before:?}");
        selected.choose(second);
        let after = values(&selected);
        assert_eq!(after.len(), before.len());
        // That of the present state alone.
        assert!(after.iter().flatten().count() <= 1, "{after:?}");
        assert_ne!(selected.measured, before.last().copied().flatten());
        selected.choose(None);
        assert_eq!(selected.measured, None);
        assert!(values(&selected).iter().all(Option::is_none));
    }
}
