//! What a swarm writes down, as bytes: a checkpoint is a snapshot, a line a small CBOR record.

use std::sync::Arc;

use jostle_proto as proto;
use jostle_proto::snapshot::{
    Doing, Drive, Exactness, Lapse, Member, Pending, SNAPSHOT_VERSION, Sent, SolverMemory, Sums,
    Waiting,
};
use jostle_proto::{Told, keys};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::model::state::MODEL_VERSION;
use crate::model::{self, Configuration, Remembered, State};
use crate::observables::RunningMeans;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::control::{self, Membership};
use crate::swarm::frame;
use crate::swarm::journal::Record;
use crate::swarm::order::{Order, Recipe, Sender};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::schedule::Scheduled;
use crate::wire::{self, WireError, from_proto, to_proto};

/// Why bytes are not what a swarm wrote down.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DurableError {
    /// They cannot be read.
    #[error("it cannot be read: {0}")]
    Unreadable(String),
    /// Another version wrote them.
    #[error("it is of version {found} of {what}, this daemon knows {known}")]
    Version {
        /// Of what.
        what: &'static str,
        /// Theirs.
        found: u32,
        /// Ours.
        known: u32,
    },
    /// The state is not the one they name.
    #[error("its state does not have the hash that it names")]
    Hash,
    /// No swarm can be so.
    #[error("it cannot be so: {0}")]
    Impossible(String),
}

/// Reads what a command orders.
pub type ReadOrder<'a> = &'a dyn Fn(&Sender) -> Result<Order, String>;

/// A swarm as a whole.
pub fn snapshot(swarm: &str, checkpoint: &Checkpoint) -> proto::Snapshot {
    let Checkpoint {
        recipe,
        state,
        publish_every,
        epoch,
        seq,
        means,
        exactness,
        phase,
        rate,
        scheduled,
        pending,
        controllers,
        events,
        lines,
        is_last,
    } = checkpoint;
    let (configuration, remembered) = (&state.configuration, &state.memory.contacts);
    let lapses = configuration.id.iter().zip(&configuration.lapses_at);
    let drives = configuration.drives.iter().map(|(id, drive)| Drive {
        id: *id,
        turn: drive.turn,
        speed: drive.speed,
    });
    proto::Snapshot {
        version: SNAPSHOT_VERSION,
        model_version: MODEL_VERSION,
        swarm: swarm.to_owned(),
        spec: wire::spec(recipe, recipe.seed),
        parameters: parameters_kept(state.parameters, *publish_every),
        epoch: *epoch,
        step: state.step,
        seq: *seq,
        state_hash: to_proto::hexadecimal(&state.hash()),
        doing: match phase {
            Phase::Paused(reason) => Doing::Paused {
                reason: reason.to_string(),
            },
            Phase::Running { until } => Doing::Running { until: *until },
            Phase::Stepping { until } => Doing::Stepping { until: *until },
            Phase::Faulted(reason) => Doing::Faulted {
                reason: reason.clone(),
            },
        },
        rate: *rate,
        origin: configuration.origin,
        next_id: configuration.next_id,
        id: configuration.id.clone(),
        x: configuration.x.clone(),
        y: configuration.y.clone(),
        alpha: configuration.alpha.clone(),
        weight: configuration.weight.clone(),
        direction: configuration.direction.clone(),
        lapses: lapses
            .filter_map(|(id, at)| at.map(|at_step| Lapse { id: *id, at_step }))
            .collect(),
        drives: drives.collect(),
        memory: SolverMemory {
            first: remembered.iter().map(|it| it.first).collect(),
            second: remembered.iter().map(|it| it.second).collect(),
            code: remembered.iter().map(|it| u32::from(it.code)).collect(),
            multiplier: remembered.iter().map(|it| it.multiplier).collect(),
            order: state.memory.order.clone(),
            order_age: state.memory.order_age,
        },
        sums: Sums {
            count: means.count,
            order: means.order,
            velocity: means.velocity,
            directed: means.directed,
            drift: means.drift,
        },
        exactness: Exactness {
            residual: exactness.residual,
            degraded: exactness.degraded,
            contacts: exactness.contacts as u64,
            iterations: exactness.iterations as u64,
        },
        scheduled: scheduled
            .iter()
            .map(|(at_step, waiting)| Waiting {
                at_step: *at_step,
                line: waiting.input,
                sent: sent(&waiting.sender),
            })
            .collect(),
        pending: pending.as_ref().map(|(from, sender)| Pending {
            from: *from,
            sent: sent(sender),
        }),
        controllers: controllers.iter().map(member_kept).collect(),
        events: *events,
        lines: *lines,
        is_last: *is_last,
        digest: None,
    }
}

