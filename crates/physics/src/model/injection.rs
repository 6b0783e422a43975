//! Adding individuals to a running swarm, without overlap.

use std::f64::consts::TAU;

use thiserror::Error;

pub use super::body::Pose;
use super::body::{Body, pose};
use super::parameters::{LARGEST_NUMBER, check_coordinate, check_finite, check_preference};
use super::random::{Purpose, Stream};
use super::start::draw_in_disc;
use super::{CELL, Configuration, Parameters, ParametersError};

/// Maximum number of draws of one individual; after them a region counts as full.
pub const TRIES: u32 = 10_000;

/// Largest gap, in body sizes, at which an individual that is slid in from outside stops: far
/// above rounding and far below the distance by which bodies approach each other in a step.
const BORDER_GAP: f64 = 1e-3;

/// A disc in absolute coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Centre.
    pub x: f64,
    /// Centre.
    pub y: f64,
    /// Radius.
    pub radius: f64,
}

/// The key of a command's draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    /// The swarm's seed.
    pub seed: u64,
    /// The command's number.
    pub seq: u64,
}

/// Why an injection is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InjectionError {
    /// A number is outside its range, or the weight requires a shorter step.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// A number of a pose is outside its range.
    #[error("pose {index}: {error}")]
    Pose {
        /// Index of the pose.
        index: usize,
        /// The number, its value and its range.
        error: ParametersError,
    },
    /// The number of individuals is 0, or larger than the number of ids left.
    #[error("count = {count} is outside [1, {largest}]")]
    Count {
        /// The number requested.
        count: usize,
        /// Number of ids left.
        largest: u32,
    },
    /// A pose overlaps an individual or an earlier pose.
    #[error("pose {index} overlaps: its gap is {gap}")]
    Overlap {
        /// Index of the pose.
        index: usize,
        /// Its smallest gap, in body sizes.
        gap: f64,
    },
    /// No position without overlap was found for one of the individuals.
    #[error(
        "only {placed} of {count} fit in the region: the next found no place in {tries} tries; \
         make it larger, or count smaller"
    )]
    NoRoom {
        /// Number of individuals placed.
        placed: usize,
        /// The number requested.
        count: usize,
        /// Number of draws of the next individual.
        tries: u32,
    },
}

/// Adds individuals at the given poses, in absolute coordinates, and returns their ids.
///
/// # Errors
///
/// [`InjectionError::Overlap`] for the first pose whose gap to an individual or an earlier pose is
/// below 0; another variant for a number outside its range. On an error nothing is changed.
pub fn at(
    parameters: &Parameters,
    configuration: &mut Configuration,
    poses: &[Pose],
    weight: f64,
    direction: f64,
    lapses_at: Option<u64>,
) -> Result<Vec<u32>, InjectionError> {
    check(parameters, configuration, poses.len(), weight, direction)?;
    check_poses(poses)?;
    let body = Body::new(parameters);
    let mut placed = Vec::with_capacity(poses.len());
    let mut others = all_poses(configuration);
    for (index, given) in poses.iter().enumerate() {
        let [x, y] = relative(configuration, ["x", "y"], [given.x, given.y])
            .map_err(|error| InjectionError::Pose { index, error })?;
        let pose = Pose {
            x,
            y,
            alpha: given.alpha,
        };
        let gap = gap_to_nearest(body, &others, pose);
        if gap < 0.0 {
            return Err(InjectionError::Overlap { index, gap });
        }
        others.push(pose);
        placed.push(pose);
    }
    Ok(add(configuration, &placed, weight, direction, lapses_at))
}

