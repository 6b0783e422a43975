//! A figure of curves: what is in it, and how that is laid out.

use super::axis::Axis;
use super::frame::Frame;
use super::svg::{Anchor, Canvas, GREY, INK, Stroke};

/// Panels side by side that share their axes.
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// One for each contact rule.
    pub panels: Vec<Panel>,
    /// What marks and lines mean, row by row.
    pub key: Vec<Vec<Sample>>,
    /// How to read it, below everything.
    pub note: String,
}

/// Curves over common axes.
pub struct Panel {
    /// The contact rule and the time step.
    pub title: String,
    /// What else must be known to judge it.
    pub remark: String,
    /// The curves, later ones on top.
    pub curves: Vec<Curve>,
    /// Heights marked at the right edge, in a colour.
    pub marks: Vec<(f64, &'static str)>,
}

/// Values joined by a line.
pub struct Curve {
    /// What stands at its end, and the elongation of a body drawn there.
    pub label: Option<(String, Option<f64>)>,
    /// Line and marks.
    pub style: Style,
    /// Its points from left to right; the line breaks where there is none.
    pub points: Vec<Option<Point>>,
    /// How many pixels it is moved aside, so that error bars do not cover each other.
    pub aside: f64,
    /// Whether runs are behind it; otherwise it is a guide for the eye.
    pub measured: bool,
}

/// A value and how far its error bar reaches either way.
#[derive(Clone, Copy)]
pub struct Point {
    /// Where.
    pub x: f64,
    /// The value.
    pub y: f64,
    /// The length of the bar either way.
    pub bar: Option<f64>,
}

/// Lines and marks.
#[derive(Clone, Copy)]
pub struct Style {
    /// Their colour.
    pub colour: &'static str,
    /// Dashes and gaps.
    pub dash: &'static str,
    /// The mark at each point.
    pub mark: Mark,
}

/// The mark at each point of a curve.
#[derive(Clone, Copy, PartialEq)]
pub enum Mark {
    /// Nothing.
    None,
    /// A disc.
    Filled,
    /// A circle.
    Empty,
}

/// An entry of the key.
pub struct Sample {
    /// What the entry explains.
    pub style: Style,
    /// Its meaning.
    pub text: String,
}

/// The room of a panel and its labels.
pub const CELL: (f64, f64) = (600.0, 470.0);

/// What the longest title needs.
const LEAST_WIDTH: f64 = 760.0;

/// Panels in a row.
const COLUMNS: usize = 2;

/// The room above the panels, and a row of text below them.
const HEAD: f64 = 44.0;
const ROW: f64 = 24.0;

impl Plot {
    /// Draws everything.
    pub fn draw(&self) -> String {
        let columns = self.panels.len().clamp(1, COLUMNS);
        let rows = self.panels.len().div_ceil(COLUMNS);
        let below = ROW * (self.key.len() + 1) as f64 + 12.0;
        let width = (CELL.0 * columns as f64).max(LEAST_WIDTH);
        let indent = (width - CELL.0 * columns as f64) / 2.0;
        let bottom = HEAD + CELL.1 * rows as f64;
        let mut canvas = Canvas::new(width, bottom + below);
        canvas.text((width / 2.0, 30.0), Anchor::Middle, 19.0, INK, &self.title);
        for (index, panel) in self.panels.iter().enumerate() {
            let left = indent + CELL.0 * (index % COLUMNS) as f64;
            let top = HEAD + CELL.1 * (index / COLUMNS) as f64;
            Frame::new(self, left, top).draw(&mut canvas, panel);
        }
        let mut y = bottom + 12.0;
        for row in &self.key {
            draw_key(&mut canvas, row, width / 2.0, y);
            y += ROW;
        }
        canvas.text(
            (width / 2.0, y + 2.0),
            Anchor::Middle,
            12.0,
            GREY,
            &self.note,
        );
        canvas.finish()
    }
}

/// Draws the mark of one point.
pub fn draw_mark(canvas: &mut Canvas, at: (f64, f64), style: Style) {
    let fill = match style.mark {
        Mark::None => return,
        Mark::Filled => style.colour,
        Mark::Empty => "#ffffff",
    };
    canvas.circle(at, 3.4, fill, Stroke::solid(style.colour, 1.5));
}

fn draw_key(canvas: &mut Canvas, samples: &[Sample], middle: f64, y: f64) {
    // Nobody measures text here: about 7 pixels a letter is near enough.
    let widths: Vec<f64> = samples
        .iter()
        .map(|sample| 68.0 + 6.8 * sample.text.chars().count() as f64)
        .collect();
    let mut x = middle - widths.iter().sum::<f64>() / 2.0;
    for (sample, width) in samples.iter().zip(widths) {
        let Style { colour, dash, mark } = sample.style;
        let stroke = Stroke {
            colour,
            width: 2.0,
            dash,
        };
        canvas.line(&[(x, y), (x + 36.0, y)], stroke);
        draw_mark(canvas, (x + 18.0, y), Style { colour, dash, mark });
        let at = (x + 43.0, y + 4.5);
        canvas.text(at, Anchor::Start, 13.0, INK, &sample.text);
        x += width;
    }
}
