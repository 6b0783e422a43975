//! Keys that type no character.

use ratatui::crossterm::event::{KeyEvent, KeyModifiers};

/// Whether a key is pressed together with Ctrl, Alt or the like, and so types no character.
pub fn is_chord(key: KeyEvent) -> bool {
    let shifted = KeyModifiers::SHIFT;
    !key.modifiers.difference(shifted).is_empty()
}