/// The swarm that a snapshot is of.
///
/// # Errors
///
/// [`DurableError`].
pub fn checkpoint(
    snapshot: &proto::Snapshot,
    read: ReadOrder<'_>,
) -> Result<Checkpoint, DurableError> {
    let versions = [
        ("snapshots", snapshot.version, SNAPSHOT_VERSION),
        ("the model", snapshot.model_version, MODEL_VERSION),
    ];
    for (what, found, known) in versions {
        if found != known {
            return Err(DurableError::Version { what, found, known });
        }
    }
    let (recipe, state) = state(snapshot)?;
    if to_proto::hexadecimal(&state.hash()) != snapshot.state_hash {
        return Err(DurableError::Hash);
    }
    let scheduled = snapshot.scheduled.iter().map(|waiting| {
        let sender = sender(&waiting.sent)?;
        let order = read(&sender).map_err(DurableError::Unreadable)?;
        let input = waiting.line;
        let scheduled = Scheduled {
            input,
            order,
            sender,
        };
        Ok((waiting.at_step, scheduled))
    });
    let pending = snapshot.pending.as_ref();
    Ok(Checkpoint {
        publish_every: snapshot.parameters.publish_every,
        epoch: snapshot.epoch,
        seq: snapshot.seq,
        means: RunningMeans {
            count: snapshot.sums.count,
            order: snapshot.sums.order,
            velocity: snapshot.sums.velocity,
            directed: snapshot.sums.directed,
            drift: snapshot.sums.drift,
        },
        exactness: frame::Exactness {
            residual: snapshot.exactness.residual,
            degraded: snapshot.exactness.degraded,
            contacts: from_proto::count(snapshot.exactness.contacts),
            iterations: from_proto::count(snapshot.exactness.iterations),
        },
        phase: match &snapshot.doing {
            Doing::Paused { reason } => Phase::Paused(pause_reason(reason)?),
            Doing::Running { until } => Phase::Running { until: *until },
            Doing::Stepping { until } => Phase::Stepping { until: *until },
            Doing::Faulted { reason } => Phase::Faulted(reason.clone()),
        },
        rate: snapshot.rate,
        scheduled: scheduled.collect::<Result<_, _>>()?,
        pending: pending
            .map(|pending| Ok((pending.from, sender(&pending.sent)?)))
            .transpose()?,
        controllers: snapshot
            .controllers
            .iter()
            .map(membership)
            .collect::<Result<_, _>>()?,
        events: snapshot.events,
        lines: snapshot.lines,
        is_last: snapshot.is_last,
        recipe,
        state,
    })
}

/// What a snapshot's swarm was made from, and its state, whatever hash the snapshot names.
///
/// # Errors
///
/// [`DurableError`].
pub fn state(snapshot: &proto::Snapshot) -> Result<(Recipe, State), DurableError> {
    let unreadable = |problem: &str| DurableError::Unreadable(problem.to_owned());
    let recipe = from_proto::recipe(&snapshot.spec, from_proto::count(snapshot.spec.n))
        .map_err(|error| unreadable(&error.to_string()))?;
    let n = snapshot.id.len();
    let proto::Snapshot {
        x,
        y,
        alpha,
        weight,
        direction,
        memory,
        ..
    } = snapshot;
    if [x, y, alpha, weight, direction]
        .iter()
        .any(|column| column.len() != n)
    {
        return Err(unreadable("its columns differ in length"));
    }
    let contacts = memory.first.len();
    if [
        memory.second.len(),
        memory.code.len(),
        memory.multiplier.len(),
    ] != [contacts; 3]
    {
        return Err(unreadable(
            "the columns of its solver's memory differ in length",
        ));
    }
    let mut lapses_at = vec![None; n];
    for lapse in &snapshot.lapses {
        let index = snapshot.id.binary_search(&lapse.id);
        let index = index.map_err(|_| unreadable("somebody lapses who is not there"))?;
        lapses_at[index] = Some(lapse.at_step);
    }
    let state = State {
        parameters: parameters(&snapshot.parameters, recipe.parameters)
            .map_err(|error| unreadable(&error.to_string()))?,
        seed: recipe.seed,
        step: snapshot.step,
        configuration: Configuration {
            origin: snapshot.origin,
            next_id: snapshot.next_id,
            id: snapshot.id.clone(),
            x: x.clone(),
            y: y.clone(),
            alpha: alpha.clone(),
            weight: weight.clone(),
            direction: direction.clone(),
            lapses_at,
            drives: snapshot.drives.iter().map(drive).collect(),
        },
        memory: model::SolverMemory {
            contacts: (0..contacts)
                .map(|k| Remembered {
                    first: memory.first[k],
                    second: memory.second[k],
                    code: u8::try_from(memory.code[k]).unwrap_or(u8::MAX),
                    multiplier: memory.multiplier[k],
                })
                .collect(),
            order: memory.order.clone(),
            order_age: memory.order_age,
        },
    };
    Ok((recipe, state))
}

