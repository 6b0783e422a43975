//! A writer of SVG with the few elements that the figures need.

use std::fmt::Write;

/// The colour of axes, text and outlines.
pub const INK: &str = "#222222";

/// The colour of notes and other secondary elements.
pub const GREY: &str = "#6b6b6b";

/// The colour of grid lines.
pub const FAINT: &str = "#e3e3e3";

/// The colours of Okabe and Ito, which people with colour blindness can distinguish, without the
/// yellow, which is too pale for lines.
pub const PALETTE: [&str; 7] = [
    "#D55E00", "#E69F00", "#009E73", "#56B4E9", "#0072B2", "#CC79A7", "#000000",
];

/// A picture being drawn. Coordinates are pixels from the upper left corner.
pub struct Canvas {
    text: String,
}

/// The point of a text that is at its position.
#[derive(Clone, Copy)]
pub enum Anchor {
    /// Its beginning.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// The style of a line.
#[derive(Clone, Copy)]
pub struct Stroke<'a> {
    /// Its colour.
    pub colour: &'a str,
    /// Its width.
    pub width: f64,
    /// Lengths of dashes and gaps in SVG syntax; empty for a solid line.
    pub dash: &'a str,
}

impl<'a> Stroke<'a> {
    /// Creates a solid line.
    pub fn solid(colour: &'a str, width: f64) -> Self {
        let dash = "";
        Self {
            colour,
            width,
            dash,
        }
    }
}

impl Canvas {
    /// Begins a picture with a white background.
    pub fn new(width: f64, height: f64) -> Self {
        let mut canvas = Self {
            text: String::new(),
        };
        canvas.push(&format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" \
             font-family=\"Noto Sans, DejaVu Sans, Arial, sans-serif\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>"
        ));
        canvas
    }

    /// Draws a line through `points`.
    pub fn line(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>) {
        let points: Vec<String> = points
            .iter()
            .map(|&(x, y)| format!("{},{}", number(x), number(y)))
            .collect();
        self.push(&format!(
            "<polyline points=\"{}\" fill=\"none\"{}/>",
            points.join(" "),
            stroke_of(stroke)
        ));
    }

    /// Draws a circle.
    pub fn circle(&mut self, centre: (f64, f64), radius: f64, fill: &str, stroke: Stroke<'_>) {
        self.push(&format!(
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"{fill}\"{}/>",
            number(centre.0),
            number(centre.1),
            number(radius),
            stroke_of(stroke)
        ));
    }

    /// Draws a filled polygon.
    pub fn polygon(&mut self, points: &[(f64, f64)], fill: &str) {
        self.filled(points, fill, "");
    }

    /// Draws a polygon through which what is below it is seen.
    pub fn band(&mut self, points: &[(f64, f64)], fill: &str, opacity: f64) {
        self.filled(points, fill, &format!(" fill-opacity=\"{opacity:.2}\""));
    }

    fn filled(&mut self, points: &[(f64, f64)], fill: &str, opacity: &str) {
        let points: Vec<String> = points
            .iter()
            .map(|&(x, y)| format!("{},{}", number(x), number(y)))
            .collect();
        self.push(&format!(
            "<polygon points=\"{}\" fill=\"{fill}\"{opacity}/>",
            points.join(" ")
        ));
    }

    /// Draws a body: a capsule whose axis is turned by `angle` radians counter-clockwise from +x.
    pub fn capsule(
        &mut self,
        centre: (f64, f64),
        angle: f64,
        (half_length, radius): (f64, f64),
        fill: &str,
        stroke: Stroke<'_>,
    ) {
        self.push(&format!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"{r}\" \
             transform=\"translate({} {}) rotate({})\" fill=\"{fill}\"{}/>",
            number(-half_length - radius),
            number(-radius),
            number(2.0 * (half_length + radius)),
            number(2.0 * radius),
            number(centre.0),
            number(centre.1),
            // The picture's y axis points down.
            number(-angle.to_degrees()),
            stroke_of(stroke),
            r = number(radius),
        ));
    }

    /// Writes `text`, in which `_x` and `_{xyz}` are subscripts.
    pub fn text(&mut self, at: (f64, f64), anchor: Anchor, size: f64, colour: &str, text: &str) {
        self.turned_text(at, anchor, size, colour, text, 0.0);
    }

    /// Writes `text` from bottom to top.
    pub fn rising_text(&mut self, at: (f64, f64), size: f64, colour: &str, text: &str) {
        self.turned_text(at, Anchor::Middle, size, colour, text, -90.0);
    }

    /// Ends the picture and returns its text.
    pub fn finish(mut self) -> String {
        self.push("</svg>");
        self.text
    }

    fn turned_text(
        &mut self,
        (x, y): (f64, f64),
        anchor: Anchor,
        size: f64,
        colour: &str,
        text: &str,
        degrees: f64,
    ) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let turn = match degrees {
            0.0 => String::new(),
            _ => format!(
                " transform=\"rotate({degrees} {} {})\"",
                number(x),
                number(y)
            ),
        };
        self.push(&format!(
            "<text x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\" font-size=\"{}\" \
             fill=\"{colour}\"{turn}>{}</text>",
            number(x),
            number(y),
            number(size),
            with_subscripts(text, size)
        ));
    }

    fn push(&mut self, element: &str) {
        self.text.push_str(element);
        self.text.push('\n');
    }
}

