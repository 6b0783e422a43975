//! Snapshots: the stored form of a checkpoint.

use std::sync::Arc;

use jostle_convert::SnapshotError;
use jostle_proto as proto;
use jostle_proto::snapshot::{Member, Pending, Sent, SnapshotPhase, StoredCondition, Waiting};
use jostle_proto::verbs::journaled;
use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;
use serde::de::value::Error as ValueError;

use crate::convert::controllers::{news, news_to_proto};
use crate::swarm::checkpoint::{Checkpoint, EarlierModel};
use crate::swarm::command::Command;
use crate::swarm::membership::{self, ControllerSettings, ControllerState};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::schedule::Scheduled;
use crate::swarm::sender::Sender;
use crate::swarm::watch;

/// Returns the snapshot of a checkpoint.
pub fn snapshot(swarm: &str, checkpoint: &Checkpoint) -> proto::Snapshot {
    let Checkpoint {
        simulation,
        phase,
        rate,
        scheduled,
        watches,
        past,
        pending,
        controllers,
        annotations,
        protocol_draws,
        is_protected,
        model_version,
        earlier_models,
        events,
        lines,
        is_last,
    } = checkpoint;
    let doing = match phase {
        Phase::Paused(reason) => SnapshotPhase::Paused {
            reason: reason.to_string(),
        },
        Phase::Running { until } => SnapshotPhase::Running { until: *until },
        Phase::Stepping { until } => SnapshotPhase::Stepping { until: *until },
        Phase::Faulted(reason) => SnapshotPhase::Faulted {
            reason: reason.clone(),
        },
    };
    proto::Snapshot {
        rate: *rate,
        scheduled: scheduled
            .iter()
            .map(|(at_step, waiting)| Waiting {
                at_step: *at_step,
                line: waiting.input,
                sent: sent(&waiting.sender),
            })
            .collect(),
        when: watches
            .iter()
            .map(|waiting| StoredCondition {
                since: waiting.held.steps().to_vec(),
                first: waiting.first,
                sent: sent(&waiting.sender),
            })
            .collect(),
        past: jostle_convert::past::to_proto(past),
        pending: pending.as_ref().map(|(from, sender)| Pending {
            from: *from,
            sent: sent(sender),
        }),
        controllers: controllers.iter().map(member).collect(),
        seq: checkpoint.seq(),
        annotations: *annotations,
        protocol_draws: *protocol_draws,
        protected: *is_protected,
        model_version: *model_version,
        earlier_models: earlier_models.iter().map(earlier_model).collect(),
        events: *events,
        lines: *lines,
        is_last: *is_last,
        ..jostle_convert::snapshot::to_proto(swarm, simulation, doing)
    }
}

/// Returns the checkpoint in a snapshot; `read` parses the commands in it.
pub fn checkpoint(
    snapshot: &proto::Snapshot,
    read: &dyn Fn(&Sender) -> Result<Command, String>,
) -> Result<Checkpoint, SnapshotError> {
    let simulation = jostle_convert::snapshot::of_any_model(snapshot)?;
    let scheduled = snapshot.scheduled.iter().map(|waiting| {
        let sender = sender(&waiting.sent)?;
        let scheduled = Scheduled {
            input: waiting.line,
            command: read(&sender).map_err(SnapshotError::Unreadable)?,
            sender,
        };
        Ok((waiting.at_step, scheduled))
    });
    let watches = snapshot.when.iter().map(|waiting| {
        let sender = sender(&waiting.sent)?;
        match read(&sender).map_err(SnapshotError::Unreadable)? {
            Command::Watch(watch) => {
                let held = waiting.since.clone().into();
                Ok(watch::Waiting::new(*watch, waiting.first, held, sender))
            }
            _ => {
                let problem = format!("{} is no condition", sender.verb);
                Err(SnapshotError::Unreadable(problem))
            }
        }
    });
    let pending = snapshot.pending.as_ref();
    Ok(Checkpoint {
        simulation,
        phase: match &snapshot.doing {
            SnapshotPhase::Paused { reason } => Phase::Paused(pause_reason(reason)?),
            SnapshotPhase::Running { until } => Phase::Running { until: *until },
            SnapshotPhase::Stepping { until } => Phase::Stepping { until: *until },
            SnapshotPhase::Faulted { reason } => Phase::Faulted(reason.clone()),
        },
        rate: snapshot.rate,
        scheduled: scheduled.collect::<Result<_, _>>()?,
        watches: watches.collect::<Result<_, _>>()?,
        // The next step sets how far it reaches back.
        past: jostle_convert::past::from_proto(u64::MAX, snapshot.past.iter().cloned())
            .map_err(|error| SnapshotError::Unreadable(error.to_string()))?,
        pending: pending
            .map(|pending| Ok((pending.from, sender(&pending.sent)?)))
            .transpose()?,
        controllers: snapshot
            .controllers
            .iter()
            .map(membership)
            .collect::<Result<_, _>>()?,
        annotations: snapshot.annotations,
        protocol_draws: snapshot.protocol_draws,
        is_protected: snapshot.protected,
        model_version: snapshot.model_version,
        earlier_models: snapshot.earlier_models.iter().map(read_model).collect(),
        events: snapshot.events,
        lines: snapshot.lines,
        is_last: snapshot.is_last,
    })
}

