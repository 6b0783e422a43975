//! rapier2d as a solver of our program: bodies get their free velocities before every step, and
//! contacts have no friction, restitution or softness.
//!
//! With mass 1 and inertia ρ2 the kinetic metric of rapier is our `W`. A contact at distance g may
//! close by g in a step, and an overlapping one opens by its overlap, which is our linearised gap.
//! One iteration of many sweeps is then projected Gauss-Seidel on our program, with a warm start
//! from rapier's impulses of the step before. Two things differ: the second contact of a pair
//! shares the normal of the first, and a pair at an angle of more than an eighth of a turn has only
//! one contact.
//!
//! Errors are measured on the recorded steps: before each, bodies are set to the recorded
//! positions, and the warm start is rapier's impulses of the step before. Times are measured along
//! rapier's own trajectory from the first recorded state, where errors add up. Bodies and colliders
//! persist there, so that only a step of its pipeline is timed, broad and narrow phase included.

use std::time::Duration;

use jostle_physics::model::{State, body};
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::qp::Qp;
use rapier2d_f64::prelude::{
    BroadPhaseBvh, CCDSolver, ColliderBuilder, ColliderSet, ImpulseJointSet, IntegrationParameters,
    IslandManager, MassProperties, MultibodyJointSet, NarrowPhase, PhysicsPipeline, Real,
    RigidBodyBuilder, RigidBodyHandle, RigidBodySet, Rotation, SoftBodySet, SpringCoefficients,
    Vector,
};

use super::backend::{Quality, displacement};
use super::measure::cpu_time;
use super::phases::Phases;
use super::record::Recorded;

/// Default number of sweeps over all contacts in a step.
pub const SWEEPS: usize = 50;

/// Steps until the impulses are a useful warm start.
pub const WARMING: usize = 10;

/// An undamped spring that is stiff enough to push an overlap out in one step and not to soften
/// impulses: 1 / (2π dt frequency)² is negligible beside 1.
const STIFF: SpringCoefficients<Real> = SpringCoefficients {
    natural_frequency: 1e12,
    damping_ratio: 0.0,
};

/// A run along rapier's own trajectory that can be repeated.
pub struct Run {
    start: State,
    sweeps: usize,
    /// The free velocities of every step: n rows of x, y and turning rate.
    velocities: Vec<Vec<[f64; 3]>>,
}

struct World {
    bodies: RigidBodySet,
    colliders: ColliderSet,
    handles: Vec<RigidBodyHandle>,
    parameters: IntegrationParameters,
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
    ccd: CCDSolver,
    pipeline: PhysicsPipeline,
}

/// Solves the recorded steps and returns the quality of the results. The first [`WARMING`] steps
/// only prepare the warm start.
pub fn quality_of(records: &[Recorded], truth: &[Vec<[f64; 3]>], sweeps: usize) -> Quality {
    let mut world = World::new(&records[0].state, sweeps);
    let mut quality = Quality::default();
    let warming = records.len() - truth.len();
    for (step, recorded) in records.iter().enumerate() {
        let Recorded { state, qp, .. } = recorded;
        world.place(state);
        world.drive(&velocities(qp, state));
        world.step();
        let Some(index) = step.checked_sub(warming) else {
            continue;
        };
        let mut after = state.clone();
        world.read(&mut after);
        quality.add_displacement(state, &after, &truth[index], qp);
        quality.active += world.pushing() as f64;
        quality.iterations += sweeps as f64;
    }
    quality.divide(truth.len());
    quality
}

/// Returns the free velocities: n rows of x, y and turning rate.
fn velocities(qp: &Qp, state: &State) -> Vec<[f64; 3]> {
    let rate = |free: &[f64; 3]| free.map(|part| part / state.parameters.dt);
    qp.free.iter().map(rate).collect()
}

impl Run {
    /// Runs [`WARMING`] and then `count` steps from `start`, and compares each of the latter with
    /// the exact step from the same state.
    pub fn new(start: &State, count: usize, sweeps: usize) -> (Self, Quality) {
        let mut world = World::new(start, sweeps);
        let (mut state, mut velocities_of) = (start.clone(), Vec::new());
        let (mut phases, mut quality) = (Phases::default(), Quality::default());
        let mut stepper = Stepper::new();
        for step in 0..WARMING + count {
            world.read(&mut state);
            let (program, _) = phases.program(&state);
            let free = velocities(&program, &state);
            world.drive(&free);
            velocities_of.push(free);
            world.step();
            if step < WARMING {
                continue;
            }
            let mut exact = state.clone();
            stepper
                .step(&mut exact)
                .expect("the exact step from rapier's state is solved");
            state.warm_start = exact.warm_start.clone();
            let mut after = state.clone();
            world.read(&mut after);
            let truth = displacement(&state, &exact);
            quality.add_displacement(&state, &after, &truth, &program);
        }
        quality.divide(count);
        let run = Self {
            start: start.clone(),
            sweeps,
            velocities: velocities_of,
        };
        (run, quality)
    }

