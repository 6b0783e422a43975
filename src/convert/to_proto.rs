//! What clients are sent.

use jostle_convert::change::{changed, ids_result, set_result};
use jostle_convert::hexadecimal;
use jostle_convert::spec::{self, parameter_values};
use jostle_physics::simulation::{ChangeOutcome, Spec};
use jostle_proto as proto;
use jostle_proto::verbs::{
    self, AdvanceResult, BatchResult, CreateResult, EmptyResult, JoinResult, ResetResult,
    RunResult, Scheduled, StepResult,
};
use serde::Serialize;

use crate::convert::durable::snapshot;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Event, EventKind, Frame, Replay, Stamp, Summary};
use crate::swarm::history::{Entry, Page};
use crate::swarm::membership::{Departure, Mode, News, OnTimeout};
use crate::swarm::outcome::Outcome;
use crate::swarm::phase::Phase;
use crate::swarm::registry::Limits;
use crate::swarm::sender::Sender;

/// Most messages are no longer.
const USUAL_BYTES: usize = 512;

/// A reply that takes more bytes is remembered without its state.
const MAX_REMEMBERED_BYTES: usize = 4096;

/// The reply of `swarm` at `place`.
pub fn reply<T>(swarm: &str, stamp: &Stamp, result: T) -> proto::Reply<T> {
    proto::Reply {
        swarm: swarm.to_owned(),
        epoch: stamp.epoch,
        step: stamp.step,
        time: stamp.time,
        phase: phase(&stamp.phase),
        seq: stamp.seq,
        result,
    }
}

/// An encoded payload.
#[derive(Clone, Debug)]
pub struct Payload {
    /// The bytes.
    pub bytes: Vec<u8>,
    /// What they are: [`proto::JSON`] or [`proto::CBOR`].
    pub encoding: &'static str,
    /// The JSON that a retry of the request gets in their place, where they are too large to be
    /// remembered.
    pub to_remember: Option<Vec<u8>>,
}

impl Payload {
    /// A message as JSON.
    pub fn json<T: Serialize>(message: &T) -> Self {
        let mut bytes = Vec::with_capacity(USUAL_BYTES);
        // All numbers are finite and all keys strings, so nothing can fail.
        serde_json::to_writer(&mut bytes, message).expect("messages are JSON");
        Payload {
            bytes,
            encoding: proto::JSON,
            to_remember: None,
        }
    }

    /// A message as CBOR.
    pub fn cbor<T: Serialize>(message: &T) -> Self {
        Payload {
            bytes: proto::to_cbor(message),
            encoding: proto::CBOR,
            to_remember: None,
        }
    }

    /// A reply whose state is left out of what is remembered when it is large.
    fn with_state<T: Serialize>(
        mut reply: proto::Reply<T>,
        leave_out: impl FnOnce(&mut T),
    ) -> Self {
        let mut payload = Payload::cbor(&reply);
        if payload.bytes.len() > MAX_REMEMBERED_BYTES {
            leave_out(&mut reply.result);
            payload.to_remember = Some(Payload::json(&reply).bytes);
        }
        payload
    }

    /// What is remembered of it, to be sent again.
    pub fn remembered(&self) -> Payload {
        match &self.to_remember {
            Some(bytes) => Payload {
                bytes: bytes.clone(),
                encoding: proto::JSON,
                to_remember: None,
            },
            None => self.clone(),
        }
    }
}