/// Adds `count` individuals at the border of the group and returns their ids. Each starts outside,
/// on a random bearing from the centroid and with a random heading, and is slid inwards until it
/// nearly touches another body.
///
/// # Errors
///
/// When a number is outside its range. On an error nothing is changed.
pub fn at_border(
    parameters: &Parameters,
    configuration: &mut Configuration,
    count: usize,
    weight: f64,
    direction: f64,
    draw: Draw,
) -> Result<Vec<u32>, InjectionError> {
    check(parameters, configuration, count, weight, direction)?;
    let body = Body::new(parameters);
    let centroid = configuration.centroid();
    let mut others = all_poses(configuration);
    let mut placed = Vec::with_capacity(count);
    for individual in 0..count {
        let mut stream = Stream::new(draw.seed, draw.seq, individual as u64, Purpose::Injection);
        let (bearing, alpha) = (TAU * stream.uniform(), TAU * stream.uniform());
        let pose = slide_inwards(body, &others, centroid, bearing, alpha);
        others.push(pose);
        placed.push(pose);
    }
    Ok(add(configuration, &placed, weight, direction, None))
}

/// Adds `count` individuals in a region and returns their ids: centres uniform in the region,
/// headings uniform. Each individual is drawn again while it overlaps another.
///
/// # Errors
///
/// [`InjectionError::NoRoom`] after [`TRIES`] draws of one individual; another variant for a
/// number outside its range. On an error nothing is changed.
pub fn within(
    parameters: &Parameters,
    configuration: &mut Configuration,
    count: usize,
    region: Region,
    weight: f64,
    direction: f64,
    draw: Draw,
) -> Result<Vec<u32>, InjectionError> {
    check(parameters, configuration, count, weight, direction)?;
    check_region(region)?;
    let [x, y] = relative(
        configuration,
        ["within.x", "within.y"],
        [region.x, region.y],
    )?;
    let body = Body::new(parameters);
    let nearby = region.radius + body.centre_distance(0.0);
    let mut others = all_poses(configuration);
    others.retain(|other| (other.x - x).abs() <= nearby && (other.y - y).abs() <= nearby);
    let mut placed = Vec::with_capacity(count);
    for individual in 0..count {
        let mut stream = Stream::new(draw.seed, draw.seq, individual as u64, Purpose::Injection);
        let draw_one = |_| {
            let drawn = draw_in_disc(&mut stream, region.radius);
            Pose {
                x: x + drawn.x,
                y: y + drawn.y,
                ..drawn
            }
        };
        let fits = |pose: &Pose| gap_to_nearest(body, &others, *pose) >= 0.0;
        let Some(pose) = (0..TRIES).map(draw_one).find(fits) else {
            return Err(InjectionError::NoRoom {
                placed: individual,
                count,
                tries: TRIES,
            });
        };
        others.push(pose);
        placed.push(pose);
    }
    Ok(add(configuration, &placed, weight, direction, None))
}

/// Checks the numbers of poses that no swarm accepts, whatever its individuals are.
///
/// # Errors
///
/// [`InjectionError::Pose`] with the first pose.
pub fn check_poses(poses: &[Pose]) -> Result<(), InjectionError> {
    for (index, pose) in poses.iter().enumerate() {
        check_coordinate("alpha", pose.alpha)
            .and_then(|()| check_finite("x", pose.x))
            .and_then(|()| check_finite("y", pose.y))
            .map_err(|error| InjectionError::Pose { index, error })?;
    }
    Ok(())
}

/// Checks the numbers of a region that no swarm accepts, whatever its individuals are.
///
/// # Errors
///
/// [`InjectionError::Parameters`].
pub fn check_region(region: Region) -> Result<(), InjectionError> {
    check_radius("within.radius", region.radius)?;
    check_finite("within.x", region.x)?;
    check_finite("within.y", region.y)?;
    Ok(())
}

/// Checks a region's radius.
pub(super) fn check_radius(field: &'static str, radius: f64) -> Result<(), ParametersError> {
    if radius > 0.0 && radius <= LARGEST_NUMBER {
        return Ok(());
    }
    Err(ParametersError::OutOfRange {
        field,
        value: radius,
        range: "(0, 1e6]",
    })
}

