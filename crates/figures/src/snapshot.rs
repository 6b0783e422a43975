//! Snapshots of groups, as in the paper's Figure 3: outlines of bodies, stars at their heads.

use std::f64::consts::TAU;

use crate::FigureError;
use crate::svg::{Anchor, Canvas, FAINT, GREY, INK, PALETTE, Stroke, literal};
use crate::text;

/// A group at one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// The title above it.
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

/// The width of a picture of several groups, and the largest and the smallest side of the square that
/// contains a group, in pixels.
const WIDTH: f64 = 1200.0;
const SIDES: (f64, f64) = (600.0, 200.0);

/// The margin of a group, in pixels.
const MARGIN: f64 = 16.0;

/// The distance of the frame around each of several groups from the edge of its cell, in pixels.
const INSET: f64 = 4.0;

/// The size of titles and the height of one of their lines, in pixels.
const TITLE: (f64, f64) = (15.0, 20.0);

/// The least width of a picture: that of the longest line below the groups, in pixels.
const LEAST_WIDTH: f64 = 400.0;

/// The height of a line below the groups, in pixels.
const ROW: f64 = 22.0;

/// The maximum length of a body size in pixels, so that a few bodies do not fill the picture.
const MAX_SCALE: f64 = 95.0;

/// The maximum distance of a body's points from its centre, in body sizes.
const REACH: f64 = 1.0;

const INFORMED: &str = PALETTE[0];

/// Draws `groups` in a grid, row by row, all to the same scale, as SVG.
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
    let columns = columns_of(groups.len());
    let rows = groups.len().div_ceil(columns);
    let side = (WIDTH / columns as f64).clamp(SIDES.1, SIDES.0);
    let scale = ((side - 2.0 * MARGIN) / width.max(height)).min(MAX_SCALE);
    // No wider and higher than the largest group: groups are often wider than high.
    let least = (LEAST_WIDTH / columns as f64).max(SIDES.1);
    let cell_width = (scale * width + 2.0 * MARGIN).max(least);
    let titles = groups.iter().map(|group| {
        let room = cell_width - MARGIN;
        text::lines(&group.title, TITLE.0, room)
    });
    let titles: Vec<Vec<String>> = titles.collect();
    let lines = titles.iter().map(Vec::len).max().unwrap_or(0);
    let head = 8.0 + TITLE.1 * lines as f64;
    let cell_height = head + scale * height + 2.0 * MARGIN;
    let (whole, bottom) = (cell_width * columns as f64, cell_height * rows as f64);
    let has_informed = groups
        .iter()
        .flat_map(|group| &group.members)
        .any(|member| member.weight > 0.0);
    let below = if has_informed { 2.0 } else { 1.0 };
    let mut canvas = Canvas::new(whole, bottom + ROW * below);
    for (index, (group, extent)) in groups.iter().zip(&extents).enumerate() {
        let middle = cell_width * ((index % columns) as f64 + 0.5);
        let top = cell_height * (index / columns) as f64;
        if groups.len() > 1 {
            let (x, y) = (cell_width / 2.0 - INSET, top + cell_height - INSET);
            let (left, right, top) = (middle - x, middle + x, top + INSET);
            let corners = [
                (left, top),
                (right, top),
                (right, y),
                (left, y),
                (left, top),
            ];
            canvas.line(&corners, Stroke::solid(FAINT, 1.0));
        }
        for (line, text) in titles[index].iter().enumerate() {
            let at = (middle, top + 8.0 + TITLE.1 * (line as f64 + 0.75));
            canvas.text(at, Anchor::Middle, TITLE.0, INK, &literal(text));
        }
        let centre = top + f64::midpoint(head, cell_height);
        let place = |x: f64, y: f64| {
            (
                middle + scale * (x - extent.centre.0),
                centre - scale * (y - extent.centre.1),
            )
        };
        draw_group(&mut canvas, group, scale, place);
    }
    let bottom = bottom + ROW / 4.0;
    let ruler = Stroke::solid(INK, 2.0);
    canvas.line(&[(MARGIN, bottom), (MARGIN + scale, bottom)], ruler);
    for x in [MARGIN, MARGIN + scale] {
        canvas.line(&[(x, bottom - 4.0), (x, bottom + 4.0)], ruler);
    }
    let at = (MARGIN + scale + 10.0, bottom + 4.5);
    canvas.text(at, Anchor::Start, 13.0, INK, "one body size s");
    if has_informed {
        let note = "coloured: informed, a line in the direction they prefer";
        let at = (MARGIN, bottom + ROW + 4.5);
        canvas.text(at, Anchor::Start, 13.0, INK, note);
    }
    Ok(canvas.finish())
}

