//! The list of swarms.

use jostle_proto::SwarmSummary;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

use super::palette::glyph;
use super::{Palette, cut};
use crate::format;
use crate::verbs::watch::live::view::View;

/// The least width of a name when the speed is shown.
const NAME: usize = 8;
/// The widths of the columns of numbers.
const N: usize = 6;
const ORDER: usize = 6;
const SPEED: usize = 6;

/// Draws the list, scrolled to the selected swarm.
pub fn draw(frame: &mut Frame<'_>, area: Rect, view: &View, palette: Palette) {
    let width = usize::from(area.width);
    let fixed = 2 + N + ORDER;
    let with_speed = width >= fixed + NAME + SPEED;
    let name = width.saturating_sub(fixed + if with_speed { SPEED } else { 0 });
    let mut header = format!("  {:name$}{:>N$}{:>ORDER$}", "name", "n", "order");
    if with_speed {
        header.push_str(&format!("{:>SPEED$}", "speed"));
    }
    let mut lines = vec![Line::styled(header, palette.faint())];
    match view.swarms.as_deref() {
        None => lines.push(Line::styled("loading …", palette.faint())),
        Some([]) => lines.push(Line::styled("none yet", palette.faint())),
        Some(_) => {
            let swarms: Vec<&SwarmSummary> = view.visible().collect();
            if swarms.is_empty() {
                lines.push(Line::styled("none matches", palette.faint()));
            }
            let selected = view.selected.as_ref().map(|it| it.name.as_str());
            let at = swarms
                .iter()
                .position(|it| Some(it.swarm.as_str()) == selected);
            let room = usize::from(area.height).saturating_sub(1).max(1);
            let first = at.unwrap_or(0).saturating_sub(room - 1);
            let rows = swarms.iter().enumerate().skip(first).take(room);
            lines.extend(rows.map(|(index, swarm)| {
                let line = row(swarm, name, with_speed, palette);
                if Some(index) == at {
                    line.style(palette.selected())
                } else {
                    line
                }
            }));
        }
    }
    frame.render_widget(Paragraph::new(lines), area);
}

fn row(swarm: &SwarmSummary, name: usize, with_speed: bool, palette: Palette) -> Line<'static> {
    let mut numbers = format!(
        "{:name$}{:>N$}{:>ORDER$.2}",
        cut(&swarm.swarm, name.saturating_sub(1)),
        swarm.n,
        swarm.order
    );
    if with_speed {
        let speed = format::factor(swarm.real_time_factor);
        numbers.push_str(&format!("{speed:>SPEED$}"));
    }
    Line::from(vec![
        Span::styled(glyph(swarm.phase), palette.phase(swarm.phase)),
        Span::raw(" "),
        Span::raw(numbers),
    ])
}