fn parameters_kept(
    now: model::Parameters,
    publish_every: u64,
) -> proto::snapshot::SnapshotParameters {
    let now = to_proto::parameter_values(now, publish_every);
    proto::snapshot::SnapshotParameters {
        pi1: now.pi1,
        pi2: now.pi2,
        pi3: now.pi3,
        pi4: now.pi4,
        contacts: Some(now.contacts),
        stepping: Some(now.stepping),
        relinearise: Some(now.relinearise),
        attraction: Some(Told(now.attraction)),
        noise: Some(now.noise),
        publish_every,
    }
}

/// The parameters of a snapshot; `made_with` is what the swarm was made with.
fn parameters(
    kept: &proto::snapshot::SnapshotParameters,
    made_with: model::Parameters,
) -> Result<model::Parameters, WireError> {
    let relinearise = kept.relinearise.map(from_proto::relinearise).transpose()?;
    Ok(model::Parameters {
        pi1: kept.pi1,
        pi2: kept.pi2,
        pi3: kept.pi3,
        pi4: kept.pi4,
        dt: made_with.dt,
        contacts: kept
            .contacts
            .map_or(made_with.contacts, from_proto::contact_rule),
        stepping: kept
            .stepping
            .map_or(made_with.stepping, from_proto::stepping),
        relinearise: relinearise.unwrap_or(made_with.relinearise),
        attraction: kept
            .attraction
            .as_ref()
            .map_or(made_with.attraction, |it| from_proto::attraction(it.0)),
        noise: kept.noise.unwrap_or(made_with.noise),
    })
}

fn drive(kept: &Drive) -> (u32, model::Drive) {
    let Drive { id, turn, speed } = *kept;
    (id, model::Drive { turn, speed })
}

fn member_kept((name, kept): &(String, Membership)) -> Member {
    Member {
        controller: name.clone(),
        mode: to_proto::mode(kept.mode),
        deadline_secs: kept.deadline.as_secs_f64(),
        on_timeout: to_proto::on_timeout(kept.on_timeout),
        driving: kept.driving,
        ids: kept.claims.iter().copied().collect(),
        steered: kept.steered.iter().copied().collect(),
        target: kept.target,
        from: kept.from,
        advance: kept.advance.as_deref().map(sent),
        misses: kept.misses,
        news: to_proto::news(kept.news.clone()),
        sequence: kept.sequence,
    }
}

fn membership(member: &Member) -> Result<(String, Membership), DurableError> {
    let deadline = control::deadline(member.deadline_secs);
    let deadline = deadline.ok_or_else(|| {
        DurableError::Unreadable(format!("a deadline of {} s", member.deadline_secs))
    })?;
    let kept = Membership {
        mode: from_proto::mode(member.mode),
        deadline,
        on_timeout: from_proto::on_timeout(member.on_timeout),
        driving: member.driving,
        claims: member.ids.iter().copied().collect(),
        steered: member.steered.iter().copied().collect(),
        target: member.target,
        from: member.from,
        advance: member.advance.as_ref().map(sender).transpose()?,
        misses: member.misses,
        news: from_proto::news(member.news.clone()),
        sequence: member.sequence,
    };
    Ok((member.controller.clone(), kept))
}

fn pause_reason(text: &str) -> Result<PauseReason, DurableError> {
    PauseReason::ALL
        .into_iter()
        .find(|reason| reason.to_string() == text)
        .ok_or_else(|| DurableError::Unreadable(format!("nothing is paused because {text:?}")))
}

fn sent(sender: &Sender) -> Sent {
    Sent {
        verb: sender.verb.to_owned(),
        args: sender.args.clone(),
        client: sender.client.clone(),
        request_id: sender.request_id.clone(),
        digest: sender.digest.map(Vec::from),
    }
}

