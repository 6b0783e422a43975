//! Contacts: points at which two bodies could touch during a step, with gap and gradient.

use super::StepError;
use super::end_contacts::{self, Axis, End, LANES, Pairs, cross, dot};
use crate::model::simd::Level;
use crate::model::{Configuration, ContactRule, Parameters};

/// An end of a body near another body: one constraint of a step.
///
/// The normal points from `i` to `j`. A lever is the arm of the contact point along the body's axis
/// times the normal's component across that axis. The gap shrinks by `lever[0]` per angle of `i`
/// and grows by `lever[1]` per angle of `j`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Index of the first individual.
    pub i: u32,
    /// Index of the second individual, larger than the first.
    pub j: u32,
    /// The ends in contact. 0 and 1: head and tail of `i` on the side of `j`; 2 and 3: head and
    /// tail of `j` on the side of `i`; 4 + 2e + f: end e of `i` with end f of `j`, where a head is
    /// 0 and a tail 1. Discs have 0.
    pub code: u8,
    /// Signed distance of the surfaces in body sizes, negative for an overlap. In a program it is
    /// the constant of the constraint: the stepper sets it to 0 under `velocity`, and in the second
    /// program of `relinearise` to `g(z1) - ∇g(z1)·d1`, where `z1 = z + d1` is predicted.
    pub gap: f64,
    /// Unit vector from the point on the axis of `i` to the point on the axis of `j`.
    pub normal: [f64; 2],
    /// `[-∂g/∂α_i, ∂g/∂α_j]`.
    pub lever: [f64; 2],
}

impl Contact {
    /// Returns the sort key of contacts: the pair, then the code.
    #[must_use]
    pub fn key(&self) -> (u32, u32, u8) {
        (self.i, self.j, self.code)
    }

    /// Returns `∇g · d`, the change of the gap to first order, for n displacements.
    #[must_use]
    pub fn gap_change(&self, displacement: &[[f64; 3]]) -> f64 {
        let (di, dj) = (displacement[self.i as usize], displacement[self.j as usize]);
        self.normal[0] * (dj[0] - di[0]) + self.normal[1] * (dj[1] - di[1]) + self.lever[1] * dj[2]
            - self.lever[0] * di[2]
    }

    /// Returns `g + ∇g · d`, the gap after n displacements to first order.
    #[must_use]
    pub fn linearised_gap(&self, displacement: &[[f64; 3]]) -> f64 {
        self.gap + self.gap_change(displacement)
    }
}

#[cfg(test)]
impl Contact {
    /// Returns the contact of two discs in a row along x, `i` and the next.
    pub fn in_row(i: u32, gap: f64) -> Self {
        Self {
            i,
            j: i + 1,
            code: 0,
            gap,
            normal: [1.0, 0.0],
            lever: [0.0, 0.0],
        }
    }
}

/// Number of pairs whose signs are computed before their contacts. The kernel for the signs has no
/// branches, and so does not wait for the mispredicted branches of the rest.
const BLOCK: usize = 64;

/// Appends every contact of `pairs` with a gap up to `reach(i, j)` to `contacts`, and returns the
/// number of crossed pairs.
///
/// - Shapes: n individuals and n headings; pairs ordered by (i, j), i < j. The appended contacts
///   are ordered by (i, j, code).
/// - Units: body sizes; a negative gap is overlap.
/// - Source: paper, appendix, third part of a step. The paper constrains one distance of a pair;
///   here every smooth distance of an end from the other axis is a contact unless a smaller one
///   implies it. An end is a contact if its projection is inside the other axis, two ends if each
///   is nearest to the other. Under `closest` only the nearest of these is a contact, of equal
///   ones that with the lowest code. Under `clamped` two ends are a contact if either is nearest
///   to the other.
///
/// # Errors
///
/// [`StepError::CrossedBodies`] if two axes cross, since their distance then has no gradient. Under
/// `closest` this is no error: the nearest of the pair's end contacts still constrains it, and its
/// gradient may point the wrong way.
pub fn find(
    level: Level,
    parameters: &Parameters,
    configuration: &Configuration,
    heading: &[[f64; 2]],
    pairs: &[(u32, u32)],
    reach: impl Fn(usize, usize) -> f64,
    contacts: &mut Vec<Contact>,
) -> Result<usize, StepError> {
    let (h, width) = (parameters.half_length(), 2.0 * parameters.radius());
    let with_implied = parameters.contacts == ContactRule::Clamped;
    let mut crossed = 0;
    let axes = Axes::new(configuration, heading);
    let mut lanes = Pairs::default();
    let mut signs = [[0; LANES]; BLOCK / LANES];
    for pairs in pairs.chunks(BLOCK) {
        for (pairs, signs) in pairs.chunks(LANES).zip(&mut signs) {
            for (lane, &(i, j)) in pairs.iter().enumerate() {
                let limit = width + reach(i as usize, j as usize);
                lanes.set(lane, &axes.at(i), &axes.at(j), limit);
            }
            *signs = lanes.signs(level, h);
        }
        for (&(i, j), &signs) in pairs.iter().zip(signs.as_flattened()) {
            if end_contacts::crossed(signs) {
                if parameters.contacts != ContactRule::Closest {
                    let [first, second] = [i, j].map(|index| configuration.id[index as usize]);
                    return Err(StepError::CrossedBodies { first, second });
                }
                crossed += 1;
            }
            let first = contacts.len();
            let mut codes = end_contacts::codes(h, signs, with_implied);
            while codes != 0 {
                #[expect(clippy::cast_possible_truncation, reason = "codes are below 8")]
                let code = codes.trailing_zeros() as u8;
                codes &= codes - 1;
                contacts.push(contact((i, j), code, h, width, &axes.at(i), &axes.at(j)));
            }
            if parameters.contacts == ContactRule::Closest {
                keep_nearest(contacts, first);
            }
        }
    }
    Ok(crossed)
}