    /// Repeats the steps and returns the CPU time of those after the first [`WARMING`].
    pub fn repeat(&self) -> Duration {
        let mut world = World::new(&self.start, self.sweeps);
        let mut began = cpu_time();
        for (step, velocities) in self.velocities.iter().enumerate() {
            if step == WARMING {
                began = cpu_time();
            }
            world.drive(velocities);
            world.step();
        }
        cpu_time() - began
    }
}

impl World {
    fn new(state: &State, sweeps: usize) -> Self {
        let (ours, configuration) = (&state.parameters, &state.configuration);
        let (mut bodies, mut colliders) = (RigidBodySet::new(), ColliderSet::new());
        let mut handles = Vec::new();
        for index in 0..configuration.n() {
            let pose = body::pose(configuration, index);
            let properties = MassProperties::new(Vector::ZERO, 1.0, ours.rho2());
            let body = RigidBodyBuilder::dynamic()
                .translation(Vector::new(pose.x, pose.y))
                .rotation(pose.alpha)
                .additional_mass_properties(properties)
                .can_sleep(false);
            let shape = match ours.half_length() {
                0.0 => ColliderBuilder::ball(ours.radius()),
                h => ColliderBuilder::capsule_x(h, ours.radius()),
            };
            let shape = shape.density(0.0).friction(0.0).restitution(0.0);
            let handle = bodies.insert(body);
            colliders.insert_with_parent(shape, handle, &mut bodies);
            handles.push(handle);
        }
        let parameters = IntegrationParameters {
            dt: ours.dt,
            contact_softness: STIFF,
            num_solver_iterations: 1,
            num_internal_pgs_iterations: sweeps,
            // Corrects velocities after the positions have changed, without effect on positions.
            // With 0 iterations rapier would solve friction in every sweep.
            num_internal_stabilization_iterations: 1,
            normalized_prediction_distance: ours.reach(configuration.largest_weight()),
            normalized_max_corrective_velocity: Real::MAX,
            max_ccd_substeps: 0,
            // With recycling, normals and lever arms could be those of earlier steps.
            contact_recycling: false,
            ..IntegrationParameters::default()
        };
        Self {
            bodies,
            colliders,
            handles,
            parameters,
            islands: IslandManager::new(),
            broad_phase: BroadPhaseBvh::new(),
            narrow_phase: NarrowPhase::new(),
            impulse_joints: ImpulseJointSet::new(),
            multibody_joints: MultibodyJointSet::new(),
            soft_bodies: SoftBodySet::new(),
            ccd: CCDSolver::new(),
            pipeline: PhysicsPipeline::new(),
        }
    }

    fn place(&mut self, state: &State) {
        for (index, &handle) in self.handles.iter().enumerate() {
            let pose = body::pose(&state.configuration, index);
            let body = &mut self.bodies[handle];
            body.set_translation(Vector::new(pose.x, pose.y), false);
            body.set_rotation(Rotation::new(pose.alpha), false);
        }
    }

    fn drive(&mut self, velocities: &[[f64; 3]]) {
        for (&handle, &[x, y, turning]) in self.handles.iter().zip(velocities) {
            let body = &mut self.bodies[handle];
            body.set_linvel(Vector::new(x, y), false);
            body.set_angvel(turning, false);
        }
    }

    fn step(&mut self) {
        self.pipeline.step(
            Vector::ZERO,
            &self.parameters,
            &mut self.islands,
            &mut self.broad_phase,
            &mut self.narrow_phase,
            &mut self.bodies,
            &mut self.colliders,
            &mut self.impulse_joints,
            &mut self.multibody_joints,
            &mut self.soft_bodies,
            &mut self.ccd,
            &(),
            &(),
        );
    }

    fn read(&self, state: &mut State) {
        let configuration = &mut state.configuration;
        for (index, &handle) in self.handles.iter().enumerate() {
            let body = &self.bodies[handle];
            let centre = body.translation();
            (configuration.x[index], configuration.y[index]) = (centre.x, centre.y);
            configuration.alpha[index] = body.rotation().angle();
        }
    }

    fn pushing(&self) -> usize {
        self.narrow_phase
            .contact_pairs()
            .flat_map(|pair| pair.manifolds())
            .flat_map(|manifold| &manifold.points)
            .filter(|point| point.data.impulse > 0.0)
            .count()
    }
}
