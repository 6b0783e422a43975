//! The numbers and the events of the selected swarm.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

use super::{Palette, cut, named};
use crate::format;
use crate::verbs::events::describe;
use crate::verbs::watch::live::selected::Selected;
use crate::verbs::watch::live::view::View;

/// Between two numbers.
const SEPARATOR: &str = "  ";

/// Draws as many numbers as fit, the most important first.
pub fn draw(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let Some(selected) = &view.selected else {
        return;
    };
    let width = usize::from(area.width).saturating_sub(1);
    let mut lines = vec![Line::from(" ")];
    for number in numbers(selected, palette) {
        let long: usize = number.iter().map(Span::width).sum();
        let mut line = lines.pop().expect("there is one");
        if line.width() > 1 {
            if line.width() + SEPARATOR.len() + long > width {
                lines.push(line);
                if lines.len() == usize::from(area.height) {
                    break;
                }
                line = Line::from(" ");
            } else {
                line.push_span(SEPARATOR);
            }
        }
        line.extend(number);
        lines.push(line);
    }
    frame.render_widget(Paragraph::new(lines), area);
}

fn numbers<'a>(selected: &'a Selected, palette: Palette) -> Vec<Vec<Span<'a>>> {
    let Some(numbers) = &selected.numbers else {
        return Vec::new();
    };
    let phase = format::phase(numbers.phase, selected.reason.as_deref());
    let speed = match numbers.real_time_factor {
        Some(_) => format!(
            "{} of {}",
            format::factor(numbers.real_time_factor),
            format::rate(numbers.rate)
        ),
        None => format::rate(numbers.rate),
    };
    let certificate = &numbers.certificate;
    let mut all = vec![
        named(palette, "step", numbers.step.to_string()),
        named(palette, "t", format::time(numbers.time)),
        vec![Span::styled(phase, palette.phase(numbers.phase))],
        named(palette, "speed", speed),
        named(palette, "n", numbers.n.to_string()),
        named(palette, "informed", numbers.informed.to_string()),
        named(palette, "contacts", certificate.contacts.to_string()),
        named(
            palette,
            "worst gap",
            format::magnitude(certificate.worst_gap),
        ),
        named(
            palette,
            "residual",
            format::magnitude(Some(certificate.residual)),
        ),
    ];
    for (name, value) in numbers.measures.iter().flatten() {
        let value = value.map(|value| format::rounded(value, 4));
        all.push(named(palette, name, format::or_none(value)));
    }
    for (name, count) in [
        ("degraded", certificate.degraded),
        ("crossed", certificate.crossed),
    ] {
        if count > 0 {
            all.push(vec![Span::styled(
                format!("{name} {count}"),
                palette.error(),
            )]);
        }
    }
    all
}

/// Draws the newest events, the newest first.
pub fn draw_events(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let Some(selected) = &view.selected else {
        return;
    };
    let width = usize::from(area.width);
    let newest = selected.events.iter().rev().take(usize::from(area.height));
    let lines: Vec<Line<'_>> = newest
        .map(|event| {
            let when = format!("{:>9}  ", format!("t {:.1}", event.time));
            let room = width.saturating_sub(when.len());
            Line::from(vec![
                Span::styled(when, palette.faint()),
                Span::raw(cut(&describe(&event.event), room)),
            ])
        })
        .collect();
    frame.render_widget(Paragraph::new(lines), area);
}
