//! Order and drift over time.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;
use ratatui::widgets::canvas::{Canvas, Line as Stroke, Points};

use super::{Palette, frame_of};
use crate::format;
use crate::verbs::watch::live::history::Point;
use crate::verbs::watch::live::view::View;

/// The width of the axis labels.
const GUTTER: u16 = 3;
/// The spacing of a dotted line, in dots.
const DOT_SPACING: usize = 4;

/// A number over time.
struct Chart<'a> {
    name: &'a str,
    now: Option<f64>,
    mean: Option<f64>,
    range: [f64; 2],
    color: Color,
    points: Vec<(f64, Option<f64>)>,
}

/// Draws the order and the drift over time.
pub fn draw(frame: &mut Frame<'_>, [order, drift]: [Rect; 2], view: &View, palette: Palette) {
    let numbers = view.selected.as_ref().and_then(|it| it.numbers.as_ref());
    let now = numbers.map(|numbers| numbers.order);
    let points = |what: fn(&Point) -> Option<f64>| {
        let points = view.selected.iter().flat_map(|it| it.history.points());
        points.map(|point| (point.time, what(point))).collect()
    };
    let chart = Chart {
        name: "order",
        now: now.map(|it| it.order),
        mean: now.and_then(|it| it.mean_order),
        range: [0.0, 1.0],
        color: palette.body(),
        points: points(|point| Some(point.order)),
    };
    chart.draw(frame, order, palette);
    let chart = Chart {
        name: "drift",
        now: now.and_then(|it| it.drift),
        mean: now.and_then(|it| it.mean_drift),
        range: [-1.0, 1.0],
        color: palette.informed(),
        points: points(|point| point.drift),
    };
    chart.draw(frame, drift, palette);
}

impl Chart<'_> {
    fn draw(&self, frame: &mut Frame<'_>, area: Rect, palette: Palette) {
        let share = |number: f64| format::share(Some(number));
        let mut title = vec![Span::raw(format!(" {} ", self.name))];
        if let Some(now) = self.now {
            title.push(Span::styled(share(now) + " ", palette.strong()));
        }
        if let Some(mean) = self.mean {
            title.push(Span::styled(
                format!("mean {} ", share(mean)),
                palette.faint(),
            ));
        }
        let mut block = frame_of(palette).title_top(Line::from(title));
        let times = self.points.first().zip(self.points.last());
        let times = times.map(|(first, last)| [first.0, last.0]);
        if let Some([first, last]) = times {
            let text = format!(" t {first:.0} to {last:.0} ");
            block = block.title_bottom(Line::from(text).alignment(Alignment::Right));
        }
        let inner = block.inner(area);
        frame.render_widget(block, area);
        let columns = Layout::horizontal([Constraint::Length(GUTTER), Constraint::Fill(1)]);
        let [gutter, plot] = columns.areas(inner);
        self.draw_gutter(frame, gutter, palette);
        // No scale before two times differ.
        let Some([first, last]) = times.filter(|[first, last]| last > first) else {
            return;
        };
        let dotted = dotted([first, last], plot.width);
        let canvas = Canvas::default()
            .marker(Marker::Braille)
            .x_bounds([first, last])
            .y_bounds(self.range)
            .paint(|context| {
                if self.range[0] < 0.0 {
                    context.draw(&Points {
                        coords: &dotted,
                        color: palette.grid(),
                    });
                }
                for pair in self.points.windows(2) {
                    if let [(x1, Some(y1)), (x2, Some(y2))] = pair {
                        context.draw(&Stroke::new(*x1, *y1, *x2, *y2, self.color));
                    }
                }
            });
        frame.render_widget(canvas, plot);
        if self.points.iter().all(|(_, number)| number.is_none()) {
            let text = Line::styled("no direction given", palette.faint());
            frame.render_widget(text.alignment(Alignment::Center), plot);
        }
    }

    /// The labels of the axis.
    fn draw_gutter(&self, frame: &mut Frame<'_>, area: Rect, palette: Palette) {
        let [least, most] = self.range;
        let mut lines = vec![Line::default(); usize::from(area.height)];
        if let Some(last) = lines.last_mut() {
            *last = Line::from(format!("{least:>2}"));
        }
        if let Some(first) = lines.first_mut() {
            *first = Line::from(format!("{most:>2}"));
        }
        frame.render_widget(Paragraph::new(lines).style(palette.faint()), area);
    }
}

/// A dotted line at zero.
fn dotted([first, last]: [f64; 2], width: u16) -> Vec<(f64, f64)> {
    let dots = 2 * usize::from(width);
    let share = |dot: usize| dot as f64 / dots.max(2).saturating_sub(1) as f64;
    (0..dots)
        .step_by(DOT_SPACING)
        .map(|dot| (first + (last - first) * share(dot), 0.0))
        .collect()
}
