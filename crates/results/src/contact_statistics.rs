//! Measurements of contacts, one row a run, as CSV.

#[cfg(feature = "files")]
mod file;

use serde::{Deserialize, Serialize};

#[cfg(feature = "files")]
pub use file::{read, write};

/// The name of the table within its directory.
pub const CONTACT_STATISTICS_NAME: &str = "touch.csv";

/// How much bodies touch in a run, and how contacts turn and displace them.
///
/// Lengths are in body sizes `s`, times in `s/v0`, angles in radians.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactStatistics {
    /// The run's name.
    pub run: String,
    /// Number of individuals.
    pub n: u64,
    /// Length over width of a body.
    pub pi1: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// The contact rule.
    pub contacts: String,
    /// The time step.
    pub dt: f64,
    /// The mean number of contacts that constrain a step, over the number of individuals.
    pub listed: f64,
    /// The mean number of contacts that push, over the number of individuals.
    pub pushing: f64,
    /// The mean rate at which contacts turn a pushed individual: angle over time.
    pub turned: f64,
    /// The mean rate at which contacts displace a pushed individual: length over time.
    pub shifted: f64,
    /// The mean share of individuals with another one at their side that heads the same way.
    pub beside: f64,
    /// The distance of the centroid's last position from its first, over the path of a free
    /// individual.
    pub way: f64,
}
