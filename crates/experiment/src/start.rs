//! The state of a snapshot, from which every run starts.

use std::sync::Arc;

use jostle_convert::{snapshot, spec};
use jostle_physics::model::{MODEL_VERSION, State};
use jostle_physics::observables::RunningMeans;
use jostle_physics::simulation::{
    Change, ChangeError, Checkpoint, Exactness, ReserveMemory, Settings, Simulation, Spec, Start,
};
use jostle_proto::snapshot::SnapshotPhase;
use jostle_proto::{Snapshot, to_cbor};

use crate::limits::MAX_INDIVIDUALS;

/// Says that the runs start from a state of an earlier version of the model.
#[must_use]
pub fn start_remark(model_version: u32) -> String {
    format!(
        "its runs start from a state that version {model_version} of the model computed, and are executed by \
         version {MODEL_VERSION}"
    )
}

/// The axes that a snapshot determines.
pub const FIXED: [&str; 5] = ["n", "pi1", "dt", "informed", "informed_fraction"];

/// The start of every run of a plan: the state in a snapshot, at step 0.
#[derive(Clone, Debug)]
pub struct Base {
    checkpoint: Arc<Checkpoint>,
    earlier_model: Option<u32>,
}

impl PartialEq for Base {
    fn eq(&self, other: &Self) -> bool {
        self.checkpoint.state.hash() == other.checkpoint.state.hash()
    }
}

impl Base {
    /// Reads the contents of a snapshot file.
    ///
    /// # Errors
    ///
    /// The reason if it is damaged, of another version, or no run can start from it.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let sent = Snapshot::from_file(bytes).map_err(|error| {
            format!("not a snapshot, or not all of one ({error}): `jostle snapshot` writes one")
        })?;
        let scheduled = sent.scheduled.len() + usize::from(sent.pending.is_some());
        if scheduled > 0 {
            return Err(format!(
                "the snapshot has {scheduled} scheduled commands, which a run does not execute: take it \
                 when none is left, and write them as [[at]]"
            ));
        }
        if !sent.when.is_empty() {
            return Err(format!(
                "the snapshot has {} waiting conditions, which a run does not evaluate: cancel them \
                 before taking it, and write them as [[at]] with when",
                sent.when.len()
            ));
        }
        let fail = |error: snapshot::SnapshotError| error.to_string();
        let mut checkpoint = snapshot::of_any_model(&sent).map_err(fail)?;
        snapshot::check(&checkpoint).map_err(fail)?;
        let State {
            configuration,
            step,
            parameters,
            ..
        } = &mut checkpoint.state;
        let n = configuration.n();
        if n as u64 > MAX_INDIVIDUALS {
            return Err(format!(
                "the snapshot has {n} individuals, the limit is {MAX_INDIVIDUALS}"
            ));
        }
        // Steps and times of a run count from its start.
        for lapses_at in configuration.lapses_at.iter_mut().flatten() {
            *lapses_at = lapses_at.saturating_sub(*step);
        }
        *step = 0;
        checkpoint.spec = Spec {
            n,
            parameters: *parameters,
            start: Start::Disc(None),
            ..checkpoint.spec
        };
        let earlier = sent.earlier_models.iter().map(|it| it.model_version);
        let versions = earlier.chain([sent.model_version]);
        Ok(Self {
            earlier_model: versions.min().filter(|it| *it < MODEL_VERSION),
            checkpoint: Arc::new(Checkpoint {
                epoch: 1,
                seq: 0,
                means: RunningMeans::default(),
                exactness: Exactness::default(),
                ..checkpoint
            }),
        })
    }

    /// Returns the earliest version of the model that computed a part of its past, if that is before this
    /// program's.
    pub fn earlier_model(&self) -> Option<u32> {
        self.earlier_model
    }

    /// Returns the fields of its spec, with the present parameters and size of the group.
    pub fn fields(&self) -> toml::Table {
        let Self { checkpoint, .. } = self;
        toml::Table::try_from(spec::to_proto(&checkpoint.spec, 0)).unwrap_or_default()
    }

    /// Returns the number of informed individuals.
    pub fn informed(&self) -> usize {
        let weights = self.checkpoint.state.configuration.weight.iter();
        weights.filter(|weight| **weight > 0.0).count()
    }

    /// Returns the simulation of a run: the state, with the seed of `spec` and its parameters.
    ///
    /// # Errors
    ///
    /// [`ChangeError`] if the state cannot have these parameters.
    pub fn simulation(
        &self,
        spec: &Spec,
        reserve: ReserveMemory,
    ) -> Result<Simulation, ChangeError> {
        let mut simulation = Simulation::from_checkpoint(&self.checkpoint, reserve);
        // No command: it has no number of its own. The bodies of the state keep their shape.
        let settings = Change::Set(Settings {
            pi1: None,
            ..Settings::all(spec.parameters)
        });
        simulation.apply_at(simulation.seq, &settings)?;
        simulation.state.seed = spec.seed;
        simulation.publish_every = spec.publish_every;
        simulation.measures.clone_from(&spec.measures);
        simulation.spec = spec.clone();
        Ok(simulation)
    }

    /// Returns the snapshot file of the state from which a run starts, as [`Self::simulation`].
    ///
    /// # Errors
    ///
    /// [`ChangeError`] if the state cannot have the parameters of `spec`.
    pub fn snapshot(&self, spec: &Spec, reserve: ReserveMemory) -> Result<Vec<u8>, ChangeError> {
        let checkpoint = self.simulation(spec, reserve)?.checkpoint();
        let doing = SnapshotPhase::Paused {
            reason: "created".to_owned(),
        };
        Ok(to_cbor(
            // It is of no swarm.
            &snapshot::to_proto("", &checkpoint, doing).sealed(),
        ))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
