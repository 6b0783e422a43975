//! Replies to commands.

use jostle_convert::change::{changed, ids_result, set_result};
use jostle_convert::spec::to_proto as spec_to_proto;
use jostle_physics::simulation::{ChangeOutcome, Spec};
use jostle_proto as proto;
use jostle_proto::verbs::{
    AdvanceResult, BatchResult, CreateResult, EmptyResult, JoinResult, ResetResult, RunResult,
    Scheduled, SetResult, StepResult, WhenResult,
};
use serde::Serialize;

use crate::convert::controllers;
use crate::convert::durable::snapshot;
use crate::convert::payload::Payload;
use crate::convert::states::{hash, phase, state, status};
use crate::swarm::frame::{Frame, Stamp};
use crate::swarm::handle::Outcome;

/// Returns the reply of `swarm` at `stamp`.
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

/// Encodes the reply to an executed command. With a `frame` number it contains the state and is
/// CBOR.
pub fn outcome(swarm: &str, stamp: &Stamp, outcome: Outcome, frame: Option<u64>) -> Payload {
    let state_of = |seen: &Frame| frame.map(|frame| state(swarm, seen, frame));
    match outcome {
        Outcome::Done => json(swarm, stamp, EmptyResult {}),
        Outcome::Waits { holds, id } => json(swarm, stamp, WhenResult { holds, id }),
        Outcome::Runs(until_step, rate) => json(swarm, stamp, RunResult { until_step, rate }),
        Outcome::Stepped {
            steps,
            durable_step,
            frame: seen,
        } => {
            let result = StepResult {
                steps,
                durable_step,
                state_hash: hash(&seen),
                state: state_of(&seen),
            };
            match result.state {
                None => json(swarm, stamp, result),
                Some(_) => Payload::with_state(reply(swarm, stamp, result), |it| it.state = None),
            }
        }
        Outcome::Joined { ids, news } => {
            let news = controllers::news_to_proto(news);
            json(swarm, stamp, JoinResult { ids, news })
        }
        Outcome::Advanced {
            steps,
            durable_step,
            frame: seen,
            news,
        } => {
            let result = AdvanceResult {
                steps,
                durable_step,
                state_hash: hash(&seen),
                news: controllers::news_to_proto(news),
                state: state_of(&seen),
            };
            match result.state {
                None => json(swarm, stamp, result),
                Some(_) => Payload::with_state(reply(swarm, stamp, result), |it| it.state = None),
            }
        }
        Outcome::Reset(seen) => {
            let (seed, state_hash) = (seen.seed, hash(&seen));
            json(swarm, stamp, ResetResult { seed, state_hash })
        }
        Outcome::Changed(
            ChangeOutcome::Set {
                before,
                now,
                scaled_by,
            },
            published_hz,
        ) => {
            let result = SetResult {
                published_hz: Some(published_hz),
                ..set_result(&before, &now, scaled_by)
            };
            json(swarm, stamp, result)
        }
        Outcome::Changed(ChangeOutcome::Ids { ids, n }, _) => {
            json(swarm, stamp, ids_result(ids, n))
        }
        Outcome::Batch(outcomes) => {
            let results = outcomes.into_iter();
            let results = results
                .map(|(kind, outcome)| changed(kind, outcome))
                .collect();
            json(swarm, stamp, BatchResult { results })
        }
        Outcome::Scheduled(applies_at_step) => json(swarm, stamp, Scheduled { applies_at_step }),
        Outcome::Checkpoint(whole) => {
            Payload::cbor(&reply(swarm, stamp, snapshot(swarm, &whole).sealed()))
        }
        Outcome::State(seen) => json(swarm, stamp, status(&seen, None)),
    }
}

fn json<T: Serialize>(swarm: &str, stamp: &Stamp, result: T) -> Payload {
    Payload::json(&reply(swarm, stamp, result))
}

pub fn created(swarm: &str, stamp: &Stamp, spec: &Spec, seen: &Frame, is_new: bool) -> Payload {
    let result = CreateResult {
        created: is_new,
        spec: spec_to_proto(spec, seen.seed),
        state_hash: hash(seen),
    };
    json(swarm, stamp, result)
}
