//! The memory of the running experiment, which counts in that of the swarms.

use std::sync::Arc;

use jostle_experiment::Plan;

use super::ExperimentManager;
use super::error::ExperimentError;
use crate::swarm::registry::SwarmRegistry;

/// Memory that is reserved for an execution until this is dropped.
pub(super) struct ReservedMemory {
    registry: Arc<SwarmRegistry>,
    bytes: u64,
    /// The number of runs at a time.
    pub threads: usize,
}

impl Drop for ReservedMemory {
    fn drop(&mut self) {
        self.registry.release_of_experiments(self.bytes);
    }
}

impl ExperimentManager {
    /// Checks that the largest run of a plan fits beside the swarms, as another experiment does not run.
    pub(super) fn check_memory(&self, plan: &Plan) -> Result<(), ExperimentError> {
        let registry = &self.0.registry;
        let (shared, run) = needed(plan);
        let needed = shared.saturating_add(run);
        let limit = registry.limits().max_memory_bytes;
        let free = limit.saturating_sub(registry.swarms_memory_bytes());
        match needed <= free {
            true => Ok(()),
            false => Err(ExperimentError::NoMemory {
                needed,
                free,
                limit,
            }),
        }
    }

    /// Reserves memory for an execution of a plan, with as many runs at a time as fit.
    ///
    /// # Errors
    ///
    /// [`ExperimentError::NoMemory`] if a single run does not fit.
    pub(super) fn reserve_memory(&self, plan: &Plan) -> Result<ReservedMemory, ExperimentError> {
        let registry = &self.0.registry;
        let (shared, run) = needed(plan);
        let most = self.0.threads.min(plan.runs().len()).max(1);
        let reserved = registry.reserve_for_experiments(shared, run, most);
        let (bytes, threads) = reserved.map_err(|free| ExperimentError::NoMemory {
            needed: shared.saturating_add(run),
            free,
            limit: registry.limits().max_memory_bytes,
        })?;
        Ok(ReservedMemory {
            registry: registry.clone(),
            bytes,
            threads,
        })
    }
}

/// Returns the memory of a plan and the rows of its runs, and that of its largest run.
fn needed(plan: &Plan) -> (u64, u64) {
    let runs = plan.runs().iter().map(|run| plan.run_memory_bytes(run));
    (plan.memory_bytes(), runs.max().unwrap_or(0))
}
