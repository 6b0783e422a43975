//! The dimensionless numbers of the model (Table 1), and what they imply.

use std::ops::RangeInclusive;

use thiserror::Error;

/// Which of a pair's contacts constrain a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ContactRule {
    /// Every smooth endpoint-to-segment distance that no smaller one implies.
    #[default]
    Endpoints,
    /// Of those the nearest alone; ties go to the lowest code. The literal reading of the
    /// paper's appendix, under which axes may come to cross.
    Closest,
    /// Those of `Endpoints` and also every two ends of which one is nearest to the other, though
    /// a smaller distance of the pair implies theirs. Not the model's: it is there to compare.
    Clamped,
}

/// What a contact limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stepping {
    /// The gap after the step, to first order: overlap is pushed out again, eq. (7).
    #[default]
    Position,
    /// The speed at which bodies that touch close, eq. (19): what overlap rounding and
    /// curvature leave stays, and adds up.
    Velocity,
}

/// Whom an individual is attracted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attraction {
    /// All the others, whatever their distance, eq. (4).
    All {
        /// How far off the mean of unit vectors may be, its largest possible length being 1;
        /// within [`ACCURACIES`]. Without one it is summed term by term. With one, a large
        /// group takes far groups as a whole, and the means no longer cancel to rounding. It
        /// is kept in one group of any shape; in far flocks the worst is up to 10 times it.
        accuracy: Option<f64>,
    },
    /// Those whose Voronoi cells share an edge of some length with one's own. At one place all
    /// share a cell, and are neighbours too.
    Voronoi,
    /// All within a distance, the distance itself included.
    Metric {
        /// The distance, in body sizes.
        radius: f64,
    },
    /// The nearest few; of those equally far the lower ids.
    Topological {
        /// How many.
        neighbours: u32,
    },
    /// All the others, each unit vector times a power of the distance.
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

/// The accuracies that can be asked for. A coarser one would hardly be quicker; a finer one
/// hardly quicker than the direct sum.
pub const ACCURACIES: RangeInclusive<f64> = 1e-9..=1e-3;

/// The exponents that can be asked for: beyond them only the nearest or the furthest would count.
pub const EXPONENTS: RangeInclusive<f64> = -8.0..=8.0;

/// What fixes the motion of a swarm, beside its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Length over width of a body; 1 is a disc.
    pub pi1: f64,
    /// Weight given to individuals informed without one.
    pub pi2: f64,
    /// Body size over turning radius.
    pub pi3: f64,
    /// Translational over rotational drag.
    pub pi4: f64,
    /// Duration of a step.
    pub dt: f64,
    /// Which contacts constrain a step.
    pub contacts: ContactRule,
    /// What a contact limits.
    pub stepping: Stepping,
    /// Whether a second program is solved, linearised about the first one's result.
    pub relinearise: bool,
    /// Whom an individual is attracted to.
    pub attraction: Attraction,
    /// `D_α`, the intensity of white noise on the turning rate: squared angle over time.
    pub noise: f64,
}

/// Why parameters are refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ParametersError {
    /// A number is outside its range, or not a number.
    #[error("{field} = {value:?} is outside {range}")]
    OutOfRange {
        /// The field's name.
        field: &'static str,
        /// The value refused.
        value: f64,
        /// The values allowed.
        range: &'static str,
    },
    /// A setting has no meaning beside another.
    #[error("{field} does not go with {other}: leave out one of them")]
    Clash {
        /// The setting refused.
        field: &'static str,
        /// What it clashes with.
        other: &'static str,
    },
    /// A free body could cross its own width in one step.
    #[error(
        "dt = {dt} is too long: with these parameters and weights at most {largest}; lower pi1, \
         pi3 or the weight, or create with a shorter dt"
    )]
    StepTooLong {
        /// The duration refused.
        dt: f64,
        /// The longest allowed with the other parameters and weights.
        largest: f64,
    },
}

/// The largest weight, turning and drag number. Far beyond any use, and small enough that no
/// product of them with positions overflows or drowns the free speed in rounding.
pub const LARGEST_NUMBER: f64 = 1e6;

