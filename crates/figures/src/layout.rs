//! The layout of a figure: its title, panels, key and note.

use crate::frame::Frame;
use crate::plot::{CELL, Plot, Sample, Style, draw_mark};
use crate::svg::{Anchor, Canvas, GREY, INK, Stroke};

/// The width of the longest title, in pixels.
const MIN_WIDTH: f64 = 760.0;

/// The maximum number of panels in a row.
const COLUMNS: usize = 2;

/// The height above the panels, and that of a row of text below them, in pixels.
const HEAD: f64 = 44.0;
const ROW: f64 = 24.0;

impl Plot {
    /// Draws the figure as SVG.
    pub fn draw(&self) -> String {
        let columns = self.panels.len().clamp(1, COLUMNS);
        let rows = self.panels.len().div_ceil(COLUMNS);
        let below = ROW * (self.key.len() + 1) as f64 + 12.0;
        let width = (CELL.0 * columns as f64).max(MIN_WIDTH);
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

/// Draws a row of the key, centred at `middle`.
fn draw_key(canvas: &mut Canvas, samples: &[Sample], middle: f64, y: f64) {
    let widths: Vec<f64> = samples.iter().map(Sample::width).collect();
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
