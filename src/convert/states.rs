//! States of swarms: what is published, and the replies to queries of a state.

use std::time::SystemTime;

use jostle_convert::hexadecimal;
use jostle_convert::parameters::values;
use jostle_proto as proto;

use crate::convert::controllers::waiting_for;
use crate::convert::durable::earlier_model;
use crate::swarm::awaited::{WaitSummary, WatchAction, WatchStatus};
use crate::swarm::fault::Fault;
use crate::swarm::frame::{Frame, Replay, Summary};
use crate::swarm::handle::Record;
use crate::swarm::phase::Phase;
use crate::swarm::registry::Limits;
use crate::swarm::sender::OriginKind;

/// Returns the state that is published as number `frame`.
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

/// Returns what is attached to a state that is published at this time, or recorded without being
/// published.
pub fn attachment(seen: &Frame, published: Option<SystemTime>) -> proto::Attachment {
    proto::Attachment {
        stepped_unix_nanos: seen.stepped.and_then(proto::unix_nanos),
        published_unix_nanos: published.and_then(proto::unix_nanos),
        sequences: seen.sequences.clone(),
    }
}

/// Returns the order that is published with state number `frame`.
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
        measures: (!seen.measures.is_empty()).then(|| seen.values().clone()),
    }
}

/// Returns the status of a swarm without what its record has; `history_from` is the start of its history, if
/// known.
pub fn status(seen: &Frame, history_from: Option<proto::HistoryFrom>) -> proto::Status {
    proto::Status {
        reason: seen.stamp.phase.reason(),
        fault: seen.fault.as_ref().map(fault),
        swarm_id: None,
        origin: None,
        earlier_models: seen.earlier_models.iter().map(earlier_model).collect(),
        protected: seen.is_protected,
        until_step: seen.stamp.phase.until(),
        rate: seen.rate,
        real_time_factor: seen.real_time_factor,
        behind_rate: seen.is_behind,
        published_hz: seen.published_hz,
        n: seen.configuration.n() as u64,
        informed: informed(seen),
        seed: seen.seed,
        dt: seen.parameters.dt,
        parameters: present(seen),
        scheduled: seen.scheduled as u64,
        when: (!seen.conditions.is_empty()).then(|| {
            seen.conditions
                .iter()
                .map(|it| it.summary.condition.clone())
                .collect()
        }),
        conditions: seen.conditions.iter().map(condition).collect(),
        waits: seen.waits.iter().map(wait).collect(),
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

fn condition(status: &WatchStatus) -> proto::WaitingCondition {
    let waiting = &status.summary;
    proto::WaitingCondition {
        id: waiting.id.clone(),
        condition: waiting.condition.clone(),
        action: match waiting.action {
            WatchAction::Pause => proto::WaitingAction::Pause,
            WatchAction::Commands => proto::WaitingAction::Commands,
            WatchAction::Event => proto::WaitingAction::Event,
        },
        event: waiting.event.as_deref().map(str::to_owned),
        client: waiting.client.clone(),
        evaluated: status.is_evaluated,
    }
}

fn wait(waiting: &WaitSummary) -> proto::WaitingClient {
    proto::WaitingClient {
        condition: waiting.condition.clone(),
        user: waiting.user.as_deref().map(str::to_owned),
    }
}

fn fault(fault: &Fault) -> proto::Fault {
    proto::Fault {
        kind: fault.kind.name().to_owned(),
        ids: fault.ids.clone(),
        gap: fault.gap,
    }
}

/// Returns what a swarm was made from.
pub fn origin(record: &Record) -> Option<proto::Origin> {
    let origin = record.creation.as_ref()?.origin.as_ref()?;
    Some(proto::Origin {
        kind: match origin.kind {
            OriginKind::Fork => proto::OriginKind::Fork,
            OriginKind::Restore => proto::OriginKind::Restore,
            OriginKind::Play => proto::OriginKind::Play,
        },
        swarm: origin.swarm.clone(),
        swarm_id: origin.swarm_id,
        step: origin.step,
        seq: origin.seq,
        state_hash: origin.state_hash.map(|hash| hexadecimal(&hash)),
    })
}

pub fn summary(swarm: &str, record: &Record, summary: &Summary) -> proto::SwarmSummary {
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
        earlier_models: summary.earlier_models.iter().map(earlier_model).collect(),
        protected: summary.is_protected,
        swarm_id: record.swarm_id.get().copied(),
        origin: origin(record),
        contested_by: None,
    }
}

pub fn replay(replay: &Replay) -> proto::Replay {
    proto::Replay {
        of: replay.of.to_string(),
        frame: replay.frame,
        frames: replay.frames,
        position: replay.position,
        duration: replay.duration,
    }
}

/// Returns the present values of the parameters that commands change.
pub fn present(seen: &Frame) -> proto::ParameterValues {
    values(
        seen.parameters,
        seen.publish_every,
        &seen.measures,
        seen.max_idle_secs,
    )
}

/// Returns the parameters with their current values and bounds.
pub fn parameters(seen: &Frame, limits: Limits) -> proto::Parameters {
    let mut parameters = proto::contract::parameters();
    let now = seen.parameters;
    // All numbers are finite and all keys are strings, so this cannot fail.
    let values = serde_json::to_value(present(seen)).expect("parameters are JSON");
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
            "seed" => parameter.value = seen.seed.into(),
            "rate" => parameter.value = seen.rate.into(),
            name => {
                if let Some(value) = values.get(name) {
                    parameter.value = value.clone();
                }
            }
        }
        if let (Some(usual), Some(maximum)) = (parameter.usual, parameter.maximum) {
            let to = usual.to.min(maximum);
            // A limit below all of them leaves none.
            parameter.usual = (usual.from < to).then_some(proto::Usual { to, ..usual });
        }
    }
    proto::Parameters { parameters }
}

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

pub(crate) fn phase(phase: &Phase) -> proto::Phase {
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
        direction_strength: seen.order.strength,
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

pub(super) fn hash(seen: &Frame) -> String {
    hexadecimal(&seen.hash.unwrap_or_default())
}