/// Removes all contacts from `first` on but the nearest, of equal ones the first. A contact whose
/// points coincide has no normal and is removed, too.
fn keep_nearest(contacts: &mut Vec<Contact>, first: usize) {
    let with_normal = contacts[first..].iter().filter(|it| !it.normal[0].is_nan());
    let nearest = with_normal
        .copied()
        .reduce(|least, it| if it.gap < least.gap { it } else { least });
    contacts.truncate(first);
    contacts.extend(nearest);
}

/// The axes of all bodies. The columns have one length, so that the compiler checks an index once.
#[derive(Clone, Copy)]
pub struct Axes<'a> {
    x: &'a [f64],
    y: &'a [f64],
    heading: &'a [[f64; 2]],
}

impl<'a> Axes<'a> {
    /// Views a configuration of n individuals and its n headings as axes.
    #[must_use]
    pub fn new(configuration: &'a Configuration, heading: &'a [[f64; 2]]) -> Self {
        let n = heading.len();
        let (x, y) = (&configuration.x[..n], &configuration.y[..n]);
        Self { x, y, heading }
    }

    /// Returns the axis of individual `index`.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, index: u32) -> Axis {
        let index = index as usize;
        Axis {
            centre: [self.x[index], self.y[index]],
            heading: self.heading[index],
        }
    }
}

