//! Converts snapshots of a simulation (state, spec and running means) from and to their message.

use std::fmt::Display;

use jostle_physics::model::{
    self, Configuration, MODEL_VERSION, OLDEST_MODEL_VERSION, State, WarmContact,
};
use jostle_physics::observables::RunningMeans;
use jostle_physics::simulation::{Checkpoint, Exactness, Spec};
use jostle_proto::snapshot::{Drive, Lapse, SNAPSHOT_VERSION, SnapshotPhase, SolverMemory, Sums};
use jostle_proto::{self as proto, LARGEST_WHOLE};
use thiserror::Error;

use crate::measures::published;
use crate::parameters::{parameters, values};
use crate::spec;
use crate::value::{count, max_idle_secs, publish_every};

/// Maximum distance of a group's origin from 0, in cells: a double represents it exactly.
const MAX_ORIGIN: u64 = LARGEST_WHOLE;

/// Codes of contacts are below this.
const CODES: u8 = 8;

/// Why a snapshot is rejected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SnapshotError {
    /// It is malformed.
    #[error("it cannot be read: {0}")]
    Unreadable(String),
    /// Another version wrote it.
    #[error("it has version {found} of {what}, this daemon reads version {known}")]
    Version {
        /// The thing with that version: snapshots or the model.
        what: &'static str,
        /// The version in the snapshot.
        found: u32,
        /// The version of this program.
        known: u32,
    },
    /// The hash of the state differs from the hash in the snapshot.
    #[error("the hash of its state differs from its `state_hash`")]
    Hash,
    /// No simulation can be in this state.
    #[error("its state is invalid: {0}")]
    Impossible(String),
}

/// Returns a hash as 64 hexadecimal digits.
pub fn hexadecimal(hash: &[u8; 32]) -> String {
    blake3::Hash::from(*hash).to_hex().to_string()
}

/// Returns the snapshot of a simulation, with the rate of its spec. The fields for schedule,
/// controllers, journal and annotations, which only a daemon has, are empty.
pub fn to_proto(swarm: &str, checkpoint: &Checkpoint, doing: SnapshotPhase) -> proto::Snapshot {
    let Checkpoint {
        spec,
        state,
        publish_every,
        measures,
        max_idle_secs,
        epoch,
        seq,
        means,
        exactness,
    } = checkpoint;
    let (configuration, contacts) = (&state.configuration, &state.warm_start.contacts);
    let lapses = configuration.id.iter().zip(&configuration.lapses_at);
    let drives = configuration.drives.iter().map(|(id, drive)| Drive {
        id: *id,
        turn: drive.turn,
        speed: drive.speed,
    });
    proto::Snapshot {
        version: SNAPSHOT_VERSION,
        model_version: MODEL_VERSION,
        earlier_models: Vec::new(),
        swarm: swarm.to_owned(),
        spec: spec::to_proto(spec, spec.seed),
        parameters: values(state.parameters, *publish_every, measures, *max_idle_secs).into(),
        epoch: *epoch,
        step: state.step,
        seq: *seq,
        annotations: 0,
        protocol_draws: 0,
        protected: false,
        state_hash: hexadecimal(&state.hash()),
        doing,
        rate: spec.rate,
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
            first: contacts.iter().map(|it| it.first).collect(),
            second: contacts.iter().map(|it| it.second).collect(),
            code: contacts.iter().map(|it| u32::from(it.code)).collect(),
            multiplier: contacts.iter().map(|it| it.multiplier).collect(),
            order: state.warm_start.order.clone(),
            order_age: state.warm_start.order_age,
        },
        sums: Sums {
            count: means.count,
            order: means.order,
            velocity: means.velocity,
            directed: means.directed,
            drift: means.drift,
        },
        exactness: proto::snapshot::Exactness {
            residual: exactness.residual,
            degraded: exactness.degraded,
            contacts: exactness.contacts as u64,
            iterations: exactness.iterations as u64,
        },
        scheduled: Vec::new(),
        when: Vec::new(),
        past: Vec::new(),
        pending: None,
        controllers: Vec::new(),
        events: 0,
        lines: 0,
        is_last: false,
        digest: None,
    }
}

/// Returns the simulation in a snapshot of this version of the model, after checking its versions and
/// its hash.
///
/// # Errors
///
/// [`SnapshotError::Version`], [`SnapshotError::Unreadable`] and [`SnapshotError::Hash`].
pub fn from_proto(snapshot: &proto::Snapshot) -> Result<Checkpoint, SnapshotError> {
    check_version("the model", snapshot.model_version, MODEL_VERSION)?;
    of_any_model(snapshot)
}

fn check_version(what: &'static str, found: u32, known: u32) -> Result<(), SnapshotError> {
    match found == known {
        true => Ok(()),
        false => Err(SnapshotError::Version { what, found, known }),
    }
}

