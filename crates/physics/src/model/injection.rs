//! Adding individuals to a running swarm, without overlap.

use std::f64::consts::TAU;

use thiserror::Error;

pub use super::body::Pose;
use super::body::{Body, pose};
use super::parameters::{check_coordinate, check_weight};
use super::random::{Purpose, Stream};
use super::start::draw_in_disc;
use super::{CELL, Configuration, Parameters, ParametersError};

/// How often one individual is drawn again before a region counts as full.
pub const TRIES: u32 = 10_000;

/// How close to another body an individual comes to rest at the border: a thousandth of a body,
/// far above rounding and far below what a step closes.
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

/// What a command's draws are keyed by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    /// The swarm's seed.
    pub seed: u64,
    /// The command's number.
    pub seq: u64,
}

/// Why an injection is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InjectionError {
    /// A number is outside its range, or the weight needs a shorter step.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// A number of a pose is outside its range.
    #[error("pose {index}: {error}")]
    Pose {
        /// Which pose.
        index: usize,
        /// Which number.
        error: ParametersError,
    },
    /// Nobody was to be injected, or more than ids are left.
    #[error("count = {count} is outside [1, {largest}]")]
    Count {
        /// How many were asked for.
        count: usize,
        /// How many ids are left.
        largest: u32,
    },
    /// A pose overlaps somebody, or an earlier pose.
    #[error("pose {index} overlaps: its gap is {gap}")]
    Overlap {
        /// Which pose.
        index: usize,
        /// Its smallest gap.
        gap: f64,
    },
    /// No place was found for everybody.
    #[error(
        "only {placed} of {count} fit in the region: the next found no place in {tries} tries; make it larger, or count smaller"
    )]
    NoRoom {
        /// How many had a place.
        placed: usize,
        /// How many were asked for.
        count: usize,
        /// How often the next was drawn.
        tries: u32,
    },
}

/// Adds individuals where told, in absolute positions, and returns their ids.
///
/// # Errors
///
/// [`InjectionError::Overlap`] names the first pose without a gap of at least 0 to everybody;
/// otherwise whichever number is outside its range. Nothing has changed then.
pub fn at(
    parameters: &Parameters,
    configuration: &mut Configuration,
    poses: &[Pose],
    weight: f64,
    direction: f64,
    lapses_at: Option<u64>,
) -> Result<Vec<u32>, InjectionError> {
    check(parameters, configuration, poses.len(), weight, direction)?;
    let body = Body::new(parameters);
    let mut placed = Vec::with_capacity(poses.len());
    let mut others = all_poses(configuration);
    for (index, given) in poses.iter().enumerate() {
        let [x, y] = check_coordinate("alpha", given.alpha)
            .and_then(|()| relative(configuration, ["x", "y"], [given.x, given.y]))
            .map_err(|error| InjectionError::Pose { index, error })?;
        let pose = Pose {
            x,
            y,
            alpha: given.alpha,
        };
        let gap = smallest_gap(body, &others, pose);
        if gap < 0.0 {
            return Err(InjectionError::Overlap { index, gap });
        }
        others.push(pose);
        placed.push(pose);
    }
    Ok(add(configuration, &placed, weight, direction, lapses_at))
}

/// Adds `count` individuals outside the group, as close as each fits: on a random bearing from
/// the centroid and with a random heading, slid inwards until it would touch.
///
/// # Errors
///
/// When a number is outside its range. Nothing has changed then.
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

/// Adds `count` individuals in a region: centres uniform in it, headings uniform, each drawn
/// again while it overlaps.
///
/// # Errors
///
/// [`InjectionError::NoRoom`] after [`TRIES`] draws of one individual; otherwise whichever
/// number is outside its range. Nothing has changed then.
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
    check_radius("within.radius", region.radius)?;
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
        let fits = |pose: &Pose| smallest_gap(body, &others, *pose) >= 0.0;
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