/// The reach in free travels of one body. Two bodies close at most twice as fast as one
/// travels; half as much again leaves room for bodies that are pushed. It is a guess that only
/// saves work: the stepper looks again at whatever the actual displacements could have closed.
const REACH_TRAVELS: f64 = 3.0;

impl Default for Parameters {
    /// The values of Table 1 for the second series, at the length over width most used.
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
    /// Checks the numbers of a law.
    ///
    /// # Errors
    ///
    /// [`ParametersError::OutOfRange`].
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
    /// Checks every number, with `largest_weight` the largest weight present or about to be.
    ///
    /// # Errors
    ///
    /// [`ParametersError::OutOfRange`] names the first field outside its range, non-finite
    /// numbers included; [`ParametersError::Clash`] a setting without meaning; [`ParametersError::StepTooLong`] when `dt (1 + h ω) > 2r`.
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

    /// Half the length of a body's axis, `h = p r`.
    #[must_use]
    pub fn half_length(&self) -> f64 {
        (self.pi1 - 1.0) * self.radius()
    }

    /// The radius of the disc swept along the axis, `r = s / (2 (1 + p/2))`.
    #[must_use]
    pub fn radius(&self) -> f64 {
        1.0 / (1.0 + self.pi1)
    }

    /// The rotational drag, `ρ2 = s² ρ1 / π4`, with `ρ1 = 1`.
    #[must_use]
    pub fn rho2(&self) -> f64 {
        1.0 / self.pi4
    }

    /// The fastest free turning rate, `ω = π3 (1 + largest weight)`.
    #[must_use]
    pub fn fastest_turning_rate(&self, largest_weight: f64) -> f64 {
        self.pi3 * (1.0 + largest_weight)
    }

    /// The longest step in which no point of a free body's axis travels further than a width.
    #[must_use]
    pub fn longest_step(&self, largest_weight: f64) -> f64 {
        2.0 * self.radius() / (1.0 + self.half_length() * self.fastest_turning_rate(largest_weight))
    }

    /// How near a contact must be to be listed at first.
    #[must_use]
    pub fn reach(&self, largest_weight: f64) -> f64 {
        let tip_speed = 1.0 + self.half_length() * self.fastest_turning_rate(largest_weight);
        REACH_TRAVELS * self.dt * tip_speed
    }
}

/// Checks the weight of an individual's own preference.
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

/// Checks a share of something.
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

