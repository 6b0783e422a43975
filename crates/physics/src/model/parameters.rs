//! The dimensionless numbers of the model (Table 1) and derived quantities.

use std::ops::RangeInclusive;

use thiserror::Error;

/// Which of a pair's contacts constrain a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ContactRule {
    /// Every smooth endpoint-to-segment distance that no smaller distance of the pair implies.
    #[default]
    Endpoints,
    /// Of the contacts of `Endpoints` only the nearest; ties go to the lowest code. The literal
    /// reading of the paper's appendix, under which axes may cross.
    Closest,
    /// The contacts of `Endpoints`, and every two ends of which only one is nearest to the other,
    /// although a smaller distance of the pair implies theirs. Not part of the model; for
    /// comparison.
    Clamped,
}

/// The quantity that a contact limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stepping {
    /// The gap after the step, to first order: the next step pushes overlap out, eq. (7).
    #[default]
    Position,
    /// The speed at which touching bodies approach each other: the paper's first approach, after
    /// eq. (19). Overlap from rounding and curvature is not pushed out, and adds up.
    Velocity,
}

/// The law of attraction: the individuals that attract an individual, and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attraction {
    /// All others at any distance, eq. (4).
    All {
        /// The target error of the mean of unit vectors, whose length is at most 1; within
        /// [`ACCURACIES`]. Without an accuracy the mean is summed term by term. With one, far
        /// groups are summed by series if the swarm is large, and the means no longer cancel to
        /// rounding. The error is not bounded. Measured errors are within the accuracy for one
        /// group of any shape, and up to 10 times larger for a few distant groups.
        accuracy: Option<f64>,
    },
    /// The individuals whose Voronoi cells share an edge of positive length with the individual's
    /// own, and those at the same point.
    Voronoi,
    /// All others at a distance of at most `radius`.
    Metric {
        /// The distance, in body sizes.
        radius: f64,
    },
    /// The nearest others; of several at one distance those with the lower ids.
    Topological {
        /// Number of neighbours.
        neighbours: u32,
    },
    /// All others, each unit vector times a power of the distance. The mean may be longer than 1.
    Power {
        /// The exponent, within [`EXPONENTS`]: 0 is eq. (4).
        exponent: f64,
    },
}

impl Default for Attraction {
    fn default() -> Self {
        Self::All { accuracy: None }
    }
}

/// The range of the accuracy. A coarser one would hardly be faster; a finer one would hardly be
/// faster than the direct sum.
pub const ACCURACIES: RangeInclusive<f64> = 1e-9..=1e-3;

/// The range of the exponent: beyond it only the nearest or the furthest would count.
pub const EXPONENTS: RangeInclusive<f64> = -8.0..=8.0;

/// Parameters of a swarm's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Length over width of a body; 1 is a disc.
    pub pi1: f64,
    /// Weight of individuals that are informed without a weight of their own.
    pub pi2: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// Duration of a step, in body sizes over the free speed.
    pub dt: f64,
    /// Which contacts constrain a step.
    pub contacts: ContactRule,
    /// The quantity that a contact limits.
    pub stepping: Stepping,
    /// Whether a step solves a second program, linearised about the result of the first.
    pub relinearise: bool,
    /// The law of attraction.
    pub attraction: Attraction,
    /// `D_α`, the intensity of white noise on the turning rate: squared angle over time.
    pub noise: f64,
}

/// Why parameters are rejected.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ParametersError {
    /// A number is outside its range, or not a number.
    #[error("{field} = {value:?} is outside {range}")]
    OutOfRange {
        /// The field's name.
        field: &'static str,
        /// The value rejected.
        value: f64,
        /// The values allowed.
        range: &'static str,
    },
    /// A setting cannot be combined with another.
    #[error("{field} does not go with {other}: leave out one of them")]
    Clash {
        /// The setting rejected.
        field: &'static str,
        /// The other setting.
        other: &'static str,
    },
    /// A point of a free body's axis could travel further than a width in one step.
    #[error(
        "dt = {dt} is too long: with these parameters and weights at most {largest}; lower pi1, \
         pi3 or the weight, or create with a shorter dt"
    )]
    StepTooLong {
        /// The duration rejected.
        dt: f64,
        /// The longest allowed with the other parameters and weights.
        largest: f64,
    },
}

