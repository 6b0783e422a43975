//! A swarm that is stepped by requests.

use base64::engine::general_purpose::STANDARD;
use base64::{DecodeError, Engine as _};
use jostle_convert::{change, hexadecimal, snapshot, spec};
use jostle_experiment::MAX_INDIVIDUALS;
use jostle_physics::simulation::Simulation;
use jostle_proto::snapshot::{Snapshot, SnapshotPhase};
use jostle_proto::verbs::{self, SetPoints};
use jostle_proto::{ErrorCode, Spec};

use crate::request::{Answer, Rejection, Reply, Status};

/// A swarm.
pub struct Swarm {
    /// Its simulation.
    pub simulation: Simulation,
    /// Why it takes no further steps.
    pub fault: Option<String>,
}

impl Swarm {
    /// Creates a swarm.
    pub fn create(spec: &Spec) -> Result<Self, Rejection> {
        let n = usize::try_from(spec.n)
            .ok()
            .filter(|_| spec.n <= MAX_INDIVIDUALS);
        let n = n.ok_or_else(|| {
            let message = format!("n = {}, the limit is {MAX_INDIVIDUALS}", spec.n);
            Rejection::of(ErrorCode::ResourceExhausted, &message)
        })?;
        let simulation = Simulation::new(&spec::from_proto(spec, n)?)?;
        Ok(Self {
            simulation,
            fault: None,
        })
    }

    /// Restores a swarm from a snapshot in base64.
    pub fn restore(encoded: &str) -> Result<Self, Rejection> {
        let bytes = STANDARD
            .decode(encoded)
            .map_err(|error| no_base64(&error))?;
        let restored = Snapshot::from_file(&bytes).map_err(|error| Rejection::invalid(&error))?;
        let checkpoint = snapshot::from_proto(&restored)?;
        snapshot::check(&checkpoint)?;
        Ok(Self {
            simulation: Simulation::from_checkpoint(&checkpoint, Box::new(|_| Ok(()))),
            fault: None,
        })
    }

    /// Returns the snapshot.
    pub fn snapshot(&self) -> Answer {
        let doing = SnapshotPhase::Paused {
            reason: String::new(),
        };
        let snapshot = snapshot::to_proto("swarm", &self.simulation.checkpoint(), doing);
        let bytes = jostle_proto::to_cbor(&snapshot.sealed());
        Answer::Snapshot {
            snapshot: STANDARD.encode(bytes),
        }
    }

    /// Applies a change.
    pub fn apply(&mut self, change: verbs::Change, seq: Option<u64>) -> Reply {
        let change = change::change(change)?;
        change.check()?;
        let seq = seq.unwrap_or(self.simulation.seq + 1);
        let outcome = self.simulation.apply_at(seq, &change)?;
        Ok(Answer::Changed(change::changed(change.kind(), outcome)))
    }

    /// Sets directions, weights and drives.
    pub fn steer(&mut self, set: SetPoints) -> Reply {
        let set = change::set_points(set)?;
        self.simulation.steer(&set)?;
        Ok(Answer::Steered {
            n: self.simulation.state.configuration.n(),
        })
    }

    /// Takes steps, until one fails.
    pub fn step(&mut self, steps: u64) -> Reply {
        if let Some(fault) = &self.fault {
            return Err(Rejection::of(ErrorCode::Faulted, fault));
        }
        for _ in 0..steps {
            if let Err(error) = self.simulation.step() {
                self.fault = Some(error.to_string());
                break;
            }
        }
        Ok(Answer::Status(Status::of(
            &self.simulation,
            self.fault.clone(),
        )))
    }
}

impl Status {
    /// Returns the status of a simulation.
    pub fn of(simulation: &Simulation, fault: Option<String>) -> Self {
        let order = simulation.order();
        let exactness = &simulation.exactness;
        Self {
            step: simulation.state.step,
            time: simulation.state.time(),
            n: simulation.state.configuration.n(),
            pi1: simulation.state.parameters.pi1,
            state_hash: hexadecimal(&simulation.state_hash()),
            order: order.order,
            drift: order.drift,
            mean_order: simulation.means.mean_order(),
            residual: exactness.residual,
            contacts: exactness.contacts,
            iterations: exactness.iterations,
            degraded: exactness.degraded,
            fault,
        }
    }
}

/// The rejection of a snapshot that is no base64.
pub fn no_base64(error: &DecodeError) -> Rejection {
    Rejection::invalid(&format!("it is no base64: {error}"))
}
