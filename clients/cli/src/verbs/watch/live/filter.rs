//! The filter of the list: which swarms it shows.

use glob::Pattern;
use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::chord::is_chord;

/// The longest text, the length of a name.
const MAX_LENGTH: usize = 64;

/// A part of a name, or a pattern with `*`, `?` and `[abc]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter {
    pub text: String,
    /// Whether keys edit it.
    pub is_open: bool,
    /// The swarm that was selected when it was opened.
    pub selected_before: Option<String>,
}

/// The effect of a key on an open filter.
#[derive(Debug, PartialEq)]
pub enum Edit {
    /// Its text has changed, or nothing has.
    Text,
    /// The text is to be kept.
    Keep,
    /// It is closed: select the swarm from before.
    Cancel(Option<String>),
    /// Select another of the swarms that it shows.
    Move(isize),
}

impl Filter {
    /// Whether it shows a swarm.
    pub fn shows(&self, swarm: &str) -> bool {
        if !self.text.contains(['*', '?', '[']) {
            return swarm.contains(&self.text);
        }
        // A pattern that is not complete yet shows all.
        Pattern::new(&self.text).map_or(true, |pattern| pattern.matches(swarm))
    }

    /// Handles a key while it is open.
    pub fn press(&mut self, key: KeyEvent) -> Edit {
        match key.code {
            KeyCode::Esc => return Edit::Cancel(std::mem::take(self).selected_before),
            KeyCode::Enter => return Edit::Keep,
            KeyCode::Up => return Edit::Move(-1),
            KeyCode::Down => return Edit::Move(1),
            KeyCode::Backspace if self.text.is_empty() => self.is_open = false,
            KeyCode::Backspace => drop(self.text.pop()),
            KeyCode::Char(typed) if !is_chord(key) => self.insert(&typed.to_string()),
            _ => {}
        }
        Edit::Text
    }

    /// Appends what was typed or pasted.
    pub fn insert(&mut self, text: &str) {
        let room = MAX_LENGTH.saturating_sub(self.text.chars().count());
        let typed = text.chars().filter(|it| !it.is_control());
        self.text.extend(typed.take(room));
    }
}
