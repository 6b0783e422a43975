//! Measures of a swarm that are chosen by name, such as `order`, `msd(5)` or `clusters.count(0.1)`.
//!
//! ```
//! use jostle_measures::{Measure, Past, View};
//! use jostle_physics::simulation::{Simulation, Spec};
//!
//! let measures = ["order", "radius_of_gyration", "msd(0.2)"].map(str::parse::<Measure>);
//! let measures = measures.into_iter().collect::<Result<Vec<_>, _>>()?;
//!
//! let mut simulation = Simulation::new(&Spec::new(50, 1))?;
//! let dt = simulation.state.parameters.dt;
//! let lag = measures.iter().map(|measure| measure.lag(dt)).max().unwrap_or(0);
//! let mut past = Past::new(lag);
//! past.observe(&simulation.state);
//! for _ in 0..20 {
//!     simulation.step()?;
//!     past.observe(&simulation.state);
//! }
//! let view = View::new(&simulation.state, &past);
//! for measure in &measures {
//!     println!("{measure} {:?}", measure.evaluate(&view));
//! }
//! # assert!(measures.iter().all(|measure| measure.evaluate(&view).is_some()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`definitions`] lists all measures with their units, formulas and sources. A [`Measure`] is one of
//! them with its argument. It is evaluated on a [`View`], which computes what several measures need
//! only once, and on a [`Past`], which has the positions and headings of earlier steps. The functions
//! in [`histograms`] return distributions and are no measures.
//!
//! Every function depends on its arguments alone: no clock, thread or file. Sums are in the order of
//! individuals, so a result is the same on x86-64, aarch64 and wasm32. Lengths are in body sizes, speeds in
//! the free speed, times in body sizes over the free speed, angles in radians.

#![warn(missing_docs)]
#![cfg_attr(
    test,
    expect(clippy::disallowed_methods, reason = "tests depend on no bit of them")
)]

mod cost;
mod definition;
mod error;
mod families;
mod gaps;
mod measure;
mod past;
mod positions;
mod registry;
#[cfg(test)]
mod testing;
mod view;

pub use cost::{MAX_PLAIN, TooCostlyTogether, check_cost};
pub use definition::{Argument, Definition};
pub use error::{MAX_COSTLY_INDIVIDUALS, MeasureError, TooCostly};
pub use families::alignment::nematic_order;
pub use families::histograms;
pub use gaps::{TOUCHING, cluster_sizes};
pub use measure::Measure;
pub use past::{FRAME_POSES, Frame, MAX_PAST, Past, PastError, check_past};
pub use registry::definitions;
pub use view::View;
