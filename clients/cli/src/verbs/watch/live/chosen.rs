//! The swarm that is looked at, and all that is known of it.

use std::collections::VecDeque;

use jostle_proto::{Event, OrderSample, Phase, Reply, State, Status, SwarmSummary};

use super::camera::Camera;
use super::history::{History, Point};
use crate::verbs::watch::sample_of;

/// How many events are kept.
const EVENTS: usize = 64;

/// A swarm that is looked at.
#[derive(Debug)]
pub struct Chosen {
    /// Its name.
    pub name: String,
    /// Its numbers, once they are known.
    pub numbers: Option<OrderSample>,
    /// Why it is paused or faulted.
    pub reason: Option<String>,
    /// Length over width of a body.
    pub pi1: f64,
    /// Where its bodies are.
    pub state: Option<State>,
    /// How order and drift came about.
    pub history: History,
    /// What happened to it, oldest first.
    pub events: VecDeque<Event>,
}

impl Chosen {
    /// A swarm of which nothing is known yet.
    pub fn new(name: String) -> Self {
        Chosen {
            name,
            numbers: None,
            reason: None,
            pi1: 4.0,
            state: None,
            history: History::default(),
            events: VecDeque::new(),
        }
    }

    /// Takes in a status; whether anything looks other than before.
    pub fn hear(&mut self, reply: Reply<Status>) -> bool {
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
        self.note();
        is_changed
    }

    /// Takes in a state.
    pub fn see(&mut self, state: State, camera: &mut Camera) -> bool {
        if self.state.as_ref() == Some(&state) {
            return false;
        }
        camera.see(&state);
        if let Some(numbers) = &mut self.numbers {
            numbers.epoch = state.epoch;
            (numbers.step, numbers.time) = (state.step, state.time);
            numbers.phase = state.phase;
            numbers.n = state.id.len() as u64;
            numbers.informed = state.weight.iter().filter(|weight| **weight > 0.0).count() as u64;
            (numbers.order, numbers.certificate) = (state.order, state.certificate);
            self.note();
        }
        self.state = Some(state);
        true
    }

    /// Takes in what a list says: how fast it is, no state tells.
    pub fn glance(&mut self, summary: &SwarmSummary) -> bool {
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

    /// Takes in an event.
    pub fn happened(&mut self, event: Event) {
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// Writes down how ordered it is.
    fn note(&mut self) {
        if let Some(numbers) = &self.numbers {
            let point = Point {
                time: numbers.time,
                order: numbers.order.order,
                drift: numbers.order.drift,
            };
            self.history.add(numbers.epoch, point);
        }
    }
}