/// Returns an earlier version of the model.
pub fn earlier_model(model: &EarlierModel) -> proto::EarlierModel {
    proto::EarlierModel {
        model_version: model.version,
        epoch: model.epoch,
        step: model.step,
    }
}

fn read_model(model: &proto::EarlierModel) -> EarlierModel {
    EarlierModel {
        version: model.model_version,
        epoch: model.epoch,
        step: model.step,
    }
}

fn member((name, kept): &(String, ControllerState)) -> Member {
    Member {
        controller: name.clone(),
        mode: kept.settings.mode.into(),
        deadline_secs: kept.settings.deadline.as_secs_f64(),
        on_timeout: kept.settings.on_timeout.into(),
        driving: kept.settings.driving,
        ids: kept.claims.iter().copied().collect(),
        steered: kept.steered.iter().copied().collect(),
        target: kept.target,
        from: kept.from,
        advance: kept.advance.as_deref().map(sent),
        misses: kept.misses,
        news: news_to_proto(kept.news.clone()),
        sequence: kept.sequence,
    }
}

fn membership(member: &Member) -> Result<(String, ControllerState), SnapshotError> {
    let deadline = membership::deadline(member.deadline_secs);
    let deadline = deadline.ok_or_else(|| {
        SnapshotError::Unreadable(format!("a deadline of {} s", member.deadline_secs))
    })?;
    let kept = ControllerState {
        settings: ControllerSettings {
            mode: member.mode.into(),
            deadline,
            on_timeout: member.on_timeout.into(),
            driving: member.driving,
        },
        claims: member.ids.iter().copied().collect(),
        steered: member.steered.iter().copied().collect(),
        target: member.target,
        from: member.from,
        advance: member.advance.as_ref().map(sender).transpose()?,
        misses: member.misses,
        news: news(member.news.clone()),
        sequence: member.sequence,
    };
    Ok((member.controller.clone(), kept))
}

fn pause_reason(text: &str) -> Result<PauseReason, SnapshotError> {
    let reason: Result<_, ValueError> = PauseReason::deserialize(text.into_deserializer());
    reason.map_err(|_| SnapshotError::Unreadable(format!("unknown pause reason {text:?}")))
}

pub(crate) fn sent(sender: &Sender) -> Sent {
    Sent {
        verb: sender.verb.to_owned(),
        args: sender.args.clone(),
        client: sender.client.clone(),
        request_id: sender.request_id.clone(),
        digest: sender.digest.map(Vec::from),
    }
}

pub(crate) fn sender(sent: &Sent) -> Result<Arc<Sender>, SnapshotError> {
    let Some(verb) = journaled(&sent.verb) else {
        let problem = format!("there is no verb {:?}", sent.verb);
        return Err(SnapshotError::Unreadable(problem));
    };
    Ok(Arc::new(Sender {
        verb,
        args: sent.args.clone(),
        client: sent.client.clone(),
        request_id: sent.request_id.clone(),
        digest: sent.digest.as_deref().and_then(|it| it.try_into().ok()),
    }))
}
