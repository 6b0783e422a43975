//! The numbers of the chosen swarm, and what happened to it.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

use super::{Palette, cut, named};
use crate::format;
use crate::verbs::events::what;
use crate::verbs::watch::live::chosen::Chosen;
use crate::verbs::watch::live::view::View;

/// What stands between two numbers.
const BETWEEN: &str = "  ";

/// Draws the numbers, as many as there is room for, the most telling first.
pub fn draw(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let Some(chosen) = &view.chosen else {
        return;
    };
    let width = usize::from(area.width).saturating_sub(1);
    let mut rows: Vec<Vec<Span<'_>>> = vec![vec![Span::raw(" ")]];
    for number in numbers(chosen, palette) {
        let long: usize = number.iter().map(Span::width).sum();
        let row = rows
            .last()
            .map_or(0, |row| row.iter().map(Span::width).sum());
        if row > 1 && row + BETWEEN.len() + long > width {
            if rows.len() == usize::from(area.height) {
                break;
            }
            rows.push(vec![Span::raw(" ")]);
        } else if row > 1 {
            rows.last_mut()
                .expect("there is one")
                .push(Span::raw(BETWEEN));
        }
        rows.last_mut().expect("there is one").extend(number);
    }
    let lines: Vec<Line<'_>> = rows.into_iter().map(Line::from).collect();
    frame.render_widget(Paragraph::new(lines), area);
}

fn numbers<'a>(chosen: &'a Chosen, palette: Palette) -> Vec<Vec<Span<'a>>> {
    let Some(numbers) = &chosen.numbers else {
        return Vec::new();
    };
    let phase = match &chosen.reason {
        Some(reason) => format!("{} ({reason})", format::phase(numbers.phase)),
        None => format::phase(numbers.phase).into(),
    };
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
    let Some(chosen) = &view.chosen else {
        return;
    };
    let width = usize::from(area.width);
    let newest = chosen.events.iter().rev().take(usize::from(area.height));
    let lines: Vec<Line<'_>> = newest
        .map(|event| {
            let when = format!("{:>9}  ", format!("t {:.1}", event.time));
            let room = width.saturating_sub(when.len());
            Line::from(vec![
                Span::styled(when, palette.faint()),
                Span::raw(cut(&what(&event.event), room)),
            ])
        })
        .collect();
    frame.render_widget(Paragraph::new(lines), area);
}
