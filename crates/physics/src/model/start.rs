//! The start of a swarm: drawn at random in a disc, or given as columns.

use std::f64::consts::TAU;

use thiserror::Error;

use super::body::{Body, Pose, near_pairs};
use super::parameters::{LARGEST_NUMBER, check_coordinate};
use super::random::{Purpose, Stream};
use super::{Configuration, Parameters, ParametersError};

/// Maximum number of draws of one individual; after them the disc counts as full. If one draw in a
/// thousand fits, all ten thousand fail with a probability of 5e-5.
pub const TRIES: u32 = 10_000;

/// Why a start is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum StartError {
    /// The parameters, or a number of the start, are outside their range.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// The number of individuals is 0, or larger than the number of ids.
    #[error("n = {n} is outside [1, 4294967294]")]
    Count {
        /// The number requested.
        n: usize,
    },
    /// The columns of a given start differ in length.
    #[error("{x} values of x, {y} of y and {alpha} of alpha are not the same number")]
    Lengths {
        /// Length of x.
        x: usize,
        /// Length of y.
        y: usize,
        /// Length of alpha.
        alpha: usize,
    },
    /// No position without overlap was found for one of the individuals.
    #[error(
        "only {placed} of {n} fit in a disc of radius {radius}: the next found no place in {tries} \
         tries; make it larger, or n smaller"
    )]
    NoRoom {
        /// Number of individuals placed.
        placed: usize,
        /// The number requested.
        n: usize,
        /// The disc's radius, in body sizes.
        radius: f64,
        /// Number of draws of the next individual.
        tries: u32,
    },
    /// Two axes of a given start cross.
    #[error("start: the axes of individuals {first} and {second} cross; move them apart")]
    Crossed {
        /// Index of the first of the pair.
        first: u32,
        /// Index of the second of the pair.
        second: u32,
    },
    /// Two bodies of a given start overlap by more than is allowed.
    #[error("individuals {first} and {second} overlap: their gap {gap} is below {smallest}")]
    Overlap {
        /// Index of the first of the pair.
        first: u32,
        /// Index of the second of the pair.
        second: u32,
        /// Their gap, in body sizes.
        gap: f64,
        /// The smallest gap allowed: minus half a radius.
        smallest: f64,
    },
}

/// Returns the default radius of the disc in which `n` individuals start, `max(1, √n)` body sizes.
#[must_use]
pub fn default_disc_radius(n: usize) -> f64 {
    (n as f64).sqrt().max(1.0)
}

/// Draws `n` individuals without overlap: centres uniform in a disc, headings uniform.
///
/// Individuals are placed one after the other; each is drawn again while it overlaps an earlier
/// one. Without a `radius`, [`default_disc_radius`] is used.
///
/// # Errors
///
/// [`StartError::NoRoom`] after [`TRIES`] draws of one individual; [`StartError::Count`] or
/// [`StartError::Parameters`] for a number outside its range.
pub fn disc(
    parameters: &Parameters,
    n: usize,
    radius: Option<f64>,
    seed: u64,
) -> Result<Configuration, StartError> {
    parameters.check(0.0)?;
    check_count(n)?;
    let radius = radius.unwrap_or_else(|| default_disc_radius(n));
    if !(radius > 0.0 && radius <= LARGEST_NUMBER) {
        let (field, value, range) = ("start.radius", radius, "(0, 1e6]");
        return Err(ParametersError::OutOfRange {
            field,
            value,
            range,
        }
        .into());
    }
    let body = Body::new(parameters);
    let mut grid = Grid::new(radius, body.centre_distance(0.0), n);
    let mut configuration = Configuration::default();
    for individual in 0..n {
        let mut stream = Stream::new(seed, 0, individual as u64, Purpose::Start);
        let fits = |pose: &Pose| {
            grid.near(pose)
                .all(|other| body.nearness(*pose, *other).gap >= 0.0)
        };
        let Some(pose) = (0..TRIES)
            .map(|_| draw_in_disc(&mut stream, radius))
            .find(fits)
        else {
            return Err(StartError::NoRoom {
                placed: individual,
                n,
                radius,
                tries: TRIES,
            });
        };
        grid.insert(pose);
        configuration.push(pose.x, pose.y, pose.alpha);
    }
    Ok(configuration)
}