fn check(
    parameters: &Parameters,
    configuration: &Configuration,
    count: usize,
    weight: f64,
    direction: f64,
) -> Result<(), InjectionError> {
    // The last ids are not assigned, so that a next id always exists.
    let largest = u32::MAX - 1 - configuration.next_id.min(u32::MAX - 1);
    if !u32::try_from(count).is_ok_and(|count| (1..=largest).contains(&count)) {
        return Err(InjectionError::Count { count, largest });
    }
    check_preference(weight)?;
    check_coordinate("direction", direction)?;
    parameters.check(configuration.largest_weight().max(weight))?;
    Ok(())
}

/// Converts an absolute position to one relative to the origin.
///
/// # Errors
///
/// [`ParametersError::OutOfRange`] if it is too far from the origin, where doubles no longer
/// resolve a step.
fn relative(
    configuration: &Configuration,
    fields: [&'static str; 2],
    absolute: [f64; 2],
) -> Result<[f64; 2], ParametersError> {
    let relative = configuration.relative(absolute);
    for axis in 0..2 {
        if check_coordinate(fields[axis], relative[axis]).is_err() {
            let range = "the numbers within 1e6 body sizes of the group's origin";
            return Err(ParametersError::OutOfRange {
                field: fields[axis],
                value: absolute[axis],
                range,
            });
        }
    }
    Ok(relative)
}

fn all_poses(configuration: &Configuration) -> Vec<Pose> {
    (0..configuration.n())
        .map(|index| pose(configuration, index))
        .collect()
}

/// Returns the smallest gap between `pose` and those of `others` that are near enough to touch
/// it; infinity if none is.
fn gap_to_nearest(body: Body, others: &[Pose], pose: Pose) -> f64 {
    let near = body.centre_distance(CELL / 2.0 * f64::EPSILON);
    others
        .iter()
        .filter(|other| (other.x - pose.x).abs() <= near && (other.y - pose.y).abs() <= near)
        .map(|other| body.nearness(pose, *other).gap)
        .fold(f64::INFINITY, f64::min)
}

/// Slides a body from outside the group along `bearing` towards `centre` until it nearly touches
/// another. Each advance is shorter than the smallest gap, so the body neither overlaps nor passes
/// through another.
fn slide_inwards(body: Body, others: &[Pose], centre: [f64; 2], bearing: f64, alpha: f64) -> Pose {
    let (sin, cos) = libm::sincos(bearing);
    let near = body.centre_distance(0.0);
    let in_the_way: Vec<(f64, Pose)> = others
        .iter()
        .map(|other| (other.x - centre[0], other.y - centre[1], *other))
        .filter(|(dx, dy, _)| (dy * cos - dx * sin).abs() <= near)
        .map(|(dx, dy, other)| (dx * cos + dy * sin, other))
        .collect();
    let furthest = in_the_way
        .iter()
        .fold(0.0, |far, (along, _)| f64::max(far, *along));
    let place = |distance: f64| Pose {
        x: centre[0] + distance * cos,
        y: centre[1] + distance * sin,
        alpha,
    };
    let mut distance = furthest + near + BORDER_GAP;
    // Bodies further than `2 near` away have a gap above `near`, the longest advance.
    loop {
        let gap = in_the_way
            .iter()
            .filter(|(along, _)| (along - distance).abs() <= 2.0 * near)
            .map(|(_, other)| body.nearness(place(distance), *other).gap)
            .fold(near, f64::min);
        // Next to the centre the body stops without touching another: it passed through a hole in
        // a ring of bodies.
        if gap <= BORDER_GAP || distance <= gap {
            return place(distance);
        }
        distance -= gap - BORDER_GAP / 2.0;
    }
}

fn add(
    configuration: &mut Configuration,
    poses: &[Pose],
    weight: f64,
    direction: f64,
    lapses_at: Option<u64>,
) -> Vec<u32> {
    poses
        .iter()
        .map(|pose| {
            let id = configuration.push(pose.x, pose.y, pose.alpha);
            configuration.inform(configuration.n() - 1, weight, direction, lapses_at);
            id
        })
        .collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
