//! What the daemon would do with the swarms in a store.

use jostle_physics::plural::counted;
use jostle_proto as proto;
use serde::Serialize;

use crate::convert::{self, durable};
use crate::persistence::prospect::{Prospect, prospect};
use crate::store::{Store, StoreError};

/// What the daemon would do with a swarm.
#[derive(Debug, Serialize)]
pub struct Swarm {
    /// Its name.
    pub name: String,
    /// Its newest checkpoint; left out if none can be read.
    #[serde(flatten)]
    pub checkpoint: Option<Checkpoint>,
    /// Whether it will be marked as of an earlier version of the model.
    pub marked: bool,
    /// What the daemon will do.
    pub message: String,
    /// The damage that was found.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damage: Vec<String>,
}

/// The newest checkpoint of a swarm that can be read, and what follows it.
#[derive(Debug, Serialize)]
pub struct Checkpoint {
    /// The phase of the swarm; left out if commands after the checkpoint may have changed it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase: Option<proto::Phase>,
    /// The epoch of the state.
    pub epoch: u64,
    /// The step of the state.
    pub step: u64,
    /// The version of the model that computed the state.
    pub model_version: u32,
    /// The versions that computed steps before.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub earlier_models: Vec<proto::EarlierModel>,
    /// The number of commands after it.
    pub later_commands: usize,
}

impl Swarm {
    /// What is wrong with it.
    pub(super) fn problem(&self) -> Option<String> {
        let Self { name, message, .. } = self;
        let problem = match &self.checkpoint {
            None => message.clone(),
            Some(_) if self.damage.is_empty() => return None,
            Some(_) => self.damage.join("; "),
        };
        Some(format!("swarm {name:?}: {problem}"))
    }

    fn of(name: String, read: Result<Prospect, String>) -> Self {
        let Prospect {
            checkpoint,
            phase,
            later_commands,
            damage,
        } = match read {
            Ok(prospect) => prospect,
            Err(error) => {
                return Self {
                    name,
                    checkpoint: None,
                    marked: false,
                    message: format!("not recovered, and stays in the store: {error}"),
                    damage: Vec::new(),
                };
            }
        };
        let (marked, step) = (
            checkpoint.is_of_earlier_model(),
            checkpoint.simulation.state.step,
        );
        let again = match (marked, later_commands) {
            (false, _) => "goes on".to_owned(),
            (true, 0) => format!("goes on from step {step}, marked"),
            (true, 1) => {
                format!("goes on from step {step}, marked; 1 later command is executed again")
            }
            (true, _) => {
                let commands = counted(later_commands, "later command");
                format!("goes on from step {step}, marked; {commands} are executed again")
            }
        };
        Self {
            name,
            marked,
            message: again,
            damage,
            checkpoint: Some(Checkpoint {
                phase: phase.as_ref().map(convert::phase),
                epoch: checkpoint.simulation.epoch,
                step,
                model_version: checkpoint.model_version,
                earlier_models: checkpoint
                    .earlier_models
                    .iter()
                    .map(durable::earlier_model)
                    .collect(),
                later_commands,
            }),
        }
    }
}

/// The swarms in a store, by name.
pub(super) fn swarms(store: &Store) -> Result<Vec<Swarm>, StoreError> {
    let mut swarms = Vec::new();
    for (name, metadata) in store.swarms()? {
        let read = prospect(store, &name, &metadata).map_err(|error| error.to_string());
        // A running daemon may have deleted it meanwhile.
        if read.is_ok() || !matches!(store.swarm_id(&name), Err(StoreError::NoSwarm(_))) {
            swarms.push(Swarm::of(name, read));
        }
    }
    Ok(swarms)
}