/// Builds a configuration from given columns, bit for bit.
///
/// - Shapes: n values each of `x`, `y` and `alpha`.
/// - Units: body sizes and radians.
///
/// # Errors
///
/// When a parameter is outside its range, the columns differ in length or are empty, a number is
/// not finite or its size exceeds a million, two axes cross, or a gap is below minus half a radius.
pub fn given(
    parameters: &Parameters,
    x: &[f64],
    y: &[f64],
    alpha: &[f64],
) -> Result<Configuration, StartError> {
    parameters.check(0.0)?;
    if x.len() != y.len() || x.len() != alpha.len() {
        return Err(StartError::Lengths {
            x: x.len(),
            y: y.len(),
            alpha: alpha.len(),
        });
    }
    check_count(x.len())?;
    let mut configuration = Configuration::default();
    for ((&x, &y), &alpha) in x.iter().zip(y).zip(alpha) {
        check_coordinate("start.x", x)?;
        check_coordinate("start.y", y)?;
        check_coordinate("start.alpha", alpha)?;
        configuration.push(x, y, alpha);
    }
    let smallest = -parameters.radius() / 2.0;
    for (first, second, nearness) in near_pairs(Body::new(parameters), &configuration, 0.0) {
        if nearness.crossed {
            return Err(StartError::Crossed { first, second });
        }
        if nearness.gap < smallest {
            return Err(StartError::Overlap {
                first,
                second,
                gap: nearness.gap,
                smallest,
            });
        }
    }
    Ok(configuration)
}

/// Draws a pose: the centre uniform in a disc about (0, 0), the heading uniform.
pub(super) fn draw_in_disc(stream: &mut Stream, radius: f64) -> Pose {
    let distance = radius * stream.uniform().sqrt();
    let (sin, cos) = libm::sincos(TAU * stream.uniform());
    Pose {
        x: distance * cos,
        y: distance * sin,
        alpha: TAU * stream.uniform(),
    }
}

fn check_count(n: usize) -> Result<(), StartError> {
    // The last ids are not assigned, so that a next id always exists.
    if (1..u32::MAX as usize).contains(&n) {
        return Ok(());
    }
    Err(StartError::Count { n })
}

/// Square cells, no smaller than the distance of centres at which two bodies can touch, so that a
/// cell and its eight neighbours hold all bodies that can overlap one in it.
struct Grid {
    cells: Vec<Vec<Pose>>,
    side: usize,
    radius: f64,
    cell: f64,
}

