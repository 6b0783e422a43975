//! A swarm as a whole, to be kept in a file and brought back by a daemon of the same or a later model
//! version.

use std::io;

use ciborium::Value;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::queries::EarlierModel;
use crate::verbs::{Mode, News, OnTimeout};
use crate::walk::{Lenient, lenient};
use crate::{Attraction, ContactRule, ParameterValues, Spec, Stepping, column, to_cbor};

/// The version of the layout of snapshots; it grows when an older reader would misread them.
pub const SNAPSHOT_VERSION: u32 = 1;

/// A swarm with all that its future depends on.
///
/// In CBOR the columns are RFC 8746 typed arrays, little-endian.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Snapshot {
    /// The version of this layout.
    pub version: u32,
    /// The version of the model that computed it: another one has another future.
    pub model_version: u32,
    /// The earlier versions of the model that computed steps before, oldest first; left out without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier_models: Vec<EarlierModel>,
    /// The swarm's name.
    pub swarm: String,
    /// Its spec with the current seed.
    #[serde(deserialize_with = "lenient")]
    pub spec: Spec,
    /// The values of the parameters that may change.
    pub parameters: SnapshotParameters,
    /// Grows whenever `step` does not continue what was published before.
    pub epoch: u64,
    /// The number of steps since the start.
    pub step: u64,
    /// Counts the applied commands.
    pub seq: u64,
    /// How many of them were annotations, which the numbers of random draws leave out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub annotations: u64,
    /// The number of changes by commands of a protocol, which numbers their random draws.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub protocol_draws: u64,
    /// Whether it is protected from `delete` and `reset`; a swarm that is restored from this is not.
    #[serde(default, skip_serializing_if = "crate::is_false")]
    pub protected: bool,
    /// BLAKE3 of the state, in hexadecimal.
    pub state_hash: String,
    /// What it is doing.
    pub doing: SnapshotPhase,
    /// Time units per second of wall clock; `null` is as fast as possible.
    pub rate: Option<f64>,
    /// Two integers: where the positions are counted from, in units of 1024 body sizes.
    pub origin: [i64; 2],
    /// The id of the next individual.
    pub next_id: u32,
    /// Ids; never used twice.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub id: Vec<u32>,
    /// Positions relative to the origin, body sizes.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub x: Vec<f64>,
    /// Positions relative to the origin, body sizes.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub y: Vec<f64>,
    /// Headings in radians.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub alpha: Vec<f64>,
    /// Weights of the preferred directions; 0 for the uninformed.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub weight: Vec<f64>,
    /// Preferred directions in radians.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub direction: Vec<f64>,
    /// Who is uninformed again, and at the end of which step.
    pub lapses: Vec<Lapse>,
    /// Who is driven directly, by a controller.
    #[serde(default)]
    pub drives: Vec<Drive>,
    /// What the solver carries from one step to the next.
    pub memory: SolverMemory,
    /// Sums over the steps since the start or reset.
    pub sums: Sums,
    /// How exact the last step was.
    pub exactness: Exactness,
    /// The commands that wait for their step, in the order they come due.
    pub scheduled: Vec<Waiting>,
    /// The conditions that it waits for, in the order of their commands.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub when: Vec<StoredCondition>,
    /// The positions and headings of earlier steps that the measures of these conditions need, by
    /// ascending step.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub past: Vec<PastFrame>,
    /// A `step` that is being executed.
    #[serde(default)]
    pub pending: Option<Pending>,
    /// The controllers that have joined.
    #[serde(default)]
    pub controllers: Vec<Member>,
    /// How many events there have been.
    #[serde(default)]
    pub events: u64,
    /// How many lines of its journal it contains.
    #[serde(default)]
    pub lines: u64,
    /// Whether the swarm was put away after it.
    #[serde(default)]
    pub is_last: bool,
    /// BLAKE3, in hexadecimal, of the snapshot in CBOR without this; a snapshot that is sent has
    /// one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The values of the parameters that may change while a swarm lives. What is left out is as in
