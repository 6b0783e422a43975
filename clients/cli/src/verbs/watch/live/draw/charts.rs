//! Order, and drift or a chosen measure, over time.

use jostle_measures::Measure;
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

/// The least width of the axis labels.
const GUTTER: u16 = 3;
/// The spacing of a dotted line, in dots.
const DOT_SPACING: usize = 4;

/// The significant digits of a measure with a unit.
const DIGITS: usize = 3;

/// A number over time.
struct Chart<'a> {
    name: &'a str,
    /// The unit, if the chart is of a measure that has one.
    unit: Option<&'a str>,
    /// The text if no value is defined.
    none: &'a str,
    now: Option<f64>,
    mean: Option<f64>,
    range: [f64; 2],
    color: Color,
    points: Vec<(f64, Option<f64>)>,
}

/// Draws the order, and the drift or the chosen measure, over time.
pub fn draw(frame: &mut Frame<'_>, [order, second]: [Rect; 2], view: &View, palette: Palette) {
    let numbers = view.selected.as_ref().and_then(|it| it.numbers.as_ref());
    let now = numbers.map(|numbers| numbers.order);
    let points = |what: fn(&Point) -> Option<f64>| {
        let points = view.selected.iter().flat_map(|it| it.history.points());
        points.map(|point| (point.time, what(point))).collect()
    };
    let chart = Chart {
        name: "order",
        unit: None,
        none: "",
        now: now.map(|it| it.order),
        mean: now.and_then(|it| it.mean_order),
        range: [0.0, 1.0],
        color: palette.body(),
        points: points(|point| Some(point.order)),
    };
    chart.draw(frame, order, palette);
    if let Some(measure) = view.measure {
        let points = points(|point| point.measure);
        let chart = Chart {
            name: &measure.to_string(),
            unit: Some(measure.definition().unit).filter(|unit| *unit != "1"),
            none: "undefined",
            now: view.selected.as_ref().and_then(|it| it.measured),
            mean: None,
            range: range_of(measure, &points),
            color: palette.informed(),
            points,
        };
        return chart.draw(frame, second, palette);
    }
    let chart = Chart {
        name: "drift",
        unit: None,
        none: "no common direction",
        now: now.and_then(|it| it.drift),
        mean: now.and_then(|it| it.mean_drift),
        range: [-1.0, 1.0],
        color: palette.informed(),
        points: points(|point| point.drift),
    };
    chart.draw(frame, second, palette);
}

impl Chart<'_> {
    fn draw(&self, frame: &mut Frame<'_>, area: Rect, palette: Palette) {
        let share = |number: f64| match self.unit {
            Some(unit) => format!("{} {unit}", format::rounded(number, DIGITS)),
            None => format::share(Some(number)),
        };
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
        let labels = self
            .range
            .map(|number| format!("{:>2}", format::number(number)));
        let width = labels.iter().map(String::len).max().unwrap_or(0);
        let width = u16::try_from(width + 1).unwrap_or(GUTTER).max(GUTTER);
        let columns = Layout::horizontal([Constraint::Length(width), Constraint::Fill(1)]);
        let [gutter, plot] = columns.areas(inner);
        draw_gutter(frame, gutter, labels, palette);
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
            let text = Line::styled(self.none, palette.faint());
            frame.render_widget(text.alignment(Alignment::Center), plot);
        }
    }
}

/// The labels of the axis.
fn draw_gutter(frame: &mut Frame<'_>, area: Rect, [least, most]: [String; 2], palette: Palette) {
    let mut lines = vec![Line::default(); usize::from(area.height)];
    if let Some(last) = lines.last_mut() {
        *last = Line::from(least);
    }
    if let Some(first) = lines.first_mut() {
        *first = Line::from(most);
    }
    frame.render_widget(Paragraph::new(lines).style(palette.faint()), area);
}

/// The axis of a measure: its range if that is from 0 to 1, or else that of the points, with ends of
/// one or two digits.
fn range_of(measure: Measure, points: &[(f64, Option<f64>)]) -> [f64; 2] {
    let values = || points.iter().filter_map(|(_, value)| *value);
    if measure.definition().range == "0 to 1" || values().next().is_none() {
        return [0.0, 1.0];
    }
    let (least, most) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let ends = [least, most].map(|end| {
        if end == 0.0 {
            return 0.0;
        }
        let unit = 10f64.powf(end.abs().log10().floor() - 1.0);
        let outwards = (end.abs() / unit).ceil() * unit;
        // Without the digits of rounding.
        format!("{:.1e}", outwards.copysign(end))
            .parse()
            .unwrap_or(end)
    });
    match ends {
        [0.0, 0.0] => [0.0, 1.0],
        ends => ends,
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