fn sender(sent: &Sent) -> Result<Arc<Sender>, DurableError> {
    let mut known = keys::SWARM_VERBS.iter().chain(&keys::OWN_VERBS);
    let known = known.find(|verb| **verb == sent.verb);
    let Some(verb) = known else {
        let problem = format!("there is no verb {:?}", sent.verb);
        return Err(DurableError::Unreadable(problem));
    };
    Ok(Arc::new(Sender {
        verb,
        args: sent.args.clone(),
        client: sent.client.clone(),
        request_id: sent.request_id.clone(),
        digest: sent.digest.as_deref().and_then(|it| it.try_into().ok()),
    }))
}

/// A line's record as it is stored.
#[derive(Serialize, Deserialize)]
enum Stored {
    #[serde(rename = "input")]
    Input {
        at_step: Option<u64>,
        sent: Sent,
        seq: Option<u64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unix_secs: Option<f64>,
    },
    #[serde(rename = "became")]
    Became {
        input: u64,
        seq: Option<u64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        unix_secs: Option<f64>,
    },
    #[serde(rename = "fault")]
    Fault(String),
    #[serde(rename = "hash")]
    Hash(serde_bytes::ByteArray<32>),
    #[serde(rename = "resumed")]
    Resumed(u64),
}

/// A line's record as a kind, by which it can be found, and bytes.
pub fn record(record: &Record) -> (u8, Vec<u8>) {
    let (kind, stored) = match record {
        Record::Input {
            at_step,
            sender,
            seq,
            unix_secs,
        } => {
            let stored = Stored::Input {
                at_step: *at_step,
                sent: sent(sender),
                seq: *seq,
                unix_secs: *unix_secs,
            };
            (1, stored)
        }
        Record::Became {
            input,
            seq,
            unix_secs,
        } => {
            let stored = Stored::Became {
                input: *input,
                seq: *seq,
                unix_secs: *unix_secs,
            };
            (2, stored)
        }
        Record::Fault(reason) => (3, Stored::Fault(reason.clone())),
        Record::Hash(hash) => (4, Stored::Hash((*hash).into())),
        Record::Resumed(epoch) => (5, Stored::Resumed(*epoch)),
    };
    (kind, proto::to_cbor(&stored))
}

/// The record that was stored as these bytes.
///
/// # Errors
///
/// [`DurableError`].
pub fn read_record(bytes: &[u8]) -> Result<Record, DurableError> {
    let stored = ciborium::from_reader(bytes)
        .map_err(|error| DurableError::Unreadable(error.to_string()))?;
    Ok(match stored {
        Stored::Input {
            at_step,
            sent,
            seq,
            unix_secs,
        } => Record::Input {
            at_step,
            sender: sender(&sent)?,
            seq,
            unix_secs,
        },
        Stored::Became {
            input,
            seq,
            unix_secs,
        } => Record::Became {
            input,
            seq,
            unix_secs,
        },
        Stored::Fault(reason) => Record::Fault(reason),
        Stored::Hash(hash) => Record::Hash(hash.into_array()),
        Stored::Resumed(epoch) => Record::Resumed(epoch),
    })
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    /// A record as builds before wall-clock times read and wrote it.
    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    enum Before {
        #[serde(rename = "input")]
        Input {
            at_step: Option<u64>,
            sent: Sent,
            seq: Option<u64>,
        },
        #[serde(rename = "became")]
        Became { input: u64, seq: Option<u64> },
    }

    #[test]
    fn older_builds_read_records_with_a_time_and_theirs_are_read_without_one() {
        let sender = Arc::new(Sender {
            verb: "pause",
            args: "{}".to_owned(),
            ..Sender::default()
        });
        let records = |unix_secs| {
            let input = Record::Input {
                at_step: Some(7),
                sender: sender.clone(),
                seq: None,
                unix_secs,
            };
            let became = Record::Became {
                input: 3,
                seq: Some(5),
                unix_secs,
            };
            [input, became]
        };
        let known = records(Some(1_795_531_201.25));
        for (known, unknown) in known.into_iter().zip(records(None)) {
            let (kind, bytes) = record(&known);
            assert_eq!(read_record(&bytes).unwrap(), known);
            let before: Before = ciborium::from_reader(&bytes[..]).unwrap();
            let bytes = proto::to_cbor(&before);
            assert_eq!(read_record(&bytes).unwrap(), unknown);
            // Without a time the bytes are those of before.
            assert_eq!(record(&unknown), (kind, bytes));
        }
    }
}