/// `spec`: snapshots were made before the rules and the noise could change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SnapshotParameters {
    /// Length over width of a body.
    pub pi1: f64,
    /// Weight of individuals informed without one.
    pub pi2: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// Which of a pair's contacts constrain it.
    #[serde(default)]
    pub contacts: Option<ContactRule>,
    /// What a contact limits.
    #[serde(default)]
    pub stepping: Option<Stepping>,
    /// How many more programs a step solves about what the last one predicts.
    #[serde(default)]
    pub relinearise: Option<u8>,
    /// What an individual turns towards.
    #[serde(default)]
    #[schemars(with = "Option<Attraction>")]
    pub attraction: Option<Lenient<Attraction>>,
    /// Intensity of white noise on the turning rate, squared angle over time.
    #[serde(default)]
    pub noise: Option<f64>,
    /// Steps between two published states.
    pub publish_every: u64,
    /// The measures in each published order; left out without any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measures: Option<Vec<String>>,
    /// For how many seconds the swarm waits for a controller in lock-step that sends nothing; left out
    /// without a limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_idle_secs: Option<f64>,
}

impl SnapshotParameters {
    /// The values; those that are left out are those of `spec`.
    pub fn values(&self, spec: &Spec) -> ParameterValues {
        let attraction = self.attraction.as_ref().map(|it| it.0);
        ParameterValues {
            pi1: self.pi1,
            pi2: self.pi2,
            pi3: self.pi3,
            pi4: self.pi4,
            contacts: self.contacts.unwrap_or(spec.contacts),
            stepping: self.stepping.unwrap_or(spec.stepping),
            relinearise: self.relinearise.unwrap_or(spec.relinearise),
            attraction: attraction.unwrap_or(spec.attraction),
            noise: self.noise.unwrap_or(spec.noise),
            publish_every: self.publish_every,
            measures: self.measures.clone(),
            max_idle_secs: self.max_idle_secs,
        }
    }
}

impl From<ParameterValues> for SnapshotParameters {
    fn from(values: ParameterValues) -> Self {
        let ParameterValues {
            pi1,
            pi2,
            pi3,
            pi4,
            contacts,
            stepping,
            relinearise,
            attraction,
            noise,
            publish_every,
            measures,
            max_idle_secs,
        } = values;
        SnapshotParameters {
            pi1,
            pi2,
            pi3,
            pi4,
            contacts: Some(contacts),
            stepping: Some(stepping),
            relinearise: Some(relinearise),
            attraction: Some(Lenient(attraction)),
            noise: Some(noise),
            publish_every,
            measures,
            max_idle_secs,
        }
    }
}

/// The phase of a swarm in detail.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[schemars(rename = "Doing")]
pub enum SnapshotPhase {
    /// Standing still.
    Paused {
        /// Why.
        reason: String,
    },
    /// Running at its rate.
    Running {
        /// The step it will pause at; `null` if it runs for good.
        until: Option<u64>,
    },
    /// Going to a step as fast as it can.
    Stepping {
        /// That step.
        until: u64,
    },
    /// A step failed.
    Faulted {
        /// Why.
        reason: String,
    },
}

/// A joined controller, with all that is durable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Member {
    /// Its name.
    pub controller: String,
    /// When the swarm steps.
    pub mode: Mode,
    /// How long others wait for it, or how long its set-points hold, seconds.
    pub deadline_secs: f64,
    /// What happens to its individuals when it is late.
    pub on_timeout: OnTimeout,
    /// Whether it may drive individuals directly.
    pub driving: bool,
    /// The individuals that it may steer.
    pub ids: Vec<u32>,
    /// The individuals that it has steered.
    pub steered: Vec<u32>,
    /// The step that it has advanced to.
    pub target: u64,
    /// The step at which it began to.
    pub from: u64,
    /// Its `advance` without a reply yet.
    #[serde(default)]
    pub advance: Option<Sent>,
    /// Deadlines missed in a row.
    pub misses: u32,
    /// What happened since the last reply to it.
    pub news: News,
    /// The number of its newest put that was applied.
    pub sequence: u64,
}

