//! Lines on a terminal that are redrawn in place.

use std::thread;

use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::crossterm::terminal;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

use crate::failure::Failure;
use crate::output;

/// Control sequences. Long lines are cut rather than wrapped, since the cursor moves up by the number
/// of lines.
const DO_NOT_WRAP: &str = "\x1b[?7l";
const WRAP: &str = "\x1b[?7h";
const CLEAR_LINE: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";

/// The number of lines drawn last.
#[derive(Debug, Default)]
pub struct Screen {
    drawn: usize,
    /// The number of rows above those that are shown.
    offset: usize,
    /// The number of rows that fit.
    page: usize,
}

/// A key that a scrolled screen handles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Key {
    Quit,
    /// Ctrl-C, which the terminal does not turn into a signal while keys are read.
    Interrupt,
    /// This many rows down; `isize::MAX` is to the end.
    Scroll(isize),
}

/// Reads keys from the terminal, which is as before once this is dropped.
pub struct Keys(UnboundedReceiver<Key>);

impl Keys {
    /// None if standard input is no terminal.
    pub fn read() -> Option<Self> {
        if !std::io::IsTerminal::is_terminal(&std::io::stdin()) {
            return None;
        }
        terminal::enable_raw_mode().ok()?;
        let (sender, keys) = unbounded_channel();
        // It ends with the process: nothing else wakes a thread that waits for a key.
        thread::spawn(move || {
            while let Ok(event) = event::read() {
                let key = match event {
                    Event::Key(key) if key.kind != KeyEventKind::Release => key,
                    _ => continue,
                };
                let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
                let key = match key.code {
                    KeyCode::Char('c') if is_control => Key::Interrupt,
                    KeyCode::Char('q') => Key::Quit,
                    KeyCode::Down | KeyCode::Char('j') => Key::Scroll(1),
                    KeyCode::Up | KeyCode::Char('k') => Key::Scroll(-1),
                    KeyCode::PageDown | KeyCode::Char(' ') => Key::Scroll(PAGE),
                    KeyCode::PageUp => Key::Scroll(-PAGE),
                    KeyCode::End => Key::Scroll(isize::MAX),
                    KeyCode::Home => Key::Scroll(isize::MIN),
                    _ => continue,
                };
                if sender.send(key).is_err() {
                    return;
                }
            }
        });
        Some(Keys(keys))
    }

    /// The next key; waits for ever once the terminal is gone.
    pub async fn next(&mut self) -> Key {
        match self.0.recv().await {
            Some(key) => key,
            None => std::future::pending().await,
        }
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        // An error cannot be reported anywhere.
        let _ = terminal::disable_raw_mode();
    }
}

/// The rows of Page Up and Page Down.
const PAGE: isize = 10;

impl Screen {
    /// Draws a text and a line below it over what was drawn before. The cursor stays below, where
    /// an echoed ^C does no harm.
    pub fn draw(&mut self, text: &str, below: Option<&str>) -> Result<(), Failure> {
        let (height, width) = console::Term::stdout().size();
        let lines = lines_that_fit(text, below, usize::from(height), usize::from(width));
        self.write(&lines)
    }

    /// As [`Screen::draw`], but the lines after the one that begins with `header` are scrolled.
    pub fn draw_scrolled(
        &mut self,
        text: &str,
        below: Option<&str>,
        header: &str,
    ) -> Result<(), Failure> {
        let (height, width) = console::Term::stdout().size();
        let (height, width) = (usize::from(height), usize::from(width));
        let all: Vec<&str> = text.lines().collect();
        let fixed = all.iter().position(|line| line.starts_with(header));
        let (fixed, rows) = all.split_at(fixed.map_or(0, |at| at + 1));
        let below_lines = 1 + usize::from(below.is_some());
        let room = height.saturating_sub(below_lines + fixed.len()).max(1);
        if rows.len() <= room || height <= below_lines + fixed.len() + 1 {
            self.offset = 0;
            return self.draw(text, below);
        }
        // One line says which rows these are.
        self.page = room - 1;
        self.offset = self.offset.min(rows.len() - self.page);
        let (first, last) = (self.offset + 1, self.offset + self.page);
        let place = format!(
            "{first} to {last} of {}: ↑ ↓ PgUp PgDn scroll, q quits",
            rows.len()
        );
        let shown = rows[self.offset..last].iter().copied();
        let lines = fixed.iter().copied().chain(shown);
        let lines = lines.chain([place.as_str()]).chain(below);
        let cut = |line: &str| console::truncate_str(line, width, "…").into_owned();
        self.write(&lines.map(cut).collect::<Vec<_>>())
    }

    /// Scrolls the rows of the next drawing.
    pub fn scroll(&mut self, by: isize) {
        self.offset = self.offset.saturating_add_signed(by);
    }

    fn write(&mut self, lines: &[String]) -> Result<(), Failure> {
        let mut screen = String::from("\r");
        if self.drawn > 0 {
            screen.push_str(&format!("\x1b[{}A", self.drawn));
        }
        screen.push_str(DO_NOT_WRAP);
        for line in lines {
            // With the return, as a terminal whose keys are read adds none.
            screen.push_str(&format!("{line}{CLEAR_LINE}\r\n"));
        }
        screen.push_str(CLEAR_BELOW);
        screen.push_str(WRAP);
        self.drawn = lines.len();
        output::write(&screen)
    }
}

/// The lines that fit above the cursor, cut at the width of the terminal: without wrapping a terminal
/// shows the end of a long line in its last column.
fn lines_that_fit(text: &str, below: Option<&str>, height: usize, width: usize) -> Vec<String> {
    let room = height
        .saturating_sub(1 + usize::from(below.is_some()))
        .max(1);
    let count = text.lines().count();
    let shown = if count > room { room - 1 } else { count };
    let left_out = (count > shown).then(|| format!("… {} more lines", count - shown));
    text.lines()
        .take(shown)
        .chain(left_out.as_deref())
        .chain(below)
        .map(|line| console::truncate_str(line, width, "…").into_owned())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_do_not_fit_are_cut_and_counted() {
        assert_eq!(lines_that_fit("a\nb", None, 24, 80), ["a", "b"]);
        assert_eq!(lines_that_fit("a\nb", Some("c"), 24, 80), ["a", "b", "c"]);
        assert_eq!(
            lines_that_fit("a\nb\nc\nd", None, 4, 80),
            ["a", "b", "… 2 more lines"]
        );
        assert_eq!(lines_that_fit("a\nb", None, 3, 80), ["a", "b"]);
        assert_eq!(lines_that_fit("abcdef", None, 24, 4), ["abc…"]);
        assert_eq!(
            lines_that_fit("a\nb", Some("c"), 0, 80),
            ["… 2 more lines", "c"]
        );
    }
}
