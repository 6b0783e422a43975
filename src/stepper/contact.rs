//! Contacts: where two bodies could touch during a step, and how their gap changes.

use super::StepError;
use crate::model::{Configuration, ContactRule, Parameters};

/// One end of a body near another body.
///
/// The normal points from `i` to `j`. A lever is the normal's component across the body times
/// the arm along it: the gap shrinks by `lever[0]` per angle of `i` and grows by `lever[1]` per
/// angle of `j`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Index of the first individual.
    pub i: u32,
    /// Index of the second, larger than the first.
    pub j: u32,
    /// Which ends: 0 and 1, head and tail of `i` on the side of `j`; 2 and 3, head and tail of
    /// `j` on the side of `i`; 4 + 2e + f, end e of `i` with end f of `j`. Discs have 0.
    pub code: u8,
    /// Signed distance of the surfaces.
    pub gap: f64,
    /// Unit vector from `i` to `j`.
    pub normal: [f64; 2],
    /// How turning `i` and `j` changes the gap.
    pub lever: [f64; 2],
}

impl Contact {
    /// What orders contacts: the pair, then the ends.
    #[must_use]
    pub fn key(&self) -> (u32, u32, u8) {
        (self.i, self.j, self.code)
    }

    /// The change of the gap, to first order, when all are displaced.
    #[must_use]
    pub fn closing(&self, displacement: &[[f64; 3]]) -> f64 {
        let (di, dj) = (displacement[self.i as usize], displacement[self.j as usize]);
        self.normal[0] * (dj[0] - di[0]) + self.normal[1] * (dj[1] - di[1]) + self.lever[1] * dj[2]
            - self.lever[0] * di[2]
    }

    /// The gap, to first order, after all are displaced.
    #[must_use]
    pub fn linearised_gap(&self, displacement: &[[f64; 3]]) -> f64 {
        self.gap + self.closing(displacement)
    }
}

/// Finds every contact of `pairs` with a gap up to `reach(i, j)`, appending to `contacts`.
///
/// - Shapes: pairs ordered by (i, j), i < j; contacts come ordered by (i, j, code).
/// - Units: body sizes; a negative gap is overlap.
/// - Source: paper, appendix, third part of a step. It speaks of one distance of a pair; here
///   every smooth endpoint-to-segment distance counts that no smaller one implies. An end counts
///   where its projection falls inside the other axis, two ends where each is nearest to the other.
///
/// # Errors
///
/// [`StepError::CrossedBodies`] when two axes meet: no normal exists.
pub fn find(
    parameters: &Parameters,
    configuration: &Configuration,
    heading: &[[f64; 2]],
    pairs: &[(u32, u32)],
    reach: impl Fn(usize, usize) -> f64,
    contacts: &mut Vec<Contact>,
) -> Result<(), StepError> {
    let (h, width) = (parameters.half_length(), 2.0 * parameters.radius());
    let ContactRule::Endpoints = parameters.contacts;
    for &(i, j) in pairs {
        let (a, b) = (i as usize, j as usize);
        let limit = width + reach(a, b);
        let pair = Pair {
            offset: [
                configuration.x[b] - configuration.x[a],
                configuration.y[b] - configuration.y[a],
            ],
            heading: [heading[a], heading[b]],
        };
        let centres = limit + 2.0 * h;
        if dot(pair.offset, pair.offset) > centres * centres {
            continue;
        }
        if axes_cross(h, pair.offset, heading[a], heading[b]) {
            let [first, second] = [a, b].map(|index| configuration.id[index]);
            return Err(StepError::CrossedBodies { first, second });
        }
        let ends = pair.ends(h);
        let mut codes = match h {
            0.0 => 1,
            _ => ends.codes(limit),
        };
        while codes != 0 {
            let code = codes.trailing_zeros() as u8;
            codes &= codes - 1;
            contacts.push(ends.contact((i, j), code, pair.heading, width));
        }
    }
    Ok(())
}