/// When an individual becomes uninformed again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Lapse {
    /// The individual.
    pub id: u32,
    /// At the end of which step.
    pub at_step: u64,
}

/// How an individual is driven directly, beyond the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Drive {
    /// The individual.
    pub id: u32,
    /// Turning rate, angle over time; `null` to turn by itself.
    pub turn: Option<f64>,
    /// Factor of the free speed; `null` to move by itself.
    pub speed: Option<f64>,
}

/// What the solver carries from one step to the next: the contacts that pushed, as columns, and
/// the order of elimination.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SolverMemory {
    /// The first of the pair, by id.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub first: Vec<u32>,
    /// The second of the pair, by id.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub second: Vec<u32>,
    /// Which ends touch.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub code: Vec<u32>,
    /// How hard they pushed.
    #[serde(with = "column::f64_column")]
    #[schemars(with = "Vec<f64>")]
    pub multiplier: Vec<f64>,
    /// The order in which individuals are eliminated, by index.
    #[serde(with = "column::u32_column")]
    #[schemars(with = "Vec<u32>")]
    pub order: Vec<u32>,
    /// How many programs were solved in that order.
    pub order_age: u32,
}

/// Sums over steps, from which the means are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sums {
    /// How many steps.
    pub count: u64,
    /// Their orders.
    pub order: f64,
    /// Their velocities.
    pub velocity: [f64; 2],
    /// How many of them had a common direction.
    pub directed: u64,
    /// Their drifts.
    pub drift: f64,
}

/// How exact a step was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Exactness {
    /// Its residual, body sizes.
    pub residual: f64,
    /// How many steps since the start or reset missed the target residual.
    pub degraded: u64,
    /// How many contacts constrained it.
    pub contacts: u64,
    /// How many iterations it took.
    pub iterations: u64,
}

/// A command as received.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Sent {
    /// The verb.
    pub verb: String,
    /// Its arguments, JSON.
    pub args: String,
    /// The client, as the request names it.
    pub client: Option<String>,
    /// The id that its client gave it.
    pub request_id: Option<String>,
    /// Distinguishes it from another request with the same id.
    #[serde(with = "serde_bytes")]
    #[schemars(with = "Option<Vec<u8>>")]
    pub digest: Option<Vec<u8>>,
}

/// A command that waits for its step.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Waiting {
    /// The step.
    pub at_step: u64,
    /// The number of its entry in the journal.
    pub line: u64,
    /// The command.
    pub sent: Sent,
}

/// A condition for which the swarm waits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StoredCondition {
    /// The step since which each comparison of the condition has held, in the order of the text;
    /// `null` for one that does not hold.
    pub since: Vec<Option<u64>>,
    /// The step of its command; its measures do not use earlier states.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub first: u64,
    /// The command `when`.
    pub sent: Sent,
}

/// The positions and headings of all individuals after an earlier step, as columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PastFrame {
    /// The number of steps taken.
    pub step: u64,
    /// Where the positions are counted from, in units of 1024 body sizes.
    pub origin: [i64; 2],
    /// Ids.
    pub id: Vec<u32>,
    /// Positions relative to the origin, body sizes.
    pub x: Vec<f64>,
    /// Positions relative to the origin, body sizes.
    pub y: Vec<f64>,
    /// Headings in radians.
    pub alpha: Vec<f64>,
}

/// A `step` that is being executed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Pending {
    /// The step it began at.
    pub from: u64,
    /// The command.
    pub sent: Sent,
}

impl Snapshot {
    /// Reads a snapshot from CBOR, with its digest or without one.
    ///
    /// # Errors
    ///
    /// What is wrong with `bytes`, for instance another digest than they contain.
    pub fn from_cbor(bytes: &[u8]) -> Result<Self, String> {
        let snapshot: Snapshot = ciborium::from_reader(bytes).map_err(unreadable)?;
        match &snapshot.digest {
            Some(expected) if digest(bytes)? != *expected => {
                Err("it is damaged: its digest does not match".into())
            }
            _ => Ok(snapshot),
        }
    }