/// The largest weight, `pi3`, `pi4`, noise, length and angle. It is far beyond any use, and small
/// enough that products with positions neither overflow nor lose the free speed to rounding.
pub const LARGEST_NUMBER: f64 = 1e6;

/// The reach in units of the free travel of one body in a step. Free bodies approach each other at
/// most twice as fast as one travels. The factor 3 instead of 2 allows for pushed bodies.
/// The value affects only the cost: after solving, the stepper checks all pairs that could meet
/// given the computed displacements.
const REACH_TRAVELS: f64 = 3.0;

impl Default for Parameters {
    /// The values of Table 1 for the paper's second series (section 3.2), with the `pi1` of the
    /// elongated bodies in Figure 3.
    fn default() -> Self {
        Self {
            pi1: 4.0,
            pi2: 0.5,
            pi3: 1.0,
            pi4: 10.0,
            dt: 0.02,
            contacts: ContactRule::Endpoints,
            stepping: Stepping::Position,
            relinearise: false,
            attraction: Attraction::default(),
            noise: 0.0,
        }
    }
}

impl Attraction {
    /// Checks the number of a law.
    ///
    /// # Errors
    ///
    /// [`ParametersError::OutOfRange`] if the number is outside its range.
    fn check(self) -> Result<(), ParametersError> {
        let (field, value, range, is_fine) = match self {
            Self::All { accuracy: None } | Self::Voronoi => return Ok(()),
            Self::All {
                accuracy: Some(value),
            } => (
                "attraction.accuracy",
                value,
                "[1e-9, 1e-3]",
                ACCURACIES.contains(&value),
            ),
            Self::Metric { radius } => (
                "attraction.radius",
                radius,
                "(0, 1e6]",
                radius > 0.0 && radius <= LARGEST_NUMBER,
            ),
            Self::Topological { neighbours } => (
                "attraction.neighbours",
                f64::from(neighbours),
                "the whole numbers from 1",
                neighbours > 0,
            ),
            Self::Power { exponent } => (
                "attraction.exponent",
                exponent,
                "[-8, 8]",
                EXPONENTS.contains(&exponent),
            ),
        };
        if is_fine {
            return Ok(());
        }
        Err(ParametersError::OutOfRange {
            field,
            value,
            range,
        })
    }
}

impl Parameters {
    /// Checks every number; `largest_weight` is the largest weight that is or will be present.
    ///
    /// # Errors
    ///
    /// [`ParametersError::OutOfRange`] for the first field that is outside its range or not
    /// finite; [`ParametersError::Clash`] for settings that cannot be combined;
    /// [`ParametersError::StepTooLong`] if `dt (1 + h ω) > 2r`.
    pub fn check(&self, largest_weight: f64) -> Result<(), ParametersError> {
        let positive = |field, value: f64| match value {
            v if v > 0.0 && v <= LARGEST_NUMBER => Ok(()),
            _ => Err(ParametersError::OutOfRange {
                field,
                value,
                range: "(0, 1e6]",
            }),
        };
        if !(1.0..=32.0).contains(&self.pi1) {
            let (field, value, range) = ("pi1", self.pi1, "[1, 32]");
            return Err(ParametersError::OutOfRange {
                field,
                value,
                range,
            });
        }
        check_weight("pi2", self.pi2)?;
        positive("pi3", self.pi3)?;
        positive("pi4", self.pi4)?;
        check_weight("weight", largest_weight)?;
        self.attraction.check()?;
        check_weight("noise", self.noise)?;
        if self.relinearise && self.stepping == Stepping::Velocity {
            let (field, other) = ("relinearise", "stepping = velocity");
            return Err(ParametersError::Clash { field, other });
        }
        if !(self.dt.is_finite() && self.dt > 0.0) {
            let (field, value, range) = ("dt", self.dt, "the numbers above 0");
            return Err(ParametersError::OutOfRange {
                field,
                value,
                range,
            });
        }
        let largest = self.longest_step(largest_weight);
        if self.dt > largest {
            return Err(ParametersError::StepTooLong {
                dt: self.dt,
                largest,
            });
        }
        Ok(())
    }

