//! The layout of a figure: its title, panels, key and note.

use crate::frame::{Frame, Margins};
use crate::plot::{Plot, Sample, Style, draw_mark};
use crate::svg::{Anchor, Canvas, GREY, INK, Stroke};
use crate::text;

/// The width of the only panel with its labels and the height of its frame, in pixels.
const ONE: (f64, f64) = (760.0, 480.0);

/// The same of each of several panels.
const SEVERAL: (f64, f64) = (600.0, 390.0);

/// The maximum number of panels in a row.
const COLUMNS: usize = 2;

/// The distance of texts from the edge, in pixels.
const EDGE: f64 = 10.0;

/// The size of the title and the height of one of its lines, in pixels.
const TITLE: (f64, f64) = (19.0, 25.0);

/// The height of a row of the key, and of a line of the note, in pixels.
const ROW: f64 = 22.0;
const NOTE: (f64, f64) = (12.0, 17.0);

impl Plot {
    /// Draws the figure as SVG.
    pub fn draw(&self) -> String {
        let columns = self.panels.len().clamp(1, COLUMNS);
        let rows = self.panels.len().div_ceil(COLUMNS);
        let (cell, height) = if columns == 1 { ONE } else { SEVERAL };
        let margins = Margins::of(self);
        let widths = self
            .key
            .iter()
            .map(|row| row.iter().map(Sample::width).sum());
        let width = widths.fold(cell * columns as f64, |most: f64, row: f64| {
            most.max(row + 2.0 * EDGE)
        });
        let indent = (width - cell * columns as f64) / 2.0;
        let room = width - 2.0 * EDGE;
        let title = text::lines(&self.title, TITLE.0, room);
        let note = text::lines(&self.note, NOTE.0, room);
        let head = EDGE + TITLE.1 * title.len() as f64;
        let row = margins.top + height + margins.bottom;
        let bottom = head + row * rows as f64;
        let below = ROW * self.key.len() as f64 + NOTE.1 * note.len() as f64;
        let mut canvas = Canvas::new(width, bottom + below + EDGE);
        for (index, line) in title.iter().enumerate() {
            let y = EDGE + TITLE.1 * (index as f64 + 0.75);
            canvas.text((width / 2.0, y), Anchor::Middle, TITLE.0, INK, line);
        }
        for (index, panel) in self.panels.iter().enumerate() {
            let left = indent + cell * (index % COLUMNS) as f64;
            let top = head + row * (index / COLUMNS) as f64;
            Frame::new(self, &margins, (left, top), (cell, height)).draw(&mut canvas, panel);
        }
        let mut y = bottom + ROW / 2.0;
        for row in &self.key {
            draw_key(&mut canvas, row, width / 2.0, y);
            y += ROW;
        }
        for line in &note {
            let at = (width / 2.0, y + 2.0);
            canvas.text(at, Anchor::Middle, NOTE.0, GREY, line);
            y += NOTE.1;
        }
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