/// Formats a coordinate to a hundredth of a pixel, without trailing zeros.
fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "-0" => "0".to_owned(),
        _ => text.to_owned(),
    }
}

fn stroke_of(stroke: Stroke<'_>) -> String {
    let mut text = format!(
        " stroke=\"{}\" stroke-width=\"{}\"",
        stroke.colour,
        number(stroke.width)
    );
    if !stroke.dash.is_empty() {
        // Writing to a string cannot fail.
        let _ = write!(text, " stroke-dasharray=\"{}\"", stroke.dash);
    }
    text
}

/// Lowers subscripts by shifting the text, since not every viewer supports `baseline-shift`.
fn with_subscripts(text: &str, size: f64) -> String {
    let (drop, small) = (number(0.22 * size), number(0.75 * size));
    let mut spans = String::new();
    let mut rest = text;
    let mut raise = "";
    while let Some((plain, after)) = rest.split_once('_') {
        let (low, following) = match after.strip_prefix('{').and_then(|it| it.split_once('}')) {
            Some(braced) => braced,
            None => after.split_at(after.chars().next().map_or(0, char::len_utf8)),
        };
        spans += &span(plain, raise);
        spans += &format!(
            "<tspan dy=\"{drop}\" font-size=\"{small}\">{}</tspan>",
            escape(low)
        );
        (raise, rest) = (&drop, following);
    }
    spans + &span(rest, raise)
}

fn span(text: &str, raise: &str) -> String {
    match (text, raise) {
        ("", _) => String::new(),
        (_, "") => escape(text),
        _ => format!("<tspan dy=\"-{raise}\">{}</tspan>", escape(text)),
    }
}

/// Stands for an underscore in a text with subscripts.
const UNDERSCORE: char = '\u{e000}';

/// Returns a text whose underscores are no subscripts.
pub fn literal(text: &str) -> String {
    text.replace('_', UNDERSCORE.encode_utf8(&mut [0; 4]))
}

fn escape(text: &str) -> String {
    text.replace(UNDERSCORE, "_")
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_short_and_never_minus_zero() {
        let written = [1.0, 0.125, -0.001, -2.5, 1200.0].map(number);
        assert_eq!(written, ["1", "0.12", "0", "-2.5", "1200"]);
    }

    #[test]
    fn subscripts_are_lowered_and_text_is_escaped() {
        assert_eq!(with_subscripts("a < b", 10.0), "a &lt; b");
        assert_eq!(with_subscripts(&literal("radius_of"), 10.0), "radius_of");
        assert_eq!(
            with_subscripts("v_{ind}(n)", 10.0),
            "v<tspan dy=\"2.2\" font-size=\"7.5\">ind</tspan><tspan dy=\"-2.2\">(n)</tspan>"
        );
        assert_eq!(
            with_subscripts("π_1", 10.0),
            "π<tspan dy=\"2.2\" font-size=\"7.5\">1</tspan>"
        );
    }
}