/// Checks a region's radius.
pub(super) fn check_radius(field: &'static str, radius: f64) -> Result<(), ParametersError> {
    check_coordinate(field, radius)?;
    if radius > 0.0 {
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
    // The last id stays free, so that the next id can always be told.
    let largest = u32::MAX - 1 - configuration.next_id.min(u32::MAX - 1);
    if !u32::try_from(count).is_ok_and(|count| (1..=largest).contains(&count)) {
        return Err(InjectionError::Count { count, largest });
    }
    check_weight("weight", weight)?;
    check_coordinate("direction", direction)?;
    parameters.check(configuration.largest_weight().max(weight))?;
    Ok(())
}

/// Takes an absolute position relative to the origin; far from the group doubles would no
/// longer resolve a step.
fn relative(
    configuration: &Configuration,
    fields: [&'static str; 2],
    absolute: [f64; 2],
) -> Result<[f64; 2], ParametersError> {
    let relative = configuration.relative(absolute);
    for axis in 0..2 {
        if check_coordinate(fields[axis], relative[axis]).is_err() {
            let range = "1e6 body sizes of the group's origin";
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

/// The smallest gap of `pose` to those of `others` near enough to touch it.
fn smallest_gap(body: Body, others: &[Pose], pose: Pose) -> f64 {
    let near = body.centre_distance(CELL / 2.0 * f64::EPSILON);
    others
        .iter()
        .filter(|other| (other.x - pose.x).abs() <= near && (other.y - pose.y).abs() <= near)
        .map(|other| body.nearness(pose, *other).gap)
        .fold(f64::INFINITY, f64::min)
}

/// Slides a body from far along `bearing` towards `centre` until it all but touches another.
/// Advancing by the smallest gap each time can neither overshoot nor pass through anybody.
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
    // Bodies further than two reaches away leave room for one, the longest slide at a time.
    loop {
        let gap = in_the_way
            .iter()
            .filter(|(along, _)| (along - distance).abs() <= 2.0 * near)
            .map(|(_, other)| body.nearness(place(distance), *other).gap)
            .fold(near, f64::min);
        // At the centre a ring of bodies has been passed through a hole; it is as close as can be.
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
mod tests {
    use super::*;
    use crate::model::body::worst_gap;
    use crate::model::start::disc;

    const DRAW: Draw = Draw { seed: 3, seq: 4 };

    fn group() -> (Parameters, Configuration) {
        let parameters = Parameters::default();
        (parameters, disc(&parameters, 30, None, 5).unwrap())
    }

    #[test]
    fn individuals_appear_where_told_however_far_the_group_has_travelled() {
        let (parameters, mut configuration) = group();
        configuration.origin = [2, -1];
        let pose = Pose {
            x: 2048.0 + 8.5,
            y: -1024.0 - 9.25,
            alpha: 1.0,
        };
        let ids = at(&parameters, &mut configuration, &[pose], 0.5, 2.0, Some(7)).unwrap();
        assert_eq!(ids, [30]);
        assert_eq!((configuration.x[30], configuration.y[30]), (8.5, -9.25));
        assert_eq!(
            (configuration.weight[30], configuration.direction[30]),
            (0.5, 2.0)
        );
        assert_eq!(configuration.lapses_at[30], Some(7));
    }

    #[test]
    fn a_pose_that_overlaps_is_named_and_nothing_changes() {
        let (parameters, mut configuration) = group();
        let before = configuration.clone();
        let free = Pose {
            x: 20.0,
            y: 20.0,
            alpha: 0.0,
        };
        let mut inject =
            |poses: &[Pose]| at(&parameters, &mut configuration, poses, 0.0, 0.0, None);
        let on_somebody = Pose {
            x: before.x[3],
            y: before.y[3],
            alpha: 0.1,
        };
        let refusal = inject(&[free, on_somebody]).unwrap_err();
        assert!(matches!(refusal, InjectionError::Overlap { index: 1, gap } if gap < 0.0));
        let refusal = inject(&[free, Pose { y: 20.3, ..free }]).unwrap_err();
        assert!(
            matches!(refusal, InjectionError::Overlap { index: 1, gap } if (gap + 0.1).abs() < 1e-12)
        );
        for bad in [f64::NAN, f64::INFINITY, 2e6] {
            for pose in [
                Pose { x: bad, ..free },
                Pose { y: bad, ..free },
                Pose { alpha: bad, ..free },
            ] {
                assert!(matches!(
                    inject(&[free, pose]),
                    Err(InjectionError::Pose { index: 1, .. })
                ));
            }
        }
        assert!(matches!(
            inject(&[]),
            Err(InjectionError::Count { count: 0, .. })
        ));
        assert_eq!(configuration, before);
    }

    #[test]
    fn weights_directions_and_ids_are_checked_at_every_door() {
        let (parameters, mut configuration) = group();
        configuration.next_id = u32::MAX - 3;
        let before = configuration.clone();
        let region = Region {
            x: 0.0,
            y: 0.0,
            radius: 50.0,
        };
        for (count, weight, direction) in [
            (3, 0.5, 0.0),
            (1, f64::NAN, 0.0),
            (1, -0.1, 0.0),
            (1, 0.5, f64::NAN),
            (1, 1e3, 0.0),
            (0, 0.5, 0.0),
        ] {
            let poses = vec![
                Pose {
                    x: 30.0,
                    y: 0.0,
                    alpha: 0.0
                };
                count
            ];
            assert!(
                at(
                    &parameters,
                    &mut configuration,
                    &poses,
                    weight,
                    direction,
                    None
                )
                .is_err()
            );
            assert!(
                at_border(
                    &parameters,
                    &mut configuration,
                    count,
                    weight,
                    direction,
                    DRAW
                )
                .is_err()
            );
            assert!(
                within(
                    &parameters,
                    &mut configuration,
                    count,
                    region,
                    weight,
                    direction,
                    DRAW
                )
                .is_err()
            );
        }
        assert_eq!(configuration, before);
        assert!(at_border(&parameters, &mut configuration, 2, 0.5, 0.0, DRAW).is_ok());
    }

    #[test]
    fn at_the_border_they_all_but_touch() {
        for pi1 in [1.0, 4.0, 32.0] {
            let parameters = Parameters {
                pi1,
                ..Parameters::default()
            };
            let mut configuration = disc(&parameters, 30, None, 5).unwrap();
            let ids = at_border(&parameters, &mut configuration, 10, 0.0, 0.0, DRAW).unwrap();
            assert_eq!(ids, (30..40).collect::<Vec<u32>>());
            assert!(worst_gap(&parameters, &configuration).unwrap() >= 0.0);
            let body = Body::new(&parameters);
            for k in 30..40 {
                let nearest = (0..40).filter(|&j| j != k).map(|j| {
                    body.nearness(pose(&configuration, k), pose(&configuration, j))
                        .gap
                });
                assert!(nearest.fold(f64::INFINITY, f64::min) <= BORDER_GAP);
            }
        }
    }

    #[test]
    fn a_border_of_one_is_beside_it() {
        let parameters = Parameters::default();
        let mut configuration = disc(&parameters, 1, None, 5).unwrap();
        at_border(&parameters, &mut configuration, 1, 0.0, 0.0, DRAW).unwrap();
        let gap = worst_gap(&parameters, &configuration).unwrap();
        assert!((0.0..=BORDER_GAP).contains(&gap), "{gap}");
    }

    #[test]
    fn a_region_is_filled_without_overlap_or_refused_with_the_numbers() {
        let (parameters, mut configuration) = group();
        let region = Region {
            x: 20.0,
            y: 0.0,
            radius: 2.0,
        };
        let mut inject = |count| {
            within(
                &parameters,
                &mut configuration,
                count,
                region,
                0.5,
                1.0,
                DRAW,
            )
        };
        let refusal = inject(60).unwrap_err();
        let InjectionError::NoRoom {
            placed,
            count: 60,
            tries: TRIES,
        } = refusal
        else {
            panic!("{refusal}");
        };
        assert!((8..25).contains(&placed), "{placed}");
        assert_eq!(inject(6).unwrap().len(), 6);
        assert!(worst_gap(&parameters, &configuration).unwrap() >= 0.0);
        for k in 30..36 {
            assert!((configuration.x[k] - 20.0).hypot(configuration.y[k]) <= 2.0);
            assert_eq!(configuration.weight[k], 0.5);
        }
    }

    #[test]
    fn a_region_that_is_none_is_refused() {
        let (parameters, mut configuration) = group();
        let before = configuration.clone();
        for (x, radius) in [
            (f64::NAN, 1.0),
            (0.0, 0.0),
            (0.0, f64::NAN),
            (0.0, -1.0),
            (3e6, 1.0),
        ] {
            let region = Region { x, y: 0.0, radius };
            let refusal = within(&parameters, &mut configuration, 1, region, 0.0, 0.0, DRAW);
            assert!(matches!(refusal, Err(InjectionError::Parameters(_))));
        }
        assert_eq!(configuration, before);
    }
}