    /// Reads a snapshot that was sent or kept in a file, from CBOR.
    ///
    /// # Errors
    ///
    /// As [`Snapshot::from_cbor`], and if there is no digest or something after it.
    pub fn from_file(bytes: &[u8]) -> Result<Self, String> {
        let snapshot = Snapshot::from_cbor(bytes)?;
        snapshot
            .digest
            .is_some()
            .then_some(snapshot)
            .ok_or_else(|| "it is damaged: it has no digest".into())
    }

    /// The snapshot with its digest, to be sent.
    #[must_use]
    pub fn sealed(mut self) -> Self {
        self.digest = None;
        self.digest = digest(&to_cbor(&self)).ok();
        self
    }
}

/// What a snapshot's digest is of, however its numbers are encoded: all that is in it, known here
/// or not, but the digest.
fn digest(bytes: &[u8]) -> Result<String, String> {
    let mut left = bytes;
    let mut value: Value = ciborium::from_reader(&mut left).map_err(unreadable)?;
    if !left.is_empty() {
        return Err(format!("{} bytes follow it", left.len()));
    }
    if let Value::Map(fields) = &mut value {
        fields.retain(|(name, _)| name.as_text() != Some("digest"));
    }
    Ok(blake3::hash(&to_cbor(&value)).to_hex().to_string())
}

fn unreadable(error: ciborium::de::Error<io::Error>) -> String {
    match error {
        ciborium::de::Error::Semantic(_, problem) => problem,
        ciborium::de::Error::Io(_) => "it ends before its end".into(),
        _ => "it is no CBOR".into(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::Reply;

    #[test]
    fn what_was_written_before_there_were_other_rules_is_still_read() {
        let now: serde_json::Value =
            serde_json::from_str(include_str!("../fixtures/snapshot.reply.json")).unwrap();
        let mut before = now.clone();
        let rules = ["stepping", "relinearise"];
        let changeable = ["contacts", "stepping", "relinearise", "attraction", "noise"];
        for (part, fields) in [("spec", &rules[..]), ("parameters", &changeable)] {
            let part = before["result"][part].as_object_mut().unwrap();
            for &field in fields {
                assert!(part.remove(field).is_some(), "{field}");
            }
        }
        let [now, before] = [now, before].map(|it| {
            serde_json::from_value::<Reply<Snapshot>>(it)
                .unwrap()
                .result
        });
        assert_eq!(now.spec, before.spec);
        assert_eq!(before.parameters.attraction, None);
    }

    #[test]
    fn a_damaged_file_is_rejected_or_means_the_same() {
        let reply = include_str!("../fixtures/snapshot.reply.json");
        let reply: Reply<Snapshot> = serde_json::from_str(reply).unwrap();
        let sealed = reply.result.sealed();
        let bytes = to_cbor(&sealed);
        assert_eq!(Snapshot::from_file(&bytes).unwrap(), sealed);
        let mut rejected = 0;
        for place in 0..bytes.len() {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[place] ^= 1 << bit;
                match Snapshot::from_file(&damaged) {
                    Ok(read) => assert_eq!(read, sealed, "bit {bit} of byte {place}"),
                    Err(_) => rejected += 1,
                }
            }
        }
        assert!(rejected > 7 * bytes.len(), "{rejected}");
        for wrong in [
            [&bytes[..], &[0]].concat(),
            [&bytes[..], &bytes].concat(),
            bytes[..bytes.len() - 1].to_vec(),
            to_cbor(&Snapshot {
                digest: None,
                ..sealed.clone()
            }),
            to_cbor(&Snapshot { seq: 77, ..sealed }),
        ] {
            assert!(Snapshot::from_file(&wrong).is_err());
        }
    }
}