/// Whether two axes of half-length `h` meet, the second's centre at `offset` from the first's.
/// Discs meet when their centres coincide.
#[must_use]
pub fn axes_cross(h: f64, offset: [f64; 2], heading_i: [f64; 2], heading_j: [f64; 2]) -> bool {
    // Each axis must meet the other's line: the ends of one lie on both sides of it. Parallel
    // axes on one line meet where they are nearer than two half-lengths. All is asked at once,
    // as nobody can foretell the answers.
    let spread = h * cross(heading_i, heading_j).abs();
    let apart = (dot(offset, offset) > 4.0 * h * h)
        | (cross(heading_i, offset).abs() > spread)
        | (cross(heading_j, offset).abs() > spread);
    !apart
}

/// Whether two axes of half-length `h` come nearer than `distance` anywhere.
#[must_use]
pub fn axes_within(
    distance: f64,
    h: f64,
    offset: [f64; 2],
    heading_i: [f64; 2],
    heading_j: [f64; 2],
) -> bool {
    let pair = Pair {
        offset,
        heading: [heading_i, heading_j],
    };
    let near = pair.ends(h).within(distance) != 0;
    near | axes_cross(h, offset, heading_i, heading_j)
}

/// Two axes: the centre of the second seen from the first, and both headings.
struct Pair {
    offset: [f64; 2],
    heading: [[f64; 2]; 2],
}

/// The four ends of a pair, each with the nearest point on the other's axis: head and tail of
/// the first, then head and tail of the second.
struct Ends {
    /// Where on each axis that is, the end or the point.
    arms: [[f64; 4]; 2],
    /// From the place on the first axis to that on the second.
    separation: [[f64; 4]; 2],
    squared: [f64; 4],
    /// Bit k: the point nearest to end k is the other's head.
    at_head: u8,
    /// Bit k: it is the other's tail.
    at_tail: u8,
}

impl Pair {
    #[inline(always)]
    fn ends(&self, h: f64) -> Ends {
        let ([u, v], [dx, dy]) = (self.heading, self.offset);
        let cosine = dot(u, v);
        let (offset_u, offset_v) = (dot(self.offset, u), dot(self.offset, v));
        let end = [h, -h, h, -h];
        let beside = [-offset_v, -offset_v, offset_u, offset_u];
        let (mut foot, mut at_head, mut at_tail) = ([0.0; 4], 0, 0);
        for k in 0..4 {
            let along = end[k] * cosine + beside[k];
            at_head |= u8::from(along >= h) << k;
            at_tail |= u8::from(along <= -h) << k;
            foot[k] = if along >= h { h } else { along };
            foot[k] = if along <= -h { -h } else { foot[k] };
        }
        let arms = [[h, -h, foot[2], foot[3]], [foot[0], foot[1], h, -h]];
        let (mut separation, mut squared) = ([[0.0; 4]; 2], [0.0; 4]);
        for k in 0..4 {
            let x = dx + arms[1][k] * v[0] - arms[0][k] * u[0];
            let y = dy + arms[1][k] * v[1] - arms[0][k] * u[1];
            (separation[0][k], separation[1][k]) = (x, y);
            squared[k] = x * x + y * y;
        }
        Ends {
            arms,
            separation,
            squared,
            at_head,
            at_tail,
        }
    }
}

impl Ends {
    /// Which ends are within `distance`, as bits.
    #[inline(always)]
    fn within(&self, distance: f64) -> u8 {
        let limit = distance * distance;
        (0..4).fold(0, |bits, k| bits | u8::from(self.squared[k] <= limit) << k)
    }

    /// The codes of the contacts within `distance`, as bits.
    #[inline(always)]
    fn codes(&self, distance: f64) -> u8 {
        let (near, head, tail) = (self.within(distance), self.at_head, self.at_tail);
        let sides = near & !(head | tail);
        // Ends of the first (bits 0, 1) with ends of the second (bits 2, 3), each nearest to
        // the other.
        let head_head = near & head & (head >> 2) & 1;
        let head_tail = near & tail & (head >> 3) & 1;
        let tail_head = (near & head) >> 1 & (tail >> 2) & 1;
        let tail_tail = (near & tail & (tail >> 2)) >> 1 & 1;
        sides | head_head << 4 | head_tail << 5 | tail_head << 6 | tail_tail << 7
    }