/// The reply to a command that came to `outcome`. With a `frame` number the state goes along, in
/// CBOR.
pub fn outcome(swarm: &str, stamp: &Stamp, outcome: Outcome, frame: Option<u64>) -> Payload {
    match outcome {
        Outcome::Done => Payload::json(&reply(swarm, stamp, EmptyResult {})),
        Outcome::Runs(until_step, rate) => {
            Payload::json(&reply(swarm, stamp, RunResult { until_step, rate }))
        }
        Outcome::Stepped {
            steps,
            durable_step,
            frame: seen,
        } => {
            let state = frame.map(|frame| state(swarm, &seen, frame));
            let result = StepResult {
                steps,
                durable_step,
                state_hash: hash(&seen),
                state,
            };
            let reply = reply(swarm, stamp, result);
            match frame {
                Some(_) => Payload::with_state(reply, |result| result.state = None),
                None => Payload::json(&reply),
            }
        }
        Outcome::Joined { ids, news: told } => {
            let news = news(told);
            Payload::json(&reply(swarm, stamp, JoinResult { ids, news }))
        }
        Outcome::Advanced {
            steps,
            durable_step,
            frame: seen,
            news: told,
        } => {
            let state = frame.map(|frame| state(swarm, &seen, frame));
            let result = AdvanceResult {
                steps,
                durable_step,
                state_hash: hash(&seen),
                news: news(told),
                state,
            };
            let reply = reply(swarm, stamp, result);
            match frame {
                Some(_) => Payload::with_state(reply, |result| result.state = None),
                None => Payload::json(&reply),
            }
        }
        Outcome::Reset(seen) => {
            let result = ResetResult {
                seed: seen.seed,
                state_hash: hash(&seen),
            };
            Payload::json(&reply(swarm, stamp, result))
        }
        Outcome::Changed(ChangeOutcome::Set {
            before,
            now,
            scaled_by,
        }) => Payload::json(&reply(swarm, stamp, set_result(before, now, scaled_by))),
        Outcome::Changed(ChangeOutcome::Ids { ids, n }) => {
            Payload::json(&reply(swarm, stamp, ids_result(ids, n)))
        }
        Outcome::Batch(outcomes) => {
            let results = outcomes.into_iter();
            let results = results
                .map(|(kind, outcome)| changed(kind, outcome))
                .collect();
            Payload::json(&reply(swarm, stamp, BatchResult { results }))
        }
        Outcome::Scheduled(applies_at_step) => {
            Payload::json(&reply(swarm, stamp, Scheduled { applies_at_step }))
        }
        Outcome::Checkpoint(whole) => {
            Payload::cbor(&reply(swarm, stamp, snapshot(swarm, &whole).sealed()))
        }
        Outcome::State(seen) => Payload::json(&reply(swarm, stamp, status(&seen, None))),
    }
}

/// The reply to `create`.
pub fn created(swarm: &str, stamp: &Stamp, recipe: &Spec, seen: &Frame, is_new: bool) -> Payload {
    let result = CreateResult {
        created: is_new,
        spec: spec::to_proto(recipe, seen.seed),
        state_hash: hash(seen),
    };
    Payload::json(&reply(swarm, stamp, result))
}

pub(super) fn mode(mode: Mode) -> verbs::Mode {
    match mode {
        Mode::Lockstep => verbs::Mode::Lockstep,
        Mode::FreeRunning => verbs::Mode::FreeRunning,
    }
}

pub(super) fn on_timeout(on_timeout: OnTimeout) -> verbs::OnTimeout {
    match on_timeout {
        OnTimeout::Hold => verbs::OnTimeout::Hold,
        OnTimeout::Free => verbs::OnTimeout::Free,
        OnTimeout::Pause => verbs::OnTimeout::Pause,
    }
}

