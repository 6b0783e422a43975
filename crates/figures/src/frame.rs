//! One panel: its axes, its curves, and the labels at their ends.

use crate::axis::tick_label;
use crate::plot::{Band, CELL, Curve, Mark, Panel, Plot, Point, Style, draw_mark};
use crate::svg::{Anchor, Canvas, FAINT, GREY, INK, Stroke};

/// The left, top, right and bottom margins of the frame within its cell, in pixels.
const MARGINS: [f64; 4] = [72.0, 58.0, 36.0, 58.0];

/// The additional right margin for labels, in pixels.
const LABELS: f64 = 84.0;

/// A label within this distance of the end of its curve gets a leader line, in pixels.
const LEADER: f64 = 60.0;

/// The minimum vertical distance of two labels, in pixels.
const LABEL_DISTANCE: f64 = 25.0;

/// The length of a body size of the bodies beside labels, in pixels.
const BODY_SIZE: f64 = 17.0;

/// A panel's rectangle on the canvas, in pixels.
pub struct Frame<'a> {
    plot: &'a Plot,
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl<'a> Frame<'a> {
    /// Places a panel of `plot` in the cell whose upper left corner is at `left` and `top`.
    pub fn new(plot: &'a Plot, left: f64, top: f64) -> Self {
        let mut curves = plot.panels.iter().flat_map(|panel| &panel.curves);
        let labels = if curves.any(|curve| curve.label.is_some()) {
            LABELS
        } else {
            0.0
        };
        Self {
            plot,
            left: left + MARGINS[0],
            top: top + MARGINS[1],
            right: left + CELL.0 - MARGINS[2] - labels,
            bottom: top + CELL.1 - MARGINS[3],
        }
    }

    fn x(&self, value: f64) -> f64 {
        self.left + self.plot.x.share(value) * (self.right - self.left)
    }

    fn y(&self, value: f64) -> f64 {
        self.bottom - self.plot.y.share(value) * (self.bottom - self.top)
    }

    /// Draws axes, marks, curves and labels.
    pub fn draw(&self, canvas: &mut Canvas, panel: &Panel) {
        let middle = f64::midpoint(self.left, self.right);
        let above = |up: f64| (middle, self.top - up);
        canvas.text(above(30.0), Anchor::Middle, 16.0, INK, &panel.title);
        canvas.text(above(11.0), Anchor::Middle, 12.0, GREY, &panel.remark);
        self.draw_axes(canvas);
        for &(value, colour) in &panel.marks {
            let (x, y) = (self.right, self.y(value));
            let points = [(x + 2.0, y), (x + 12.0, y - 5.0), (x + 12.0, y + 5.0)];
            canvas.polygon(&points, colour);
        }
        for band in &panel.bands {
            self.draw_band(canvas, band);
        }
        for curve in &panel.curves {
            self.draw_curve(canvas, curve);
        }
        self.draw_labels(canvas, panel);
    }

    fn draw_axes(&self, canvas: &mut Canvas) {
        let (line, faint) = (Stroke::solid(INK, 1.0), Stroke::solid(FAINT, 1.0));
        let (labelled, plain) = self.plot.x.ticks();
        let mut free = f64::NEG_INFINITY;
        for value in labelled {
            let x = self.x(value);
            canvas.line(&[(x, self.top), (x, self.bottom)], faint);
            canvas.line(&[(x, self.bottom), (x, self.bottom + 5.0)], line);
            let label = tick_label(value);
            let half = 4.2 * label.len() as f64;
            if x - half > free {
                canvas.text((x, self.bottom + 20.0), Anchor::Middle, 13.0, INK, &label);
                free = x + half;
            }
        }
        for x in plain.into_iter().map(|value| self.x(value)) {
            canvas.line(&[(x, self.bottom), (x, self.bottom + 3.0)], line);
        }
        let (labelled, plain) = self.plot.y.ticks();
        for value in labelled {
            let y = self.y(value);
            canvas.line(&[(self.left, y), (self.right, y)], faint);
            canvas.line(&[(self.left - 5.0, y), (self.left, y)], line);
            let at = (self.left - 9.0, y + 4.5);
            canvas.text(at, Anchor::End, 13.0, INK, &tick_label(value));
        }
        for y in plain.into_iter().map(|value| self.y(value)) {
            canvas.line(&[(self.left - 3.0, y), (self.left, y)], line);
        }
        let corners = [
            (self.left, self.top),
            (self.left, self.bottom),
            (self.right, self.bottom),
        ];
        canvas.line(&corners, line);
        let (x, y) = (
            f64::midpoint(self.left, self.right),
            f64::midpoint(self.top, self.bottom),
        );
        let at = (x, self.bottom + 44.0);
        canvas.text(at, Anchor::Middle, 15.0, INK, &self.plot.x.label);
        canvas.rising_text((self.left - 50.0, y), 15.0, INK, &self.plot.y.label);
    }

    fn draw_band(&self, canvas: &mut Canvas, band: &Band) {
        let points = band.points.iter();
        let upper = points
            .clone()
            .map(|&(x, _, high)| (self.x(x), self.y(high)));
        let lower = points.rev().map(|&(x, low, _)| (self.x(x), self.y(low)));
        canvas.band(&upper.chain(lower).collect::<Vec<_>>(), band.colour);
    }

    fn draw_curve(&self, canvas: &mut Canvas, curve: &Curve) {
        let Style { colour, dash, mark } = curve.style;
        let width = if mark == Mark::None { 1.5 } else { 2.0 };
        let stroke = Stroke {
            colour,
            width,
            dash,
        };
        let place = |point: &Point| (self.x(point.x) + curve.aside, self.y(point.y));
        for stretch in curve.points.split(Option::is_none) {
            let points: Vec<(f64, f64)> = stretch.iter().flatten().map(place).collect();
            if points.len() > 1 {
                canvas.line(&points, stroke);
            }
        }
        let thin = Stroke::solid(colour, 1.0);
        for point in curve.points.iter().flatten() {
            let (x, y) = place(point);
            if let Some(bar) = point.bar {
                let (low, high) = (self.y(point.y - bar), self.y(point.y + bar));
                canvas.line(&[(x, low), (x, high)], thin);
                canvas.line(&[(x - 3.0, low), (x + 3.0, low)], thin);
                canvas.line(&[(x - 3.0, high), (x + 3.0, high)], thin);
            }
            draw_mark(canvas, (x, y), curve.style);
        }
    }

    /// Writes the labels to the right of the panel, as near to the ends of their curves as
    /// [`LABEL_DISTANCE`] permits.
    fn draw_labels(&self, canvas: &mut Canvas, panel: &Panel) {
        let mut labels: Vec<_> = panel
            .curves
            .iter()
            .filter_map(|curve| {
                let end = curve.points.iter().flatten().next_back()?;
                let (text, body) = curve.label.as_ref()?;
                Some((self.y(end.y), self.x(end.x), curve.style, text, *body))
            })
            .collect();
        labels.sort_by(|one, two| one.0.total_cmp(&two.0));
        let ends: Vec<f64> = labels.iter().map(|label| label.0).collect();
        let heights = spread_apart(&ends, LABEL_DISTANCE, (self.top - 10.0, self.bottom - 8.0));
        for ((end, x, style, text, body), y) in labels.into_iter().zip(heights) {
            let begin = self.right + 12.0;
            if begin - x < LEADER {
                let leader = Stroke {
                    colour: style.colour,
                    width: 0.8,
                    dash: "1.5 2.5",
                };
                canvas.line(&[(x + 6.0, end), (begin - 5.0, y)], leader);
            }
            let sample = Stroke {
                colour: style.colour,
                width: 2.0,
                dash: style.dash,
            };
            canvas.line(&[(begin - 3.0, y), (begin + 11.0, y)], sample);
            draw_mark(canvas, (begin + 4.0, y), style);
            canvas.text((begin + 17.0, y + 4.5), Anchor::Start, 13.0, INK, text);
            if let Some(pi1) = body {
                let (half_length, radius) = sample_body(pi1);
                let at = (self.right + 97.0, y);
                let outline = Stroke::solid(GREY, 1.2);
                canvas.capsule(at, 0.0, (half_length, radius), "none", outline);
            }
        }
    }
}

