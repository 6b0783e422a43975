//! Rigid elongated bodies that walk forward, turn towards the group and push each other without
//! friction. Each step is a convex quadratic program (Principle 1 of the paper), solved exactly.
//!
//! ```
//! use jostle_physics::simulation::{Change, Simulation, Spec};
//! use jostle_physics::model::selection::Selection;
//!
//! let mut simulation = Simulation::new(&Spec::new(50, 1))?;
//! simulation.apply(&Change::inform(Selection::Count(5), 0.0))?; // as a daemon's first command
//! for _ in 0..100 {
//!     simulation.step()?;
//! }
//! println!("order {:.3}", simulation.order().order);
//! assert!(simulation.exactness.residual <= 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`simulation`] starts, steps and changes a swarm. A step is made by the [`stepper`]: it computes
//! the free motion, finds the contacts, solves the program and moves the bodies. [`model`] has the
//! parameters, the state and its hash; [`observables`] measures a state. `docs/model.md` has the
//! equations, `docs/solver.md` the algorithm.
//!
//! Every function depends on its arguments alone. This crate reads no clock and no file and starts
//! no thread, which `crates/physics/clippy.toml` checks; it uses no serialiser itself and no
//! runtime. A caller may pass a pool of threads, which changes no bit of a result.
//!
//! Lengths are in body sizes, the mean of a body's length and width. Speeds are in the free speed
//! of a body. Angles are in radians.

#![cfg_attr(
    test,
    expect(clippy::disallowed_methods, reason = "tests depend on no bit of them")
)]

pub mod model;
pub mod observables;
pub mod plural;
pub mod simulation;
pub mod stepper;