/// Checks an angle or a coordinate; beyond a million, doubles no longer resolve a step.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_of_four_widths_has_size_one() {
        let parameters = Parameters::default();
        assert!((parameters.radius() - 0.2).abs() < 1e-16);
        assert!((parameters.half_length() - 0.6).abs() < 1e-15);
        // The body size is the mean of length and width.
        let (h, r) = (parameters.half_length(), parameters.radius());
        assert!(((2.0 * (h + r) + 2.0 * r) / 2.0 - 1.0).abs() < 1e-15);
        assert!((parameters.rho2() - 0.1).abs() < 1e-16);
        assert!((parameters.fastest_turning_rate(0.5) - 1.5).abs() < 1e-15);
        assert!((parameters.reach(0.0) - 3.0 * 0.02 * 1.6).abs() < 1e-15);
        let disc = Parameters {
            pi1: 1.0,
            ..parameters
        };
        assert_eq!((disc.radius(), disc.half_length()), (0.5, 0.0));
    }

    #[test]
    fn every_field_is_refused_outside_its_range_and_accepted_at_its_ends() {
        let field_of = |parameters: Parameters, weight: f64| match parameters.check(weight) {
            Err(ParametersError::OutOfRange { field, .. }) => field,
            Err(ParametersError::StepTooLong { .. }) => "too long",
            Err(ParametersError::Clash { field, .. }) => field,
            Ok(()) => "",
        };
        let fine = Parameters {
            dt: 1e-9,
            ..Parameters::default()
        };
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 1.1e6] {
            assert_eq!(field_of(Parameters { pi1: bad, ..fine }, 0.0), "pi1");
            assert_eq!(field_of(Parameters { pi2: bad, ..fine }, 0.0), "pi2");
            assert_eq!(field_of(Parameters { pi3: bad, ..fine }, 0.0), "pi3");
            assert_eq!(field_of(Parameters { pi4: bad, ..fine }, 0.0), "pi4");
            assert_eq!(field_of(fine, bad), "weight");
            let refusal = if bad == 1.1e6 { "too long" } else { "dt" };
            assert_eq!(field_of(Parameters { dt: bad, ..fine }, 0.0), refusal);
        }
        assert_eq!(field_of(Parameters { pi3: 0.0, ..fine }, 0.0), "pi3");
        assert_eq!(field_of(Parameters { pi4: 0.0, ..fine }, 0.0), "pi4");
        assert_eq!(field_of(Parameters { dt: 0.0, ..fine }, 0.0), "dt");
        assert_eq!(field_of(Parameters { pi1: 0.999, ..fine }, 0.0), "pi1");
        assert_eq!(
            field_of(
                Parameters {
                    pi1: 32.001,
                    ..fine
                },
                0.0
            ),
            "pi1"
        );
        for pi1 in [1.0, 32.0] {
            assert_eq!(
                field_of(
                    Parameters {
                        pi1,
                        pi2: 0.0,
                        pi4: 1e6,
                        ..fine
                    },
                    0.0
                ),
                ""
            );
        }
    }

    #[test]
    fn the_numbers_of_an_attraction_law_have_ranges() {
        type Law = fn(f64) -> Attraction;
        let laws: [(&str, Law, &[f64], &[f64]); 3] = [
            (
                "attraction.accuracy",
                |value| Attraction::All {
                    accuracy: Some(value),
                },
                &[-1e-6, 0.0, 0.99e-9, 1.01e-3],
                &[1e-9, 2.5e-6, 1e-3],
            ),
            (
                "attraction.radius",
                |radius| Attraction::Metric { radius },
                &[-1.0, 0.0, 1.1e6],
                &[1e-9, 3.0, 1e6],
            ),
            (
                "attraction.exponent",
                |exponent| Attraction::Power { exponent },
                &[-8.1, 8.1],
                &[-8.0, 0.0, 8.0],
            ),
        ];
        let check = |attraction| {
            let parameters = Parameters {
                attraction,
                ..Parameters::default()
            };
            parameters.check(0.0)
        };
        for (name, law, bad, fine) in laws {
            for &bad in bad.iter().chain(&[f64::NAN, f64::INFINITY]) {
                let refusal = check(law(bad));
                assert!(
                    matches!(refusal, Err(ParametersError::OutOfRange { field, .. }) if field == name),
                    "{refusal:?}"
                );
            }
            for &fine in fine {
                assert_eq!(check(law(fine)), Ok(()));
            }
        }
        assert!(check(Attraction::Topological { neighbours: 0 }).is_err());
        assert_eq!(check(Attraction::Topological { neighbours: 1 }), Ok(()));
        assert_eq!(check(Attraction::Voronoi), Ok(()));
    }

    #[test]
    fn noise_has_a_range_and_velocities_are_not_linearised_twice() {
        for noise in [-1e-9, f64::NAN, f64::INFINITY, 1.1e6] {
            let parameters = Parameters {
                noise,
                ..Parameters::default()
            };
            assert!(parameters.check(0.0).is_err());
        }
        let clash = Parameters {
            stepping: Stepping::Velocity,
            relinearise: true,
            ..Parameters::default()
        };
        assert!(matches!(
            clash.check(0.0),
            Err(ParametersError::Clash { .. })
        ));
        for (stepping, relinearise) in [(Stepping::Velocity, false), (Stepping::Position, true)] {
            let fine = Parameters {
                stepping,
                relinearise,
                ..clash
            };
            assert_eq!(fine.check(0.0), Ok(()));
        }
    }

    #[test]
    fn a_step_may_carry_a_tip_one_width_and_no_further() {
        let at = |dt, weight| {
            Parameters {
                dt,
                ..Parameters::default()
            }
            .check(weight)
        };
        let largest = Parameters::default().longest_step(0.0);
        assert!((largest - 0.4 / 1.6).abs() < 1e-15);
        assert_eq!(at(largest, 0.0), Ok(()));
        let dt = largest * 1.0001;
        assert_eq!(
            at(dt, 0.0),
            Err(ParametersError::StepTooLong { dt, largest })
        );
        assert!(at(largest, 0.5).is_err(), "a larger weight turns faster");
    }
}
