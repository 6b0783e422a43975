//! The title line with the endpoint or the swarm, and the status bar with a notice or key hints.

use ratatui::Frame;
use ratatui::layout::{Alignment, Rect};
use ratatui::text::{Line, Span};

use super::palette::glyph;
use super::{Palette, cut};
use crate::format;
use crate::verbs::watch::live::prompt::FIELDS;
use crate::verbs::watch::live::view::View;

/// Key hints, the most important first.
const HINTS: [(&str, &str); 8] = [
    ("q", "quit"),
    ("?", "keys"),
    ("space", "pause/run"),
    ("↑↓", "select"),
    ("/", "filter"),
    ("i", "inform"),
    ("s", "step"),
    ("+-", "zoom"),
];

/// Draws the first line: the endpoint if the list is shown, otherwise the swarm.
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
    let Some(selected) = &view.selected else {
        frame.render_widget(Line::styled("jostle", palette.strong()), area);
        return;
    };
    let mut line = Line::default();
    let swarms = view.swarms.as_deref().unwrap_or_default();
    let at = swarms.iter().position(|it| it.swarm == selected.name);
    let place = at.map_or_else(String::new, |at| format!(" {}/{}", at + 1, swarms.len()));
    if let Some(numbers) = &selected.numbers {
        let phase = numbers.phase;
        line.push_span(Span::styled(glyph(phase), palette.phase(phase)));
        line.push_span(Span::raw(" "));
    }
    let name = cut(
        &selected.name,
        width.saturating_sub(line.width() + place.len()),
    );
    line.push_span(Span::styled(name, palette.strong()));
    line.push_span(Span::styled(place, palette.faint()));
    if let Some(numbers) = &selected.numbers {
        let order = format!("  order {:.2}", numbers.order.order);
        if line.width() + order.len() <= width {
            line.push_span(Span::raw(order));
        }
    }
    frame.render_widget(line, area);
}

/// Draws the last line: the prompt, an outage, a notice, or else key hints.
pub fn draw_status_bar(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let width = usize::from(area.width);
    let line = if let Some(prompt) = &view.prompt {
        let (name, how) = FIELDS[prompt.at];
        let text = format!(" {name}: {}▏", prompt.texts[prompt.at]);
        let rest = prompt.problem.as_deref().unwrap_or(how);
        Line::from(cut(&format!("{text} {rest}"), width))
    } else if view.filter.is_open {
        let (text, shown) = (&view.filter.text, view.visible().count());
        let all = view.swarms.as_ref().map_or(0, Vec::len);
        let notice = view.notice.as_ref().map(|it| it.text.clone());
        let rest = notice.unwrap_or_else(|| format!("{shown} of {all}  Enter: keep, Esc: all"));
        Line::from(cut(&format!(" /{text}▏ {rest}"), width))
    } else if let Some(away) = &view.away {
        Line::styled(cut(&format!(" {away}"), width), palette.error())
    } else if let Some(notice) = &view.notice {
        let style = if notice.is_error {
            palette.error()
        } else {
            palette.strong()
        };
        Line::styled(cut(&format!(" {}", notice.text), width), style)
    } else {
        hints(width, palette)
    };
    frame.render_widget(line, area);
}

fn hints<'a>(width: usize, palette: Palette) -> Line<'a> {
    let mut line = Line::from(" ");
    for (key, action) in HINTS {
        let key = Span::styled(key, palette.strong());
        let action = Span::styled(format!(" {action}   "), palette.faint());
        // Trailing blanks may be cut.
        if line.width() + key.width() + action.width() - 3 > width {
            break;
        }
        line.push_span(key);
        line.push_span(action);
    }
    line
}
