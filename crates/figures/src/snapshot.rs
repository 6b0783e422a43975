//! Snapshots of groups, as in the paper's Figure 3: outlines of bodies, stars at their heads.

use std::f64::consts::TAU;

use crate::FigureError;
use crate::svg::{Anchor, Canvas, GREY, INK, PALETTE, Stroke};

/// A group at one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// The title above it; `_x` and `_{xyz}` are subscripts.
    pub title: String,
    /// Length over width of its bodies.
    pub pi1: f64,
    /// Its individuals.
    pub members: Vec<Member>,
}

/// An individual of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Member {
    /// The x coordinate of its centre, in body sizes.
    pub x: f64,
    /// The y coordinate of its centre, in body sizes.
    pub y: f64,
    /// Its heading in radians, counter-clockwise from +x.
    pub alpha: f64,
    /// The weight of its own preference; positive if it is informed.
    pub weight: f64,
    /// The direction that it prefers, in radians.
    pub direction: f64,
}

/// The width of a group's cell, its margin, and the height of its title, in pixels.
const SIDE: f64 = 600.0;
const MARGIN: f64 = 24.0;
const HEAD: f64 = 40.0;

/// The maximum length of a body size in pixels, so that a few bodies do not fill the picture.
const MAX_SCALE: f64 = 95.0;

/// The maximum distance of a body's points from its centre, in body sizes.
const REACH: f64 = 1.0;

const INFORMED: &str = PALETTE[0];

/// Draws `groups` side by side, all to the same scale, as SVG.
///
/// # Errors
///
/// [`FigureError::NoBodies`], [`FigureError::NotFinite`] or [`FigureError::Elongation`].
pub fn snapshot(groups: &[Group]) -> Result<String, FigureError> {
    if groups.is_empty() || groups.iter().any(|group| group.members.is_empty()) {
        return Err(FigureError::NoBodies);
    }
    for (group, Group { pi1, members, .. }) in groups.iter().enumerate() {
        if !pi1.is_finite() || *pi1 < 1.0 {
            return Err(FigureError::Elongation { group, pi1: *pi1 });
        }
        let finite = |member: &Member| {
            let Member { x, y, alpha, .. } = *member;
            let direction = if member.weight > 0.0 {
                member.direction
            } else {
                0.0
            };
            [x, y, alpha, direction]
                .iter()
                .all(|value| value.is_finite())
        };
        if let Some(index) = members.iter().position(|member| !finite(member)) {
            return Err(FigureError::NotFinite { group, index });
        }
    }
    let extents: Vec<Extent> = groups.iter().map(Extent::around).collect();
    let most = |pick: fn(&Extent) -> f64| extents.iter().map(pick).fold(0.0, f64::max);
    let (width, height) = (most(|extent| extent.size.0), most(|extent| extent.size.1));
    let scale = ((SIDE - 2.0 * MARGIN) / width.max(height)).min(MAX_SCALE);
    // The height is that of the highest group, since groups are often wider than high.
    let bottom = HEAD + scale * height + 2.0 * MARGIN;
    let mut canvas = Canvas::new(SIDE * groups.len() as f64, bottom + HEAD);
    for (index, (group, extent)) in groups.iter().zip(&extents).enumerate() {
        let middle = SIDE * (index as f64 + 0.5);
        canvas.text((middle, 27.0), Anchor::Middle, 16.0, INK, &group.title);
        let place = |x: f64, y: f64| {
            (
                middle + scale * (x - extent.centre.0),
                f64::midpoint(HEAD, bottom) - scale * (y - extent.centre.1),
            )
        };
        draw_group(&mut canvas, group, scale, place);
    }
    let bottom = bottom + 14.0;
    let ruler = Stroke::solid(INK, 2.0);
    canvas.line(&[(MARGIN, bottom), (MARGIN + scale, bottom)], ruler);
    for x in [MARGIN, MARGIN + scale] {
        canvas.line(&[(x, bottom - 4.0), (x, bottom + 4.0)], ruler);
    }
    let at = (MARGIN + scale + 10.0, bottom + 4.5);
    canvas.text(at, Anchor::Start, 13.0, INK, "one body size s");
    let mut members = groups.iter().flat_map(|group| &group.members);
    if members.any(|member| member.weight > 0.0) {
        let note = "coloured: informed, a line in the direction they prefer";
        let at = (SIDE * groups.len() as f64 - MARGIN, bottom + 4.5);
        canvas.text(at, Anchor::End, 13.0, INK, note);
    }
    Ok(canvas.finish())
}

