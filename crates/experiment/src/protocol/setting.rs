//! The condition of a plan that a protocol is resolved for.

use std::sync::Arc;

use jostle_physics::simulation::{Spec, steps_in};

use super::variables::Variables;
use crate::set_points::SetPointTable;

/// What a protocol is resolved for.
#[derive(Clone, Copy)]
pub struct Setting<'a> {
    /// The spec of the swarm, except for its seed.
    pub spec: &'a Spec,
    /// The number of individuals that are informed from the start.
    pub informed: usize,
    /// The duration of a run, in time units.
    pub duration: f64,
    /// The values of the variables.
    pub variables: &'a Variables,
    /// The set-points of every run.
    pub set_points: Option<&'a Arc<SetPointTable>>,
}

impl Setting<'_> {
    /// Returns the number of steps of a run.
    pub fn steps(&self) -> u64 {
        steps_in(self.duration, self.spec.parameters.dt)
    }
}