/// Returns the simulation in a snapshot of this or an earlier version of the model, after checking its
/// versions and its hash under the version that computed it. Further steps are those of this version.
///
/// # Errors
///
/// [`SnapshotError::Version`], [`SnapshotError::Unreadable`] and [`SnapshotError::Hash`].
pub fn of_any_model(snapshot: &proto::Snapshot) -> Result<Checkpoint, SnapshotError> {
    check_version("snapshots", snapshot.version, SNAPSHOT_VERSION)?;
    let found = snapshot.model_version;
    if !(OLDEST_MODEL_VERSION..=MODEL_VERSION).contains(&found) {
        check_version("the model", found, MODEL_VERSION)?;
    }
    let (spec, state) = state(snapshot)?;
    if hexadecimal(&state.hash_under(found)) != snapshot.state_hash {
        return Err(SnapshotError::Hash);
    }
    let annotations = snapshot.annotations;
    // Annotations have a number, but do not count for random draws.
    let seq = snapshot.seq.checked_sub(annotations).ok_or_else(|| {
        SnapshotError::Unreadable(format!("more annotations than commands: {annotations}"))
    })?;
    Ok(Checkpoint {
        spec,
        state,
        publish_every: snapshot.parameters.publish_every,
        measures: snapshot.parameters.measures.clone().unwrap_or_default(),
        max_idle_secs: snapshot.parameters.max_idle_secs,
        epoch: snapshot.epoch,
        seq,
        means: RunningMeans {
            count: snapshot.sums.count,
            order: snapshot.sums.order,
            velocity: snapshot.sums.velocity,
            directed: snapshot.sums.directed,
            drift: snapshot.sums.drift,
        },
        exactness: Exactness {
            residual: snapshot.exactness.residual,
            degraded: snapshot.exactness.degraded,
            contacts: count(snapshot.exactness.contacts),
            iterations: count(snapshot.exactness.iterations),
        },
    })
}

/// Returns the spec and the state in a snapshot, without checking its versions and its hash.
///
/// # Errors
///
/// [`SnapshotError::Unreadable`].
pub fn state(snapshot: &proto::Snapshot) -> Result<(Spec, State), SnapshotError> {
    let unreadable = |problem: &str| SnapshotError::Unreadable(problem.to_owned());
    let spec = spec::from_proto(&snapshot.spec, count(snapshot.spec.n))
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
        return Err(unreadable("the columns of its warm start differ in length"));
    }
    let mut lapses_at = vec![None; n];
    for lapse in &snapshot.lapses {
        let index = snapshot.id.binary_search(&lapse.id);
        let index = index.map_err(|_| {
            unreadable("an unknown individual has a time at which it becomes uninformed")
        })?;
        lapses_at[index] = Some(lapse.at_step);
    }
    let state = State {
        parameters: parameters(
            &snapshot.parameters.values(&snapshot.spec),
            spec.parameters.dt,
        )
        .map_err(|error| unreadable(&error.to_string()))?,
        seed: spec.seed,
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
        warm_start: model::WarmStart {
            contacts: (0..contacts)
                .map(|k| WarmContact {
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
    Ok((spec, state))
}

fn drive(saved: &Drive) -> (u32, model::Drive) {
    let Drive { id, turn, speed } = *saved;
    (id, model::Drive { turn, speed })
}

/// Checks the conditions on which the stepper relies, for a simulation from an untrusted snapshot.
///
/// # Errors
///
/// [`SnapshotError::Impossible`].
pub fn check(checkpoint: &Checkpoint) -> Result<(), SnapshotError> {
    let impossible = |problem: &str| Err(SnapshotError::Impossible(problem.to_owned()));
    let Checkpoint {
        state,
        means,
        exactness,
        ..
    } = checkpoint;
    let configuration = &state.configuration;
    let ids = &configuration.id;
    if ids.is_empty() {
        return impossible("it has no individuals");
    }
    if !ids.is_sorted_by(|a, b| a < b) || ids.iter().any(|id| *id >= configuration.next_id) {
        return impossible("its ids are not ascending, or not below next_id");
    }
    if configuration
        .origin
        .iter()
        .any(|it| it.unsigned_abs() > MAX_ORIGIN)
    {
        return impossible("its origin is too far from 0");
    }
    let columns = [
        &configuration.x,
        &configuration.y,
        &configuration.alpha,
        &configuration.weight,
        &configuration.direction,
    ];
    let residual = exactness.residual;
    let [vx, vy] = means.velocity;
    let sums = [means.order, vx, vy, means.drift, residual];
    let mut numbers = columns.into_iter().flatten().chain(&sums);
    if !numbers.all(|it| it.is_finite()) {
        return impossible("it has a number that is not finite");
    }
    if configuration.weight.iter().any(|weight| *weight < 0.0) {
        return impossible("it has a negative weight");
    }
    let rejected = |error: &dyn Display| SnapshotError::Impossible(error.to_string());
    state
        .parameters
        .check(configuration.largest_weight())
        .map_err(|error| rejected(&error))?;
    publish_every(checkpoint.publish_every).map_err(|error| rejected(&error))?;
    published(&checkpoint.measures).map_err(|error| rejected(&error))?;
    let max_idle_secs = checkpoint.max_idle_secs.map(max_idle_secs);
    max_idle_secs
        .transpose()
        .map_err(|error| rejected(&error))?;
    let counts = [state.step, checkpoint.seq, means.count, means.directed];
    if counts.into_iter().any(|it| it > LARGEST_WHOLE) {
        return impossible("it has a count that is too large");
    }
    let is_contact =
        |code: u8, multiplier: f64| code < CODES && multiplier.is_finite() && multiplier >= 0.0;
    let mut contacts = state.warm_start.contacts.iter();
    if !contacts.all(|it| is_contact(it.code, it.multiplier)) || !is_order(&state.warm_start.order)
    {
        return impossible("the warm start of its solver is malformed");
    }
    Ok(())
}

/// Returns whether `order` is a permutation of 0 to its length less one.
fn is_order(order: &[u32]) -> bool {
    let mut sorted = order.to_vec();
    sorted.sort_unstable();
    sorted
        .iter()
        .zip(0..)
        .all(|(found, expected)| *found == expected)
}