    /// Returns half the length of a body's axis, `h = p r`, in body sizes.
    #[must_use]
    pub fn half_length(&self) -> f64 {
        (self.pi1 - 1.0) * self.radius()
    }

    /// Returns the radius of the disc swept along the axis, `r = s / (2 (1 + p/2))`, in body sizes.
    #[must_use]
    pub fn radius(&self) -> f64 {
        1.0 / (1.0 + self.pi1)
    }

    /// Returns the rotational drag, `ρ2 = s² ρ1 / π4`, with `ρ1 = 1`.
    #[must_use]
    pub fn rho2(&self) -> f64 {
        1.0 / self.pi4
    }

    /// Returns `ω = π3 (1 + largest weight)`, in radians per unit of time.
    ///
    /// `ω` bounds the free turning rate without noise under every law of attraction but `power`,
    /// whose pull may be longer than 1.
    #[must_use]
    pub fn turning_rate_scale(&self, largest_weight: f64) -> f64 {
        self.pi3 * (1.0 + largest_weight)
    }

    /// Returns the longest step in which no point of the axis of a free body that turns at a rate
    /// of at most `ω` travels further than a width: `2 r / (1 + h ω)`.
    #[must_use]
    pub fn longest_step(&self, largest_weight: f64) -> f64 {
        2.0 * self.radius() / (1.0 + self.half_length() * self.turning_rate_scale(largest_weight))
    }

    /// Returns the reach, the largest gap at which a step first lists a contact: `3 dt (1 + h ω)`
    /// body sizes.
    #[must_use]
    pub fn reach(&self, largest_weight: f64) -> f64 {
        let tip_speed = 1.0 + self.half_length() * self.turning_rate_scale(largest_weight);
        REACH_TRAVELS * self.dt * tip_speed
    }
}

/// Checks a number with the range of weights, such as the weight of an individual's preference.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`] with `field`, outside `[0, 1e6]` or not a number.
pub fn check_weight(field: &'static str, value: f64) -> Result<(), ParametersError> {
    if (0.0..=LARGEST_NUMBER).contains(&value) {
        return Ok(());
    }
    Err(ParametersError::OutOfRange {
        field,
        value,
        range: "[0, 1e6]",
    })
}

/// Checks the weight of a direction that an individual gets. Without a direction the weight is 0.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`], outside `[0, 1e6]` or not a number. Its range begins above 0, since
/// no individual is informed with weight 0.
pub fn check_preference(weight: f64) -> Result<(), ParametersError> {
    check_weight("weight", weight).map_err(|_| ParametersError::OutOfRange {
        field: "weight",
        value: weight,
        range: "(0, 1e6]",
    })
}

/// Checks a number that is a share.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`] with `field`, outside `[0, 1]` or not a number.
pub fn check_share(field: &'static str, value: f64) -> Result<(), ParametersError> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(ParametersError::OutOfRange {
        field,
        value,
        range: "[0, 1]",
    })
}

/// Checks an angle or a coordinate; beyond a million doubles no longer resolve a step.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`] with `field`, outside `[-1e6, 1e6]` or not a number.
pub fn check_coordinate(field: &'static str, value: f64) -> Result<(), ParametersError> {
    if (-LARGEST_NUMBER..=LARGEST_NUMBER).contains(&value) {
        return Ok(());
    }
    Err(ParametersError::OutOfRange {
        field,
        value,
        range: "[-1e6, 1e6]",
    })
}

/// Checks a number that only has to be finite.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`] with `field`, if it is infinite or not a number.
pub fn check_finite(field: &'static str, value: f64) -> Result<(), ParametersError> {
    if value.is_finite() {
        return Ok(());
    }
    Err(ParametersError::OutOfRange {
        field,
        value,
        range: "the finite numbers",
    })
}

#[cfg(test)]
mod tests;