#[inline(always)]
fn contact(
    (i, j): (u32, u32),
    code: u8,
    h: f64,
    width: f64,
    first: &Axis,
    second: &Axis,
) -> Contact {
    let (u, v) = (first.heading, second.heading);
    let offset = [0, 1].map(|axis| second.centre[axis] - first.centre[axis]);
    let end = if code < 4 {
        End::new(code & 1 != 0, code & 2 != 0, h, offset, u, v)
    } else {
        End::both(code & 2 != 0, code & 1 != 0, h)
    };
    let separation = end.separation(offset, u, v);
    let distance = dot(separation, separation).sqrt();
    let normal = separation.map(|component| component / distance);
    Contact {
        i,
        j,
        code,
        gap: distance - width,
        normal,
        lever: [
            end.arms[0] * cross(u, normal),
            end.arms[1] * cross(v, normal),
        ],
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::{FRAC_PI_2, TAU};

    use super::*;
    use crate::model::body::{Body, Pose};
    use crate::model::random::{Purpose, Stream};

    fn found(parameters: Parameters, second: Pose, reach: f64) -> Result<Vec<Contact>, StepError> {
        found_and_crossed(parameters, second, reach).map(|(contacts, _)| contacts)
    }

    fn found_and_crossed(
        parameters: Parameters,
        second: Pose,
        reach: f64,
    ) -> Result<(Vec<Contact>, usize), StepError> {
        let mut configuration = Configuration::default();
        configuration.push(0.0, 0.0, 0.0);
        configuration.push(second.x, second.y, second.alpha);
        let heading = [0.0, second.alpha].map(|angle| [libm::cos(angle), libm::sin(angle)]);
        let mut contacts = Vec::new();
        let crossed = find(
            Level::default(),
            &parameters,
            &configuration,
            &heading,
            &[(0, 1)],
            |_, _| reach,
            &mut contacts,
        )?;
        Ok((contacts, crossed))
    }

    fn at(x: f64, y: f64, alpha: f64) -> Pose {
        Pose { x, y, alpha }
    }

    fn codes(second: Pose) -> Vec<u8> {
        let contacts = found(Parameters::default(), second, 0.2).unwrap();
        contacts.iter().map(|contact| contact.code).collect()
    }

    #[test]
    fn contacts_of_ends_with_sides_and_ends_have_their_codes() {
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
    fn an_end_on_a_side_has_a_normal_across_and_the_lever_of_its_arm() {
        let contacts = found(Parameters::default(), at(0.25, 1.1, FRAC_PI_2), 0.2).unwrap();
        let [contact] = contacts[..] else {
            panic!("{contacts:?}")
        };
        assert!((contact.gap - 0.1).abs() < 1e-15);
        assert!(contact.normal[0].abs() < 1e-15 && (contact.normal[1] - 1.0).abs() < 1e-15);
        // The arm on the first body is 0.25; on the second the normal is along the axis.
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
            "coinciding centres have no normal"
        );
    }

    #[test]
    fn closest_keeps_the_first_nearest_contact_of_crossed_and_other_pairs() {
        let closest = Parameters {
            contacts: ContactRule::Closest,
            ..Parameters::default()
        };
        let mut ties = 0;
        for pose in poses() {
            let (contacts, crossed) = found_and_crossed(closest, pose, 0.3).unwrap();
            match found(Parameters::default(), pose, 0.3) {
                Err(_) => assert!(crossed == 1 && contacts.len() <= 1, "{pose:?}"),
                Ok(all) => {
                    let nearest = all
                        .iter()
                        .copied()
                        .reduce(|least, it| if it.gap < least.gap { it } else { least });
                    assert_eq!((contacts, crossed), (nearest.into_iter().collect(), 0));
                    ties += usize::from(all.len() > 1);
                }
            }
        }
        assert!(ties > 1000, "{ties}");
        // Side by side and displaced by 0.5: two ends on sides with gaps that are equal to the bit.
        let [contact] = found(closest, at(0.5, 0.5, 0.0), 0.2).unwrap()[..] else {
            panic!("one contact")
        };
        assert_eq!(contact.code, 0);
        // The tail of one is on the axis of the other: that distance is 0 and has no normal.
        let (contacts, crossed) = found_and_crossed(closest, at(0.0, 0.6, FRAC_PI_2), 0.0).unwrap();
        assert!(
            contacts.iter().all(|it| it.normal[0].is_finite()) && crossed == 1,
            "{contacts:?}"
        );
        let discs = Parameters {
            pi1: 1.0,
            ..closest
        };
        let (contacts, crossed) = found_and_crossed(discs, at(0.0, 0.0, 1.0), 0.2).unwrap();
        assert_eq!((contacts, crossed), (Vec::new(), 1));
    }

    #[test]
    fn clamped_adds_only_contacts_beyond_those_that_imply_them() {
        let clamped = Parameters {
            contacts: ContactRule::Clamped,
            ..Parameters::default()
        };
        // Above the middle of a side: the tail is on it, and every two ends are beyond the reach.
        let upright = at(0.0, 1.1, FRAC_PI_2);
        assert_eq!(
            found(clamped, upright, 0.2),
            found(Parameters::default(), upright, 0.2)
        );
        let mut added = 0;
        for pose in poses() {
            let (Ok(all), Ok(pruned)) = (
                found(clamped, pose, 0.3),
                found(Parameters::default(), pose, 0.3),
            ) else {
                continue;
            };
            let least = pruned.iter().map(|it| it.gap).reduce(f64::min);
            for contact in &all {
                if !pruned.contains(contact) {
                    assert!(contact.code >= 4 && least.is_some_and(|gap| gap <= contact.gap));
                    added += 1;
                }
            }
            assert!(pruned.iter().all(|contact| all.contains(contact)));
        }
        assert!(added > 300, "{added}");
    }

    #[test]
    fn crossed_axes_are_an_error() {
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
            "on one line"
        );
        assert!(found(Parameters::default(), at(0.1, 1e-6, 0.0), 0.2).is_ok());
    }

    /// Poses around the first body at any angle; a few cross it.
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
                    // At the limit of its range a contact is replaced by another.
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
    fn a_common_rotation_changes_no_gap() {
        for pose in poses() {
            let Ok(contacts) = found(Parameters::default(), pose, 0.3) else {
                continue;
            };
            for contact in contacts {
                // A rotation of both bodies about the centre of the first changes no gap.
                let turned = [[0.0, 0.0, 1.0], [-pose.y, pose.x, 1.0]];
                assert!(contact.gap_change(&turned).abs() < 1e-13, "{pose:?}");
            }
        }
    }
}