pub(super) fn news(news: News) -> verbs::News {
    let missed = news.missed.into_iter().map(|miss| verbs::Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news
        .left
        .into_iter()
        .map(|(controller, why)| verbs::Departed {
            controller,
            why: match why {
                Departure::Left => verbs::Departure::Left,
                Departure::Lost => verbs::Departure::Lost,
                Departure::Late => verbs::Departure::Late,
            },
        });
    verbs::News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

/// Every controller that has joined.
pub fn controllers(seen: &Frame) -> proto::ControllerList {
    let controllers = seen.controllers.iter().map(|it| proto::Controller {
        controller: it.controller.clone(),
        mode: mode(it.mode),
        ids: it.ids.clone(),
        deadline_secs: it.deadline.as_secs_f64(),
        on_timeout: on_timeout(it.on_timeout),
        driving: it.driving,
        target_step: it.target,
        misses: it.misses,
        waited_secs: it.waited.map(|waited| waited.as_secs_f64()),
        puts: proto::Puts {
            applied: it.puts.applied,
            stale: it.puts.stale,
            overtaken: it.puts.overtaken,
            refused: it.puts.rejected,
        },
    });
    proto::ControllerList {
        controllers: controllers.collect(),
    }
}

/// The controllers that the swarm waits for.
fn waiting_for(seen: &Frame) -> Vec<proto::Awaited> {
    let awaited = seen.controllers.iter().filter_map(|it| {
        Some(proto::Awaited {
            controller: it.controller.clone(),
            secs: it.waited?.as_secs_f64(),
            deadline_secs: it.deadline.as_secs_f64(),
        })
    });
    awaited.collect()
}

/// A swarm's status, with where its history begins.
pub fn status(seen: &Frame, history_from: Option<proto::HistoryFrom>) -> proto::Status {
    proto::Status {
        reason: seen.stamp.phase.reason(),
        until_step: seen.stamp.phase.until(),
        rate: seen.rate,
        real_time_factor: seen.real_time_factor,
        n: seen.configuration.n() as u64,
        informed: informed(seen),
        seed: seen.seed,
        dt: seen.parameters.dt,
        parameters: parameter_values(seen.parameters, seen.publish_every),
        scheduled: seen.scheduled as u64,
        controllers: seen.controllers.len() as u64,
        waiting_for: waiting_for(seen),
        state_hash: hash(seen),
        order: order(seen),
        certificate: certificate(seen),
        history_from,
        replay: seen.replay.as_ref().map(replay),
        verifying: None,
    }
}

/// Where a recording is.
pub fn replay(replay: &Replay) -> proto::Replay {
    proto::Replay {
        of: replay.of.to_string(),
        frame: replay.frame,
        frames: replay.frames,
        position: replay.position,
        duration: replay.duration,
    }
}

/// A state as it is published for the `frame`th time.
pub fn state(swarm: &str, seen: &Frame, frame: u64) -> proto::State {
    let configuration = &seen.configuration;
    proto::State {
        swarm: swarm.to_owned(),
        epoch: seen.stamp.epoch,
        frame,
        step: seen.stamp.step,
        time: seen.stamp.time,
        phase: phase(&seen.stamp.phase),
        origin: configuration.origin,
        id: configuration.id.clone(),
        x: configuration.x.clone(),
        y: configuration.y.clone(),
        alpha: configuration.alpha.clone(),
        weight: configuration.weight.clone(),
        direction: configuration.direction.clone(),
        order: order(seen),
        certificate: certificate(seen),
    }
}

/// An order as it is published with the `frame`th state.
pub fn order_sample(swarm: &str, seen: &Frame, frame: u64) -> proto::OrderSample {
    proto::OrderSample {
        swarm: swarm.to_owned(),
        epoch: seen.stamp.epoch,
        frame,
        step: seen.stamp.step,
        time: seen.stamp.time,
        phase: phase(&seen.stamp.phase),
        n: seen.configuration.n() as u64,
        informed: informed(seen),
        order: order(seen),
        certificate: certificate(seen),
        rate: seen.rate,
        real_time_factor: seen.real_time_factor,
    }
}

/// Words why an order was refused, for a swarm at a step.
pub type WordRefusal = fn(SwarmError, u64) -> proto::Error;

/// An event as it is published.
pub fn event(swarm: &str, event: Event, word: WordRefusal) -> proto::Event {
    let Event {
        number,
        stamp,
        unix_secs,
        kind,
    } = event;
    proto::Event {
        swarm: swarm.to_owned(),
        number,
        epoch: stamp.epoch,
        step: stamp.step,
        time: stamp.time,
        phase: phase(&stamp.phase),
        unix_secs,
        event: match kind {
            EventKind::Created => proto::EventKind::Created {},
            EventKind::Phase => proto::EventKind::Phase {
                reason: stamp.phase.reason(),
            },
            EventKind::Command(sender) => proto::EventKind::Command {
                seq: stamp.seq,
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
            },
            EventKind::Scheduled(applies_at_step, sender) => proto::EventKind::Scheduled {
                applies_at_step,
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
            },
            EventKind::Rejected(sender, error) => proto::EventKind::Refused {
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
                error: word(error, stamp.step),
            },
            EventKind::Lapsed(ids) => proto::EventKind::Lapsed { ids },
            EventKind::Fault(reason) => proto::EventKind::Fault { reason },
            EventKind::RecordingFailed(recording, reason) => proto::EventKind::RecordingFailed {
                recording: recording.to_string(),
                reason: reason.to_string(),
            },
            // It was one when it was recorded.
            EventKind::Recorded(what) => {
                serde_json::from_str(&what).unwrap_or(proto::EventKind::Phase { reason: None })
            }
            EventKind::Deleted => proto::EventKind::Deleted {},
        },
    }
}

/// Events as they are asked for.
pub fn events(swarm: &str, page: Page<Event>, word: WordRefusal) -> proto::Events {
    let events = page.records.into_iter();
    proto::Events {
        events: events.map(|it| event(swarm, it, word)).collect(),
        oldest: page.oldest,
        newest: page.newest,
    }
}

/// Applied commands as they are asked for.
pub fn journal(page: Page<Entry>) -> proto::Journal {
    let entries = page.records.into_iter().map(|entry| {
        let Entry {
            stamp,
            unix_secs,
            sender,
        } = entry;
        proto::JournalEntry {
            seq: stamp.seq,
            epoch: stamp.epoch,
            step: stamp.step,
            time: stamp.time,
            unix_secs,
            verb: sender.verb.to_owned(),
            args: args(&sender),
            client: sender.client.clone(),
            request_id: sender.request_id.clone(),
        }
    });
    proto::Journal {
        entries: entries.collect(),
        oldest: page.oldest,
        newest: page.newest,
    }
}

/// Every parameter, with the values and bounds that hold for this swarm now.
pub fn parameters(seen: &Frame, limits: Limits) -> proto::Parameters {
    let mut parameters = proto::contract::parameters();
    let now = seen.parameters;
    for parameter in &mut parameters {
        match parameter.name.as_str() {
            "n" => {
                parameter.value = seen.configuration.n().into();
                parameter.maximum = Some(limits.max_individuals as f64);
            }
            "dt" => {
                let largest = seen.configuration.largest_weight();
                parameter.value = now.dt.into();
                parameter.maximum = Some(now.longest_step(largest));
            }
            "pi1" => parameter.value = now.pi1.into(),
            "pi2" => parameter.value = now.pi2.into(),
            "pi3" => parameter.value = now.pi3.into(),
            "pi4" => parameter.value = now.pi4.into(),
            "seed" => parameter.value = seen.seed.into(),
            "publish_every" => parameter.value = seen.publish_every.into(),
            "rate" => parameter.value = seen.rate.into(),
            "contacts" => parameter.value = value(&spec::contact_rule_to_proto(now.contacts)),
            "stepping" => parameter.value = value(&spec::stepping_to_proto(now.stepping)),
            "relinearise" => parameter.value = u8::from(now.relinearise).into(),
            "attraction" => parameter.value = value(&spec::attraction_to_proto(now.attraction)),
            "noise" => parameter.value = now.noise.into(),
            _ => {}
        }
    }
    proto::Parameters { parameters }
}

fn value<T: Serialize>(choice: &T) -> serde_json::Value {
    // All numbers are finite and all keys strings, so nothing can fail.
    serde_json::to_value(choice).expect("choices are JSON")
}

/// A sender's arguments. They were read once, so they are JSON.
fn args(sender: &Sender) -> serde_json::Value {
    serde_json::from_str(&sender.args).unwrap_or_default()
}

/// A swarm in a list.
pub fn summary(swarm: &str, summary: &Summary) -> proto::SwarmSummary {
    proto::SwarmSummary {
        swarm: swarm.to_owned(),
        phase: phase(&summary.stamp.phase),
        reason: summary.stamp.phase.reason(),
        step: summary.stamp.step,
        time: summary.stamp.time,
        n: summary.n as u64,
        informed: summary.informed as u64,
        order: summary.order,
        rate: summary.rate,
        real_time_factor: summary.real_time_factor,
        replay: summary.is_replay,
        contested_by: None,
    }
}

/// What a daemon refuses to go beyond.
pub fn limits(limits: Limits, max_clients: usize, max_message_bytes: u64) -> proto::Limits {
    proto::Limits {
        max_individuals: limits.max_individuals as u64,
        max_swarms: limits.max_swarms as u64,
        max_memory_bytes: limits.max_memory_bytes,
        max_message_bytes,
        max_clients: max_clients as u64,
        max_hz: u64::from(limits.max_hz),
    }
}

pub(super) fn phase(phase: &Phase) -> proto::Phase {
    match phase {
        Phase::Paused(_) => proto::Phase::Paused,
        Phase::Running { .. } | Phase::Stepping { .. } => proto::Phase::Running,
        Phase::Faulted(_) => proto::Phase::Faulted,
    }
}

fn order(seen: &Frame) -> proto::Order {
    proto::Order {
        order: seen.order.order,
        mean_order: seen.means.mean_order(),
        velocity: seen.order.velocity,
        mean_velocity: seen.means.mean_velocity(),
        direction: seen.order.direction,
        drift: seen.order.drift,
        mean_drift: seen.means.mean_drift(),
    }
}

fn certificate(seen: &Frame) -> proto::Certificate {
    let gaps = seen.gaps();
    proto::Certificate {
        worst_gap: gaps.worst_gap,
        residual: seen.exactness.residual,
        degraded: seen.exactness.degraded,
        crossed: gaps.crossed as u64,
        contacts: seen.exactness.contacts as u64,
        iterations: seen.exactness.iterations as u64,
    }
}

fn informed(seen: &Frame) -> u64 {
    let weights = &seen.configuration.weight;
    weights.iter().filter(|weight| **weight > 0.0).count() as u64
}

fn hash(seen: &Frame) -> String {
    hexadecimal(&seen.hash.unwrap_or_default())
}
