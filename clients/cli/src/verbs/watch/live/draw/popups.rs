//! Popups: the keys, and the prompt of `inform`.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Clear, Paragraph};

use super::{Palette, boxed, cut};
use crate::verbs::watch::live::keys::KEYS;
use crate::verbs::watch::live::prompt::{FIELDS, Prompt};
use crate::verbs::watch::live::view::View;

/// The least size of the prompt; in less the status bar shows one field at a time.
const MIN_PROMPT: (u16, u16) = (46, 8);

/// Draws the open popup.
pub fn draw(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    if let Some(prompt) = &view.prompt {
        if area.width >= MIN_PROMPT.0 && area.height >= MIN_PROMPT.1 {
            draw_prompt(frame, area, prompt, palette);
        }
    } else if view.is_help_shown {
        draw_keys(frame, area, palette);
    }
}

fn draw_keys(frame: &mut Frame<'_>, area: Rect, palette: Palette) {
    let lines: Vec<Line<'_>> = KEYS
        .iter()
        .map(|(key, action)| {
            let key = Span::styled(format!(" {key:9}"), palette.strong());
            Line::from(vec![key, Span::raw(*action)])
        })
        .collect();
    popup(frame, area, palette, " keys ", lines);
}

fn draw_prompt(frame: &mut Frame<'_>, area: Rect, prompt: &Prompt, palette: Palette) {
    let fields = FIELDS.iter().zip(&prompt.texts).enumerate();
    let mut lines: Vec<Line<'_>> = fields
        .map(|(index, ((name, how), text))| {
            let is_at = index == prompt.at;
            let (mark, end) = if is_at { ("›", "▏") } else { (" ", " ") };
            let text = format!("{text}{end}");
            let style = if is_at {
                palette.strong()
            } else {
                palette.faint()
            };
            Line::from(vec![
                Span::styled(format!("{mark} {name:10}"), style),
                Span::raw(format!("{text:8} ")),
                Span::styled(*how, palette.faint()),
            ])
        })
        .collect();
    lines.push(match &prompt.problem {
        Some(problem) => Line::styled(format!("  {problem}"), palette.error()),
        None => Line::styled("  Enter: next, Esc: cancel", palette.faint()),
    });
    popup(
        frame,
        area,
        palette,
        &format!(" inform some of {} ", prompt.swarm),
        lines,
    );
}

/// Draws lines in a box in the middle, as many as fit.
fn popup(frame: &mut Frame<'_>, area: Rect, palette: Palette, title: &str, lines: Vec<Line<'_>>) {
    let widest = lines.iter().map(Line::width).max().unwrap_or(0);
    let widest = widest.max(title.chars().count()) + 3;
    let width = u16::try_from(widest).unwrap_or(u16::MAX).min(area.width);
    let tall = u16::try_from(lines.len() + 2).unwrap_or(u16::MAX);
    let height = tall.min(area.height);
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, place);
    let title = cut(title, usize::from(width.saturating_sub(2)));
    let inner = boxed(frame, place, palette, title);
    frame.render_widget(Paragraph::new(lines), inner);
}
