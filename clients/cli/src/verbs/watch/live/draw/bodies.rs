//! The bodies of the selected swarm, in Braille: eight dots a character.

use jostle_proto::State;
use ratatui::Frame;
use ratatui::layout::{Alignment, Rect};
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;
use ratatui::widgets::canvas::{Canvas, Context, Line as Stroke, Points};

use super::palette::glyph;
use super::{Palette, frame_of};
use crate::verbs::watch::live::camera::{Camera, origin_of};
use crate::verbs::watch::live::selected::Selected;
use crate::verbs::watch::live::view::View;

/// The least length of a body, in dots, that is drawn as an arrow; a shorter one has a bright head.
const MIN_ARROW_DOTS: f64 = 9.0;
/// The length of an arrow's barbs and how far they are bent back.
const BARB_LENGTH: f64 = 0.5;
const BARB_ANGLE: f64 = 2.65;
/// The length of the line in the direction of an informed body.
const DIRECTION_LENGTH: f64 = 1.0;
/// The least dots between two marks of the grid.
const MIN_GRID_DOTS: f64 = 14.0;
/// The least dots of the scale bar.
const MIN_BAR_DOTS: f64 = 12.0;

/// Draws the bodies, with a box or without.
pub fn draw(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette, has_box: bool) {
    let Some(selected) = &view.selected else {
        return draw_nothing(frame, area, view, palette, has_box);
    };
    let mut inner = area;
    if has_box {
        inner = frame_of(palette).inner(area);
    }
    let viewport = Viewport::of(&view.camera, inner);
    if has_box {
        let mut block = frame_of(palette).title_top(title(selected, palette));
        if !view.camera.follows {
            let title = Line::from(" not following · f ").alignment(Alignment::Right);
            block = block.title_top(title);
        }
        if let Some(bar) = viewport.scale_bar().filter(|_| selected.state.is_some()) {
            block = block.title_bottom(Line::from(bar).alignment(Alignment::Right));
        }
        frame.render_widget(block, area);
    }
    let Some(state) = selected.state.as_ref().filter(|_| viewport.per_unit > 0.0) else {
        return;
    };
    let canvas = Canvas::default()
        .marker(Marker::Braille)
        .x_bounds(viewport.x)
        .y_bounds(viewport.y)
        .paint(|context| {
            context.draw(&Points {
                coords: &viewport.grid(),
                color: palette.grid(),
            });
            draw_bodies(context, state, selected.pi1, &viewport, palette);
        });
    frame.render_widget(canvas, inner);
}

/// The visible part of the plane, in absolute positions.
struct Viewport {
    x: [f64; 2],
    y: [f64; 2],
    /// Dots per body size.
    per_unit: f64,
}

impl Viewport {
    /// The smallest part that contains the camera's rectangle; dots are square.
    fn of(camera: &Camera, area: Rect) -> Self {
        let dots = [2.0 * f64::from(area.width), 4.0 * f64::from(area.height)];
        let per_unit = camera.reach.map_or(0.0, |reach| {
            let across = dots[0] / (2.0 * reach[0]);
            across.min(dots[1] / (2.0 * reach[1]))
        });
        let range = |axis: usize| {
            let half = (dots[axis] - 1.0) / 2.0 / per_unit;
            [camera.centre[axis] - half, camera.centre[axis] + half]
        };
        Viewport {
            x: range(0),
            y: range(1),
            per_unit,
        }
    }

    /// A grid of marks, which shows the motion of the group while the camera follows it.
    fn grid(&self) -> Vec<(f64, f64)> {
        let spacing = round_up(MIN_GRID_DOTS / self.per_unit);
        let marks = |range: [f64; 2]| {
            let first = (range[0] / spacing).ceil();
            // Never reached: the marks are `MIN_GRID_DOTS` dots apart.
            (0..u16::MAX)
                .map(move |index| (first + f64::from(index)) * spacing)
                .take_while(move |mark| *mark <= range[1])
        };
        marks(self.x)
            .flat_map(|x| marks(self.y).map(move |y| (x, y)))
            .collect()
    }