impl Grid {
    fn new(radius: f64, nearest: f64, n: usize) -> Self {
        // At most a few cells per individual, for any radius of the disc.
        let cell = nearest.max(2.0 * radius / (2.0 * (n as f64).sqrt() + 1.0));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most 2 √n + 2"
        )]
        let side = (2.0 * radius / cell) as usize + 1;
        Self {
            cells: vec![Vec::new(); side * side],
            side,
            radius,
            cell,
        }
    }

    fn place(&self, pose: &Pose) -> [usize; 2] {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a pose in the disc has an index below `side`; a negative number casts to 0"
        )]
        [pose.x, pose.y].map(|value| ((value + self.radius) / self.cell) as usize)
    }

    fn near(&self, pose: &Pose) -> impl Iterator<Item = &Pose> {
        let [column, row] = self.place(pose);
        let range = |k: usize| k.saturating_sub(1)..(k + 2).min(self.side);
        range(column)
            .flat_map(move |column| range(row).map(move |row| column * self.side + row))
            .flat_map(|cell| &self.cells[cell])
    }

    fn insert(&mut self, pose: Pose) {
        let [column, row] = self.place(&pose);
        self.cells[column * self.side + row].push(pose);
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::model::body::{gaps, worst_gap};

    #[test]
    fn a_drawn_start_has_no_overlap_and_stays_in_its_disc() {
        for (pi1, n, seed) in [(1.0, 50, 1), (4.0, 74, 2), (32.0, 30, 3), (4.0, 1, 4)] {
            let parameters = Parameters {
                pi1,
                ..Parameters::default()
            };
            let configuration = disc(&parameters, n, None, seed).unwrap();
            assert_eq!(
                configuration.id,
                (0..u32::try_from(n).unwrap()).collect::<Vec<_>>()
            );
            assert!(worst_gap(&parameters, &configuration).is_none_or(|gap| gap >= 0.0));
            let radius = default_disc_radius(n);
            for (x, y) in configuration.x.iter().zip(&configuration.y) {
                assert!(x.hypot(*y) <= radius * (1.0 + 1e-15));
            }
            assert_eq!(disc(&parameters, n, None, seed).unwrap(), configuration);
            assert_ne!(
                disc(&parameters, n, None, seed + 100).unwrap(),
                configuration
            );
        }
    }

    #[test]
    fn a_start_of_a_hundred_thousand_is_quick() {
        // A search of all pairs would take minutes; the grid takes a fraction of a second.
        let configuration = disc(&Parameters::default(), 100_000, None, 1).unwrap();
        assert_eq!(gaps(&Parameters::default(), &configuration).crossed, 0);
        assert!(worst_gap(&Parameters::default(), &configuration).unwrap() >= 0.0);
    }

    #[test]
    fn a_wide_disc_costs_no_memory() {
        assert_eq!(
            disc(&Parameters::default(), 2, Some(1e6), 1).unwrap().n(),
            2
        );
    }

    #[test]
    fn the_error_of_a_full_disc_has_the_numbers() {
        let error = disc(&Parameters::default(), 50, Some(1.0), 1).unwrap_err();
        let StartError::NoRoom {
            placed,
            n: 50,
            radius: 1.0,
            tries: TRIES,
        } = error
        else {
            panic!("{error}");
        };
        assert!((2..12).contains(&placed), "{placed}");
    }

    #[test]
    fn a_disc_of_an_invalid_count_or_radius_is_rejected() {
        let parameters = Parameters::default();
        assert_eq!(
            disc(&parameters, 0, None, 1),
            Err(StartError::Count { n: 0 })
        );
        let too_many = u32::MAX as usize;
        assert_eq!(
            disc(&parameters, too_many, None, 1),
            Err(StartError::Count { n: too_many })
        );
        for radius in [0.0, -1.0, f64::NAN, 1.1e6] {
            let error = disc(&parameters, 3, Some(radius), 1).unwrap_err();
            assert!(error.to_string().starts_with("start.radius"), "{error}");
        }
        let parameters = Parameters {
            pi3: 0.0,
            ..parameters
        };
        assert!(matches!(
            disc(&parameters, 3, None, 1),
            Err(StartError::Parameters(_))
        ));
    }

    #[test]
    fn a_given_start_keeps_every_bit() {
        let columns = ([0.1 + 0.2, -1e6], [1e-300, 1e6], [-270.02419291642303, 1e6]);
        let configuration =
            given(&Parameters::default(), &columns.0, &columns.1, &columns.2).unwrap();
        assert_eq!(
            (&configuration.x[..], &configuration.y[..]),
            (&columns.0[..], &columns.1[..])
        );
        assert_eq!(configuration.alpha, columns.2);
        assert_eq!((configuration.origin, configuration.next_id), ([0, 0], 2));
    }

    #[test]
    fn a_given_start_may_overlap_by_half_a_radius_and_never_cross() {
        let at = |y: f64, alpha: f64| {
            given(
                &Parameters::default(),
                &[0.0, 0.0],
                &[0.0, y],
                &[0.0, alpha],
            )
        };
        assert!(at(0.3 + 1e-12, 0.0).is_ok());
        let error = at(0.3 - 1e-12, 0.0).unwrap_err();
        assert!(
            matches!(error, StartError::Overlap { first: 0, second: 1, gap, .. } if gap < -0.1)
        );
        assert_eq!(
            at(0.3, 1.5),
            Err(StartError::Crossed {
                first: 0,
                second: 1
            })
        );
    }

    #[test]
    fn an_invalid_given_start_is_rejected() {
        let parameters = Parameters::default();
        let start =
            |x: &[f64], y: &[f64], alpha: &[f64]| given(&parameters, x, y, alpha).unwrap_err();
        assert_eq!(start(&[], &[], &[]), StartError::Count { n: 0 });
        assert_eq!(
            start(&[0.0], &[], &[1.0, 2.0]),
            StartError::Lengths {
                x: 1,
                y: 0,
                alpha: 2
            }
        );
        for bad in [f64::NAN, f64::INFINITY, -1.1e6] {
            assert!(
                start(&[bad], &[0.0], &[0.0])
                    .to_string()
                    .starts_with("start.x")
            );
            assert!(
                start(&[0.0], &[bad], &[0.0])
                    .to_string()
                    .starts_with("start.y")
            );
            assert!(
                start(&[0.0], &[0.0], &[bad])
                    .to_string()
                    .starts_with("start.alpha")
            );
        }
    }
}