/// Returns the number of columns of the grid: it has no more rows than columns.
fn columns_of(groups: usize) -> usize {
    (1..=groups).find(|it| it * it >= groups).unwrap_or(1)
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
    use crate::reading::{Line, Picture};

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
    fn stars_point_along_the_headings_and_lines_along_the_preferred_directions() {
        for (alpha, direction) in [(0.3, 1.2), (2.5, -0.7), (-1.9, 3.0), (-0.4, -2.2)] {
            let member = Member {
                x: 3.0,
                y: 2.0,
                alpha,
                weight: 1.0,
                direction,
            };
            let group = Group {
                members: vec![member],
                ..group(0)
            };
            let picture = Picture::read(&snapshot(&[group]).unwrap());
            let [(star, _)] = &picture.polygons[..] else {
                panic!("{picture:?}")
            };
            // y increases downwards.
            let angle = |from: (f64, f64), to: (f64, f64)| (from.1 - to.1).atan2(to.0 - from.0);
            let count = star.len() as f64;
            let (x, y) = star
                .iter()
                .fold((0.0, 0.0), |sum, at| (sum.0 + at.0, sum.1 + at.1));
            let centre = (x / count, y / count);
            assert!((angle(centre, star[0]) - alpha).abs() < 0.02, "{star:?}");
            let starts_there = |line: &&Line| {
                let [from, _] = line.points[..] else {
                    return false;
                };
                line.colour == INFORMED && (from.0 - centre.0).hypot(from.1 - centre.1) < 0.5
            };
            let line = picture.lines.iter().find(starts_there).unwrap();
            let found = angle(line.points[0], line.points[1]);
            assert!((found - direction).abs() < 0.02, "{found}, {direction}");
        }
    }

    /// The centres of the stars, of which each body has one.
    fn stars(picture: &str) -> Vec<(f64, f64)> {
        let polygons = picture.lines().filter(|it| it.starts_with("<polygon"));
        let corners = polygons.map(|it| it.split('"').nth(1).unwrap());
        corners
            .map(|corners| {
                let (x, y) = corners.split_once(' ').unwrap().0.split_once(',').unwrap();
                (x.parse().unwrap(), y.parse().unwrap())
            })
            .collect()
    }

    #[test]
    fn groups_are_in_a_grid_with_no_more_rows_than_columns() {
        for (groups, columns) in [(1, 1), (2, 2), (3, 2), (4, 2), (5, 3), (9, 3), (10, 4)] {
            assert_eq!(columns_of(groups), columns, "{groups}");
        }
        let picture = snapshot(&vec![group(1); 5]).unwrap();
        let stars = stars(&picture);
        let (first, rest) = stars.split_first().unwrap();
        let cells = rest.iter().map(|it| (it.0 - first.0, it.1 - first.1));
        let cells: Vec<(f64, f64)> = cells.collect();
        let (width, height) = (cells[0].0, cells[2].1);
        assert!(width > 100.0 && height > 100.0, "{cells:?}");
        let expected = [(1, 0), (2, 0), (0, 1), (1, 1)];
        for (cell, (column, row)) in cells.iter().zip(expected) {
            let (x, y) = (f64::from(column) * width, f64::from(row) * height);
            let distance = (cell.0 - x).abs() + (cell.1 - y).abs();
            assert!(distance < 0.1, "{cells:?}");
        }
        let size = format!("viewBox=\"0 0 {:.0} ", 3.0 * width);
        assert!(picture.contains(&size), "{size}: {picture}");
    }

    #[test]
    fn names_have_no_subscripts_and_long_ones_several_lines() {
        let mut named = group(2);
        named.title = format!("my_{}, time 3 s/v0", "a".repeat(60));
        let picture = snapshot(&vec![named; 4]).unwrap();
        assert!(!picture.contains("<tspan"), "{picture}");
        assert_eq!(picture.matches(">my_aaa").count(), 4, "{picture}");
        assert_eq!(picture.matches("3 s/v0<").count(), 4, "{picture}");
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