/// Returns half the axis and the radius of the capsule beside a label, in pixels. The capsule is
/// `pi1` times as long as wide, and its length plus width is the same for all `pi1`.
fn sample_body(pi1: f64) -> (f64, f64) {
    let radius = BODY_SIZE / (1.0 + pi1);
    ((pi1 - 1.0) * radius, radius)
}

/// Moves `heights`, which must be ascending, until they are at least `distance` apart, and within
/// `ends` if possible.
fn spread_apart(heights: &[f64], distance: f64, ends: (f64, f64)) -> Vec<f64> {
    let mut spread = heights.to_vec();
    for index in 1..spread.len() {
        spread[index] = spread[index].max(spread[index - 1] + distance);
    }
    let mut limit = ends.1;
    for height in spread.iter_mut().rev() {
        *height = height.min(limit);
        limit = *height - distance;
    }
    let mut limit = ends.0;
    for height in &mut spread {
        *height = height.max(limit);
        limit = *height + distance;
    }
    spread
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_bodies_have_their_shape_and_one_size() {
        for pi1 in [1.0, 1.5, 4.0, 8.0] {
            let (half_length, radius) = sample_body(pi1);
            let (length, width) = (2.0 * (half_length + radius), 2.0 * radius);
            assert!((length - pi1 * width).abs() < 1e-12, "{pi1}");
            assert!((length + width - 2.0 * BODY_SIZE).abs() < 1e-12, "{pi1}");
        }
    }

    #[test]
    fn labels_keep_a_minimum_distance_within_the_panel() {
        assert_eq!(spread_apart(&[5.0, 50.0], 10.0, (0.0, 90.0)), [5.0, 50.0]);
        assert_eq!(
            spread_apart(&[5.0, 6.0, 88.0, 89.0], 10.0, (0.0, 90.0)),
            [5.0, 15.0, 80.0, 90.0]
        );
        assert!(spread_apart(&[], 10.0, (0.0, 90.0)).is_empty());
    }
}
