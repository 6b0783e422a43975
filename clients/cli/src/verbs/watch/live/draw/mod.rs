//! Draws a view: the layout at each size.

mod bodies;
mod charts;
mod numbers;
mod palette;
mod popups;
mod status_bar;
mod swarms;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, BorderType};

pub use self::palette::Palette;
use super::view::View;

/// The least size that has boxes, the list and the charts.
const MIN_FULL: (u16, u16) = (60, 16);
/// The height of the events with their box.
const EVENTS: u16 = 6;

/// Draws a view.
pub fn draw(frame: &mut Frame<'_>, view: &View, palette: Palette) {
    let area = frame.area();
    let is_roomy = area.width >= MIN_FULL.0 && area.height >= MIN_FULL.1;
    let rows = Layout::vertical([
        Constraint::Length(u16::from(area.height > 4)),
        Constraint::Fill(1),
        Constraint::Length(1),
    ]);
    let [title, middle, bottom] = rows.areas(area);
    status_bar::draw_title(frame, title, view, palette, is_roomy);
    let main = if is_roomy {
        let width = (area.width / 4 + 4).clamp(26, 38);
        let columns = Layout::horizontal([Constraint::Length(width), Constraint::Fill(1)]);
        let [side, main] = columns.areas(middle);
        draw_side(frame, side, view, palette);
        main
    } else {
        middle
    };
    draw_main(frame, main, view, palette, is_roomy);
    status_bar::draw_status_bar(frame, bottom, view, palette);
    popups::draw(frame, middle, view, palette);
}

/// The list and, below, the charts of order and drift.
fn draw_side(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let count = view.swarms.as_ref().map_or(0, Vec::len);
    let wanted = u16::try_from(count).unwrap_or(u16::MAX).saturating_add(3);
    let most = (area.height / 3).max(5);
    let rows = Layout::vertical([
        Constraint::Length(wanted.clamp(5, most)),
        Constraint::Fill(1),
        Constraint::Fill(1),
    ]);
    let [list, order, drift] = rows.areas(area);
    let title = match view.filter.text.as_str() {
        "" => " swarms ".to_owned(),
        text => cut(
            &format!(" swarms /{text} "),
            usize::from(list.width.saturating_sub(2)),
        ),
    };
    let inner = boxed(frame, list, palette, title);
    swarms::draw(frame, inner, view, palette);
    charts::draw(frame, [order, drift], view, palette);
}

/// The bodies of the selected swarm, its numbers and its events.
fn draw_main(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette, is_roomy: bool) {
    let numbers = match area.height {
        0..5 => 1,
        5..20 => 2,
        _ if area.width < 76 => 3,
        _ => 2,
    };
    let events = if is_roomy && area.height >= 20 {
        EVENTS
    } else {
        0
    };
    let rows = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(numbers),
        Constraint::Length(events),
    ]);
    let [bodies, numbers, events] = rows.areas(area);
    bodies::draw(frame, bodies, view, palette, is_roomy);
    numbers::draw(frame, numbers, view, palette);
    if events.height > 0 {
        let inner = boxed(frame, events, palette, " events ");
        numbers::draw_events(frame, inner, view, palette);
    }
}

/// Draws a box and returns what is inside of it.
fn boxed<'a>(
    frame: &mut Frame<'_>,
    area: Rect,
    palette: Palette,
    title: impl Into<Line<'a>>,
) -> Rect {
    let block = frame_of(palette).title_top(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

/// An empty box.
fn frame_of<'a>(palette: Palette) -> Block<'a> {
    Block::bordered()
        .border_type(BorderType::Rounded)
        .border_style(palette.faint())
}

/// Truncates text to `width` columns.
fn cut(text: &str, width: usize) -> String {
    console::truncate_str(text, width, "…").into_owned()
}

/// A name and its value.
fn named<'a>(palette: Palette, name: &'a str, value: String) -> Vec<Span<'a>> {
    vec![
        Span::styled(name, palette.faint()),
        Span::raw(" "),
        Span::raw(value),
    ]
}