    /// A bar of a round length.
    fn scale_bar(&self) -> Option<String> {
        if self.per_unit <= 0.0 {
            return None;
        }
        let length = round_up(MIN_BAR_DOTS / self.per_unit);
        let cells = (length * self.per_unit / 2.0).round();
        let cells = (1..=40).take_while(|it| f64::from(*it) <= cells).count();
        let unit = if length == 1.0 {
            "body size"
        } else {
            "body sizes"
        };
        let line = "─".repeat(cells.saturating_sub(2));
        Some(format!(" {length} {unit} ├{line}┤ "))
    }
}

/// The least of 1, 2, 5, 10, … that is not less.
fn round_up(length: f64) -> f64 {
    let power = 10.0_f64.powf(length.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0];
    let step = steps.iter().find(|step| **step * power >= length);
    step.unwrap_or(&10.0) * power
}

fn title<'a>(selected: &'a Selected, palette: Palette) -> Line<'a> {
    let mut spans = vec![
        Span::raw(" "),
        Span::styled(selected.name.as_str(), palette.strong()),
        Span::raw(" "),
    ];
    if let Some(numbers) = &selected.numbers {
        let phase = numbers.phase;
        let text = format!("{} {} ", glyph(phase), phase.name());
        spans.push(Span::styled(text, palette.phase(phase)));
    }
    Line::from(spans)
}

fn draw_bodies(
    context: &mut Context<'_>,
    state: &State,
    pi1: f64,
    viewport: &Viewport,
    palette: Palette,
) {
    // The axis up to both ends: h + r, with r = 1/(2 + p), h = p r and p = pi1 - 1.
    let half = pi1 / (1.0 + pi1);
    let is_arrow = 2.0 * half * viewport.per_unit >= MIN_ARROW_DOTS;
    let [x, y] = origin_of(state);
    // Informed bodies are drawn on top.
    for is_informed in [false, true] {
        for index in 0..state.id.len() {
            if (state.weight[index] > 0.0) != is_informed {
                continue;
            }
            let (x, y, alpha) = (x + state.x[index], y + state.y[index], state.alpha[index]);
            let mut stroke = |from: (f64, f64), angle: f64, length: f64, color: Color| {
                let (sin, cos) = angle.sin_cos();
                let to = (from.0 + length * cos, from.1 + length * sin);
                context.draw(&Stroke::new(from.0, from.1, to.0, to.1, color));
                to
            };
            let color = if is_informed {
                palette.informed()
            } else {
                palette.body()
            };
            let (sin, cos) = alpha.sin_cos();
            let tail = (x - half * cos, y - half * sin);
            let head = stroke(tail, alpha, 2.0 * half, color);
            if is_informed {
                stroke(
                    head,
                    state.direction[index],
                    DIRECTION_LENGTH,
                    palette.direction(),
                );
            }
            if is_arrow {
                stroke(head, alpha + BARB_ANGLE, BARB_LENGTH, color);
                stroke(head, alpha - BARB_ANGLE, BARB_LENGTH, color);
            } else {
                stroke(head, alpha, 0.0, palette.head());
            }
            if is_informed && !palette.is_coloured {
                context.print(x, y, "●");
            }
        }
    }
}

/// The text shown without a swarm.
fn draw_nothing(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette, has_box: bool) {
    let mut inner = area;
    if has_box {
        inner = frame_of(palette).inner(area);
        frame.render_widget(frame_of(palette), area);
    }
    let lines: Vec<Line<'_>> = match &view.swarms {
        Some(_) => vec![
            Line::from("no swarms here"),
            Line::styled("jostle create demo --n 50", palette.strong()),
            Line::from("makes one"),
        ],
        None => vec![Line::styled(
            "loading the list of swarms …",
            palette.faint(),
        )],
    };
    let top = inner.height.saturating_sub(3) / 2;
    let middle = Rect {
        y: inner.y + top,
        height: inner.height - top,
        ..inner
    };
    let text = Paragraph::new(lines).alignment(Alignment::Center);
    frame.render_widget(text, middle);
}
