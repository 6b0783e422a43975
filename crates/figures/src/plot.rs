//! The contents of a figure: panels, curves, marks and the key.

use crate::axis::Axis;
use crate::svg::{Canvas, Stroke};

/// Panels side by side that share their axes.
pub struct Plot {
    /// The title.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The panels, in the order of reading.
    pub panels: Vec<Panel>,
    /// The key, row by row.
    pub key: Vec<Vec<Sample>>,
    /// The note at the bottom.
    pub note: String,
}

/// Curves over common axes.
pub struct Panel {
    /// The contact rule and the time step.
    pub title: String,
    /// The remark below the title.
    pub remark: String,
    /// The curves, later ones on top.
    pub curves: Vec<Curve>,
    /// Areas below the curves.
    pub bands: Vec<Band>,
    /// Values marked at the right edge, and the colour of each mark.
    pub marks: Vec<(f64, &'static str)>,
}

/// An area between two curves.
pub struct Band {
    /// Its colour.
    pub colour: &'static str,
    /// The horizontal value, the lower and the upper end, from left to right.
    pub points: Vec<(f64, f64, f64)>,
}

/// Values joined by a line.
pub struct Curve {
    /// The label beside its end, and the elongation of a body drawn there.
    pub label: Option<(String, Option<f64>)>,
    /// The style of its line and marks.
    pub style: Style,
    /// Its points from left to right; `None` interrupts the line.
    pub points: Vec<Option<Point>>,
    /// Its horizontal offset in pixels, so that error bars do not cover each other.
    pub aside: f64,
    /// Whether it shows measurements; otherwise it is a guide.
    pub measured: bool,
}

/// A point of a curve and its error bar.
#[derive(Clone, Copy)]
pub struct Point {
    /// The horizontal value.
    pub x: f64,
    /// The vertical value.
    pub y: f64,
    /// The length of the error bar up and down.
    pub bar: Option<f64>,
}

/// The style of lines and marks.
#[derive(Clone, Copy)]
pub struct Style {
    /// Their colour.
    pub colour: &'static str,
    /// Lengths of dashes and gaps in SVG syntax; empty for a solid line.
    pub dash: &'static str,
    /// The mark at each point.
    pub mark: Mark,
}

/// The mark at each point of a curve.
#[derive(Clone, Copy, PartialEq)]
pub enum Mark {
    /// No mark.
    None,
    /// A filled disc.
    Filled,
    /// A circle.
    Empty,
}

/// An entry of the key.
pub struct Sample {
    /// The style that the entry explains.
    pub style: Style,
    /// The meaning of the style.
    pub text: String,
}

impl Sample {
    /// Returns its approximate width in pixels. The text is not measured: about 7 pixels a character
    /// is sufficiently accurate.
    pub fn width(&self) -> f64 {
        68.0 + 6.8 * self.text.chars().count() as f64
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
