//! The first line, which says where one is, and the last, which says what may be done or went
//! wrong.

use ratatui::Frame;
use ratatui::layout::{Alignment, Rect};
use ratatui::text::{Line, Span};

use super::palette::glyph;
use super::{Palette, cut};
use crate::format;
use crate::verbs::watch::live::prompt::QUESTIONS;
use crate::verbs::watch::live::view::View;

/// The keys that most want to know, the most wanted first.
const HINTS: [(&str, &str); 7] = [
    ("q", "quit"),
    ("?", "keys"),
    ("space", "pause/run"),
    ("↑↓", "choose"),
    ("i", "inform"),
    ("s", "step"),
    ("+-", "zoom"),
];

/// Draws the first line: where the list is in sight the daemon, else the swarm.
pub fn draw_title(
    frame: &mut Frame<'_>,
    area: Rect,
    view: &View,
    palette: Palette,
    is_list_shown: bool,
) {
    let width = usize::from(area.width);
    if is_list_shown {
        let line = Line::from(vec![
            Span::styled(" jostle", palette.strong()),
            Span::styled(format!("  {}", view.endpoint), palette.faint()),
        ]);
        frame.render_widget(line, area);
        let count = view.swarms.as_ref().map(|it| it.len() as u64);
        let count = count.map_or_else(String::new, |it| format::count(it, "swarm"));
        let count = Line::styled(count + " ", palette.faint());
        frame.render_widget(count.alignment(Alignment::Right), area);
        return;
    }
    let Some(chosen) = &view.chosen else {
        frame.render_widget(Line::styled("jostle", palette.strong()), area);
        return;
    };
    let mut line = Line::default();
    let swarms = view.swarms.as_deref().unwrap_or_default();
    let at = swarms.iter().position(|it| it.swarm == chosen.name);
    let place = at.map_or_else(String::new, |at| format!(" {}/{}", at + 1, swarms.len()));
    if let Some(numbers) = &chosen.numbers {
        let phase = numbers.phase;
        line.push_span(Span::styled(glyph(phase), palette.phase(phase)));
        line.push_span(Span::raw(" "));
    }
    let name = cut(
        &chosen.name,
        width.saturating_sub(line.width() + place.len()),
    );
    line.push_span(Span::styled(name, palette.strong()));
    line.push_span(Span::styled(place, palette.faint()));
    if let Some(numbers) = &chosen.numbers {
        let order = format!("  order {:.2}", numbers.order.order);
        if line.width() + order.len() <= width {
            line.push_span(Span::raw(order));
        }
    }
    frame.render_widget(line, area);
}

/// Draws the last line: what went wrong, is asked or was said, or else what keys there are.
pub fn draw_foot(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let width = usize::from(area.width);
    let line = if let Some(prompt) = &view.prompt {
        let (name, how) = QUESTIONS[prompt.at];
        let answer = format!(" {name}: {}▏", prompt.answers[prompt.at]);
        let rest = prompt.problem.as_deref().unwrap_or(how);
        Line::from(cut(&format!("{answer} {rest}"), width))
    } else if let Some(away) = &view.away {
        Line::styled(cut(&format!(" {away}"), width), palette.error())
    } else if let Some(said) = &view.said {
        let style = if said.is_error {
            palette.error()
        } else {
            palette.strong()
        };
        Line::styled(cut(&format!(" {}", said.text), width), style)
    } else {
        hints(width, palette)
    };
    frame.render_widget(line, area);
}

fn hints<'a>(width: usize, palette: Palette) -> Line<'a> {
    let mut line = Line::from(" ");
    for (key, does) in HINTS {
        let key = Span::styled(key, palette.strong());
        let does = Span::styled(format!(" {does}   "), palette.faint());
        // The blanks at its end may be cut.
        if line.width() + key.width() + does.width() - 3 > width {
            break;
        }
        line.push_span(key);
        line.push_span(does);
    }
    line
}