/// The bounding rectangle of a group, in body sizes.
struct Extent {
    centre: (f64, f64),
    size: (f64, f64),
}

impl Extent {
    fn around(group: &Group) -> Self {
        let range = |pick: fn(&Member) -> f64| {
            let values = group.members.iter().map(pick);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            (low, values.fold(f64::NEG_INFINITY, f64::max))
        };
        let (x, y) = (range(|member| member.x), range(|member| member.y));
        Self {
            centre: (f64::midpoint(x.0, x.1), f64::midpoint(y.0, y.1)),
            size: (x.1 - x.0 + 2.0 * REACH, y.1 - y.0 + 2.0 * REACH),
        }
    }
}

fn draw_group(
    canvas: &mut Canvas,
    group: &Group,
    scale: f64,
    place: impl Fn(f64, f64) -> (f64, f64),
) {
    // Length over width p + 1: radius 1 / (2 + p), axis of half-length p times it.
    let radius = scale / (1.0 + group.pi1);
    let half_length = (group.pi1 - 1.0) * radius;
    let line = (scale / 40.0).clamp(0.7, 1.6);
    for member in &group.members {
        let informed = member.weight > 0.0;
        let centre = place(member.x, member.y);
        let (fill, colour) = if informed {
            ("#f7dcc8", INFORMED)
        } else {
            ("#f2f2f2", GREY)
        };
        let (turn, size) = (member.alpha, (half_length, radius - line / 2.0));
        canvas.capsule(centre, turn, size, fill, Stroke::solid(colour, line));
    }
    // The stars are above all bodies, since bodies may overlap slightly.
    for member in &group.members {
        let (x, y) = place(member.x, member.y);
        let (cos, sin) = (libm::cos(member.alpha), libm::sin(member.alpha));
        let reach = (0.62 * radius).min(0.15 * scale);
        // In a disc the star would otherwise be at the centre and not show the heading.
        let ahead = half_length.max(0.92 * radius - reach);
        let head = (x + ahead * cos, y - ahead * sin);
        if member.weight > 0.0 {
            let (cos, sin) = (libm::cos(member.direction), libm::sin(member.direction));
            let far = (head.0 + 0.5 * scale * cos, head.1 - 0.5 * scale * sin);
            canvas.line(&[head, far], Stroke::solid(INFORMED, 1.4 * line));
        }
        let colour = if member.weight > 0.0 { INFORMED } else { INK };
        canvas.polygon(&star(head, reach, member.alpha), colour);
    }
}

/// Returns the corners of a five-pointed star, one point of which is in the direction `angle`.
fn star(centre: (f64, f64), radius: f64, angle: f64) -> Vec<(f64, f64)> {
    (0..10)
        .map(|corner| {
            let reach = if corner % 2 == 0 {
                radius
            } else {
                0.42 * radius
            };
            let turn = angle + TAU * f64::from(corner) / 10.0;
            (
                centre.0 + reach * libm::cos(turn),
                centre.1 - reach * libm::sin(turn),
            )
        })
        .collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn group(members: usize) -> Group {
        let member = |index| Member {
            x: 100.0 + index as f64,
            y: -50.0,
            alpha: 1.0,
            weight: index as f64 * 0.5,
            direction: 0.0,
        };
        Group {
            title: "pi1 = 4".to_owned(),
            pi1: 4.0,
            members: (0..members).map(member).collect(),
        }
    }

    #[test]
    fn every_body_has_an_outline_and_a_star() {
        let picture = snapshot(&[group(3), group(2)]).unwrap();
        assert_eq!(picture.matches("<polygon").count(), 5);
        // One rectangle is the background.
        assert_eq!(picture.matches("<rect").count(), 6);
        assert!(picture.contains("informed"), "{picture}");
        assert_eq!(picture, snapshot(&[group(3), group(2)]).unwrap());
        assert!(!snapshot(&[group(1)]).unwrap().contains("informed"));
    }

    #[test]
    fn errors_name_the_group_and_individual() {
        assert!(matches!(snapshot(&[]), Err(FigureError::NoBodies)));
        let empty = snapshot(&[group(1), group(0)]);
        assert!(matches!(empty, Err(FigureError::NoBodies)));
        let mut lost = group(3);
        lost.members[1].x = f64::NAN;
        let found = snapshot(&[group(1), lost]).unwrap_err();
        assert!(matches!(
            found,
            FigureError::NotFinite { group: 1, index: 1 }
        ));
        let mut thin = group(1);
        thin.pi1 = 0.5;
        let found = snapshot(&[thin]).unwrap_err();
        assert!(matches!(found, FigureError::Elongation { .. }));
    }
}