    #[inline(always)]
    fn contact(&self, (i, j): (u32, u32), code: u8, heading: [[f64; 2]; 2], width: f64) -> Contact {
        let end = usize::from(if code < 4 { code } else { (code - 4) / 2 });
        let distance = self.squared[end].sqrt();
        let normal = self.separation.map(|axis| axis[end] / distance);
        let lever = |body: usize| self.arms[body][end] * cross(heading[body], normal);
        Contact {
            i,
            j,
            code,
            gap: distance - width,
            normal,
            lever: [lever(0), lever(1)],
        }
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::{FRAC_PI_2, TAU};

    use super::*;
    use crate::model::body::{Body, Pose};
    use crate::model::random::{Purpose, Stream};

    fn found(parameters: Parameters, second: Pose, reach: f64) -> Result<Vec<Contact>, StepError> {
        let mut configuration = Configuration::default();
        configuration.push(0.0, 0.0, 0.0);
        configuration.push(second.x, second.y, second.alpha);
        let heading = [0.0, second.alpha].map(|angle| [libm::cos(angle), libm::sin(angle)]);
        let mut contacts = Vec::new();
        find(
            &parameters,
            &configuration,
            &heading,
            &[(0, 1)],
            |_, _| reach,
            &mut contacts,
        )?;
        Ok(contacts)
    }

    fn at(x: f64, y: f64, alpha: f64) -> Pose {
        Pose { x, y, alpha }
    }

    fn codes(second: Pose) -> Vec<u8> {
        let contacts = found(Parameters::default(), second, 0.2).unwrap();
        contacts.iter().map(|contact| contact.code).collect()
    }

    #[test]
    fn ends_over_sides_and_ends_at_ends_have_their_codes() {
        // Half-length 0.6, width 0.4.
        assert_eq!(
            codes(at(1.3, 0.0, 0.0)),
            [4 + 1],
            "head of the first, tail of the second"
        );
        assert_eq!(
            codes(at(1.3, 0.0, std::f64::consts::PI)),
            [4],
            "head to head"
        );
        assert_eq!(
            codes(at(0.0, 1.1, FRAC_PI_2)),
            [3],
            "tail of the second on the first's side"
        );
        assert_eq!(codes(at(0.0, 1.1, -FRAC_PI_2)), [2], "head of the second");
        assert_eq!(
            codes(at(0.5, 0.5, 0.0)),
            [0, 3],
            "half a length ahead, two ends over sides"
        );
        assert_eq!(codes(at(3.0, 0.0, 0.0)), [0u8; 0]);
    }

    #[test]
    fn an_end_over_a_side_pushes_straight_and_turns_by_its_arm() {
        let contacts = found(Parameters::default(), at(0.25, 1.1, FRAC_PI_2), 0.2).unwrap();
        let [contact] = contacts[..] else {
            panic!("{contacts:?}")
        };
        assert!((contact.gap - 0.1).abs() < 1e-15);
        assert!(contact.normal[0].abs() < 1e-15 && (contact.normal[1] - 1.0).abs() < 1e-15);
        // On the first the arm is 0.25 ahead; the second is met along its axis.
        assert!((contact.lever[0] - 0.25).abs() < 1e-15 && contact.lever[1].abs() < 1e-15);
    }

    #[test]
    fn discs_have_one_contact_without_levers() {
        let discs = Parameters {
            pi1: 1.0,
            ..Parameters::default()
        };
        let contacts = found(discs, at(0.6, 0.9, 1.0), 0.2).unwrap();
        let [contact] = contacts[..] else {
            panic!("{contacts:?}")
        };
        assert_eq!((contact.code, contact.lever), (0, [0.0, 0.0]));
        assert!((contact.gap - (0.6f64.hypot(0.9) - 1.0)).abs() < 1e-15);
        assert!(
            found(discs, at(0.0, 0.0, 1.0), 0.2).is_err(),
            "at one place there is no normal"
        );
    }

    #[test]
    fn axes_that_meet_are_an_error() {
        let crossed = Err(StepError::CrossedBodies {
            first: 0,
            second: 1,
        });
        assert_eq!(
            found(Parameters::default(), at(0.1, 0.2, 1.0), 0.2),
            crossed
        );
        assert_eq!(
            found(Parameters::default(), at(0.1, 0.0, 0.0), 0.2),
            crossed,
            "along one line"
        );
        assert!(found(Parameters::default(), at(0.1, 1e-6, 0.0), 0.2).is_ok());
    }

    /// Poses around the first body at any angle, a few of them crossed.
    fn poses() -> impl Iterator<Item = Pose> {
        let mut stream = Stream::new(7, 0, 0, Purpose::Start);
        (0..20_000).map(move |_| {
            let mut draw = |width: f64| width * (stream.uniform() - 0.5);
            at(draw(4.0), draw(4.0), draw(2.0 * TAU))
        })
    }

    #[test]
    fn the_nearest_contact_is_the_gap_that_parry_measures() {
        let mut near = 0;
        for pose in poses() {
            let parameters = Parameters::default();
            let nearness = Body::new(&parameters).nearness(at(0.0, 0.0, 0.0), pose);
            match found(parameters, pose, 0.3) {
                Err(_) => assert!(nearness.crossed, "{pose:?}"),
                Ok(contacts) => {
                    assert!(!nearness.crossed, "{pose:?}");
                    let least = contacts.iter().map(|contact| contact.gap).reduce(f64::min);
                    assert_eq!(least.is_some(), nearness.gap <= 0.3, "{pose:?}");
                    assert!(
                        least.is_none_or(|gap| (gap - nearness.gap).abs() < 1e-14),
                        "{pose:?}"
                    );
                    near += contacts.len();
                }
            }
        }
        assert!(near > 3000, "{near}");
    }

    #[test]
    fn gradients_are_those_of_the_gap() {
        let step = 1e-6;
        let mut compared = 0;
        for pose in poses() {
            let Ok(contacts) = found(Parameters::default(), pose, 0.3) else {
                continue;
            };
            for contact in contacts.into_iter().filter(|contact| contact.gap > -0.3) {
                let partials = [contact.normal[0], contact.normal[1], contact.lever[1]];
                for (axis, partial) in partials.into_iter().enumerate() {
                    let moved = |by: f64| {
                        let mut moved = [pose.x, pose.y, pose.alpha];
                        moved[axis] += by;
                        let contacts =
                            found(Parameters::default(), at(moved[0], moved[1], moved[2]), 0.4)
                                .ok()?;
                        Some(
                            contacts
                                .iter()
                                .find(|other| other.code == contact.code)?
                                .gap,
                        )
                    };
                    // Near the end of its range a contact becomes another.
                    let (Some(ahead), Some(behind)) = (moved(step), moved(-step)) else {
                        continue;
                    };
                    let measured = (ahead - behind) / (2.0 * step);
                    assert!(
                        (measured - partial).abs() < 1e-7,
                        "{pose:?} axis {axis}: {measured} {partial}"
                    );
                    compared += 1;
                }
            }
        }
        assert!(compared > 10_000, "{compared}");
    }

    #[test]
    fn turning_the_first_is_turning_all_but_the_first_the_other_way() {
        for pose in poses() {
            let Ok(contacts) = found(Parameters::default(), pose, 0.3) else {
                continue;
            };
            for contact in contacts {
                // A gap does not change when both turn about the first one's centre.
                let turned = [[0.0, 0.0, 1.0], [-pose.y, pose.x, 1.0]];
                assert!(contact.closing(&turned).abs() < 1e-13, "{pose:?}");
            }
        }
    }
}
