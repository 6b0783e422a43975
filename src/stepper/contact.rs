//! Contacts: where two bodies could touch during a step, and how their gap changes.

use super::StepError;
use crate::model::{Configuration, ContactRule, Parameters, SolverMemory};

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
            h,
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
        let start = contacts.len();
        let mut push = |code: u8, arms: [f64; 2]| {
            let separation = pair.separation(arms);
            let distance = dot(separation, separation).sqrt();
            if distance > limit {
                return;
            }
            let normal = [separation[0] / distance, separation[1] / distance];
            let lever = |body: usize| arms[body] * cross(pair.heading[body], normal);
            let gap = distance - width;
            contacts.push(Contact {
                i,
                j,
                code,
                gap,
                normal,
                lever: [lever(0), lever(1)],
            });
        };
        if h == 0.0 {
            push(0, [0.0, 0.0]);
        } else {
            pair.ends(&mut push);
            contacts[start..].sort_unstable_by_key(|contact| contact.code);
        }
    }
    Ok(())
}

/// Whether two axes of half-length `h` meet, the second's centre at `offset` from the first's.
/// Discs meet when their centres coincide.
#[must_use]
pub fn axes_cross(h: f64, offset: [f64; 2], heading_i: [f64; 2], heading_j: [f64; 2]) -> bool {
    if dot(offset, offset) > 4.0 * h * h {
        return false;
    }
    // Each axis must meet the other's line: the ends of one lie on both sides of it.
    let sine = cross(heading_i, heading_j);
    let across_i = cross(heading_i, offset);
    let across_j = cross(heading_j, offset);
    let spread = h * sine.abs();
    if across_i.abs() > spread || across_j.abs() > spread {
        return false;
    }
    // Parallel axes on one line overlap, being nearer than two half-lengths.
    true
}

/// Guesses the multipliers of `contacts` from the last step's.
///
/// A contact not seen before, of a pair that was in contact, inherits from one of the pair's
/// contacts that shares an end and is gone: the contact has passed from a side to a cap.
pub fn recall(memory: &SolverMemory, id: &[u32], contacts: &[Contact], guess: &mut Vec<f64>) {
    guess.clear();
    guess.resize(contacts.len(), 0.0);
    let mut remembered = &memory.contacts[..];
    let mut start = 0;
    while start < contacts.len() {
        let (i, j) = (contacts[start].i, contacts[start].j);
        let count = contacts[start..]
            .iter()
            .take_while(|contact| (contact.i, contact.j) == (i, j))
            .count();
        let now = start..start + count;
        start += count;
        let pair = (id[i as usize], id[j as usize]);
        let skipped = remembered.partition_point(|old| (old.first, old.second) < pair);
        remembered = &remembered[skipped..];
        let known = remembered.partition_point(|old| (old.first, old.second) == pair);
        let mut gone: Vec<_> = remembered[..known].to_vec();
        remembered = &remembered[known..];
        for k in now.clone() {
            if let Some(place) = gone.iter().position(|old| old.code == contacts[k].code) {
                guess[k] = gone.remove(place).multiplier;
            }
        }
        for k in now.filter(|&k| guess[k] == 0.0).collect::<Vec<_>>() {
            let shares_end =
                |old: &crate::model::Remembered| ends(old.code) & ends(contacts[k].code) != 0;
            if let Some(place) = gone.iter().position(shares_end) {
                guess[k] = gone.remove(place).multiplier;
            }
        }
    }
}

/// The ends a code names, as bits: head and tail of the first, head and tail of the second.
fn ends(code: u8) -> u8 {
    match code {
        0..4 => 1 << code,
        _ => 1 << ((code - 4) / 2) | 4 << ((code - 4) % 2),
    }
}

/// Two axes: the centre of the second seen from the first, and both headings.
struct Pair {
    h: f64,
    offset: [f64; 2],
    heading: [[f64; 2]; 2],
}

/// An end's nearest point on the other axis.
#[derive(Clone, Copy, PartialEq)]
enum Foot {
    Inside(f64),
    End(u8),
}

impl Pair {
    /// From the point of the first axis at `arms[0]` to the point of the second at `arms[1]`.
    fn separation(&self, arms: [f64; 2]) -> [f64; 2] {
        let [u, v] = self.heading;
        [0, 1].map(|axis| self.offset[axis] + arms[1] * v[axis] - arms[0] * u[axis])
    }

    /// Where an end's projection falls on an axis; an end is 0 for the head, 1 for the tail.
    fn foot(&self, along: f64) -> Foot {
        match along {
            along if along >= self.h => Foot::End(0),
            along if along <= -self.h => Foot::End(1),
            along => Foot::Inside(along),
        }
    }

    fn ends(&self, push: &mut impl FnMut(u8, [f64; 2])) {
        let [u, v] = self.heading;
        let arm = [self.h, -self.h];
        let cosine = dot(u, v);
        let (offset_u, offset_v) = (dot(self.offset, u), dot(self.offset, v));
        let of_first = arm.map(|arm| self.foot(arm * cosine - offset_v));
        let of_second = arm.map(|arm| self.foot(arm * cosine + offset_u));
        for end in 0..2u8 {
            let at = usize::from(end);
            match of_first[at] {
                Foot::Inside(along) => push(end, [arm[at], along]),
                Foot::End(other) if of_second[usize::from(other)] == Foot::End(end) => {
                    push(4 + 2 * end + other, [arm[at], arm[usize::from(other)]]);
                }
                Foot::End(_) => {}
            }
            if let Foot::Inside(along) = of_second[at] {
                push(2 + end, [along, arm[at]]);
            }
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
    use crate::model::Remembered;
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

    #[test]
    fn multipliers_are_recalled_by_name_then_by_a_shared_end() {
        let contact = |i, j, code| Contact {
            i,
            j,
            code,
            gap: 0.0,
            normal: [1.0, 0.0],
            lever: [0.0; 2],
        };
        let old = |first, second, code, multiplier| Remembered {
            first,
            second,
            code,
            multiplier,
        };
        // The middle individual, id 20, is gone since.
        let contacts = vec![
            old(10, 20, 0, 1.0),
            old(10, 30, 1, 2.0),
            old(10, 30, 3, 3.0),
            old(20, 30, 0, 4.0),
            old(30, 40, 0, 5.0),
        ];
        let memory = SolverMemory {
            contacts,
            ..SolverMemory::default()
        };
        let now = [
            contact(0, 1, 1),
            contact(0, 1, 5),
            contact(0, 2, 0),
            contact(1, 2, 2),
            contact(1, 2, 4),
        ];
        let mut guess = Vec::new();
        recall(&memory, &[10, 30, 40], &now, &mut guess);
        // 5 is head with tail: it inherits from 3, the tail on a side; 4 is head with head: from
        // 0; 2, the other's head on a side, has no end in common with what was there.
        assert_eq!(guess, [2.0, 3.0, 0.0, 0.0, 5.0]);
    }
}
