//! One panel: its axes, its curves, and the labels at their ends.

use crate::axis::tick_label;
use crate::plot::{Band, Curve, Mark, Panel, Plot, Point, Style, draw_mark};
use crate::svg::{Anchor, Canvas, FAINT, GREY, INK, Stroke};
use crate::text;

/// The baseline of the vertical axis' label, its distance to the labels of ticks and theirs to the frame,
/// from left to right in pixels.
const LEFT: [f64; 3] = [22.0, 8.0, 9.0];

/// The width of a digit in the label of a tick, in pixels.
const DIGIT: f64 = 7.5;

/// The margin to the right of the frame, and the additional one for labels, in pixels.
const RIGHT: f64 = 24.0;
const LABELS: f64 = 96.0;

/// The heights of a panel's title and remark above the frame, in pixels.
const TITLE: f64 = 23.0;
const REMARK: f64 = 17.0;

/// The margin below the frame, in pixels: for the labels of ticks and axis.
const BELOW: f64 = 50.0;

/// The opacity of up to so many bands. More are fainter, so that the curves are seen through all of them.
const BAND_OPACITY: f64 = 0.18;
const BANDS: f64 = 3.0;

/// A label within this distance of the end of its curve gets a leader line, in pixels.
const LEADER: f64 = 60.0;

/// The minimum vertical distance of two labels, in pixels.
const LABEL_DISTANCE: f64 = 25.0;

/// The length of a body size of the bodies beside labels, in pixels.
const BODY_SIZE: f64 = 17.0;

/// The margins of the frame of every panel of a figure, in pixels.
pub struct Margins {
    left: f64,
    right: f64,
    /// That above the frame, with the panel's title and remark.
    pub top: f64,
    /// That below it.
    pub bottom: f64,
    /// Those of the title and the remark above the frame.
    above: [f64; 2],
}

impl Margins {
    /// Returns the margins that the texts of `plot` need.
    pub fn of(plot: &Plot) -> Self {
        let labels = plot.y.ticks().0.into_iter().map(tick_label);
        let digits = labels.map(|label| label.chars().count()).max();
        let has = |is: &dyn Fn(&Panel) -> bool| plot.panels.iter().any(is);
        let needed = |height, is: &dyn Fn(&Panel) -> bool| if has(is) { height } else { 0.0 };
        let remark = needed(REMARK, &|panel| !panel.remark.is_empty());
        let title = needed(TITLE, &|panel| !panel.title.is_empty());
        let is_labelled = |panel: &Panel| panel.curves.iter().any(|it| it.label.is_some());
        let gap = 8.0;
        Self {
            left: LEFT.iter().sum::<f64>() + DIGIT * digits.unwrap_or(0) as f64,
            right: RIGHT + needed(LABELS, &is_labelled),
            top: title + remark + gap,
            bottom: BELOW,
            above: [gap + remark, gap],
        }
    }
}

/// A panel's rectangle on the canvas, in pixels.
pub struct Frame<'a> {
    plot: &'a Plot,
    above: [f64; 2],
    /// The baseline of the vertical axis' label.
    label: f64,
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl<'a> Frame<'a> {
    /// Places a panel of `plot` in the cell whose upper left corner is at `corner`, with the width of the
    /// cell and the height of the frame.
    pub fn new(
        plot: &'a Plot,
        margins: &Margins,
        corner: (f64, f64),
        (width, height): (f64, f64),
    ) -> Self {
        let top = corner.1 + margins.top;
        Self {
            plot,
            above: margins.above,
            label: corner.0 + LEFT[0],
            left: corner.0 + margins.left,
            top,
            right: corner.0 + width - margins.right,
            bottom: top + height,
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
        let texts = [(16.0, INK, &panel.title), (12.0, GREY, &panel.remark)];
        for (up, (size, colour, text)) in self.above.into_iter().zip(texts) {
            if !text.is_empty() {
                let size = text::fitting_size(text, size, self.right - self.left + RIGHT);
                let at = (middle, self.top - up);
                canvas.text(at, Anchor::Middle, size, colour, text);
            }
        }
        self.draw_axes(canvas);
        for &(value, colour) in &panel.marks {
            let (x, y) = (self.right, self.y(value));
            let points = [(x + 2.0, y), (x + 12.0, y - 5.0), (x + 12.0, y + 5.0)];
            canvas.polygon(&points, colour);
        }
        let opacity = BAND_OPACITY / (panel.curves.len() as f64 / BANDS).max(1.0);
        for band in &panel.bands {
            self.draw_band(canvas, band, opacity);
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
        let (of_x, of_y) = (&self.plot.x.label, &self.plot.y.label);
        let size = text::fitting_size(of_x, 15.0, self.right - self.left);
        canvas.text((x, self.bottom + 42.0), Anchor::Middle, size, INK, of_x);
        let size = text::fitting_size(of_y, 15.0, self.bottom - self.top);
        canvas.rising_text((self.label, y), size, INK, of_y);
    }

    fn draw_band(&self, canvas: &mut Canvas, band: &Band, opacity: f64) {
        let points = band.points.iter();
        let upper = points
            .clone()
            .map(|&(x, _, high)| (self.x(x), self.y(high)));
        let lower = points.rev().map(|&(x, low, _)| (self.x(x), self.y(low)));
        canvas.band(
            &upper.chain(lower).collect::<Vec<_>>(),
            band.colour,
            opacity,
        );
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
            match points[..] {
                // It has no length, and would not be seen.
                [one] if curve.measured && mark == Mark::None => {
                    canvas.circle(one, width, colour, Stroke::solid(colour, 0.0));
                }
                [] | [_] => {}
                _ => canvas.line(&points, stroke),
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
