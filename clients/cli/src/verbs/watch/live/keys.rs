//! What each key does.

use jostle_proto::Phase;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::command::{Command, What};
use super::prompt::{Pressed, Prompt};
use super::view::{End, View, Wish};

/// The keys and what they do, for people.
pub const KEYS: [(&str, &str); 11] = [
    ("↑ ↓ j k", "choose a swarm"),
    ("space", "pause it, or let it run"),
    ("s  S", "take one step, or a hundred"),
    ("i", "inform some of it"),
    ("+ -", "zoom"),
    ("← →", "pan; with Shift up and down, too"),
    ("H J K L", "pan"),
    ("f", "follow the group, or let go of it"),
    ("?", "these keys"),
    ("Esc", "close what is open"),
    ("q", "quit; the swarms go on"),
];
/// How many commands may wait for their answers.
const UNDER_WAY: usize = 8;

impl View {
    /// Takes a key.
    pub fn press(&mut self, key: KeyEvent) -> Vec<Wish> {
        if key.kind == KeyEventKind::Release {
            return Vec::new();
        }
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        if is_control && key.code == KeyCode::Char('c') {
            return vec![Wish::End(End::Interrupted)];
        }
        self.is_changed = true;
        if let Some(prompt) = &mut self.prompt {
            let pressed = prompt.press(key);
            if pressed != Pressed::Open {
                self.prompt = None;
            }
            return match pressed {
                Pressed::Answered(args) => self.command(What::Inform(args)),
                _ => Vec::new(),
            };
        }
        let was_help_shown = std::mem::take(&mut self.is_help_shown);
        self.said = None;
        let is_shifted = key.modifiers.contains(KeyModifiers::SHIFT);
        match key.code {
            KeyCode::Char('q') => return vec![Wish::End(End::Quit)],
            KeyCode::Char('?') => self.is_help_shown = !was_help_shown,
            KeyCode::Left | KeyCode::Char('H') => self.camera.pan(-1.0, 0.0),
            KeyCode::Right | KeyCode::Char('L') => self.camera.pan(1.0, 0.0),
            KeyCode::Char('K') => self.camera.pan(0.0, 1.0),
            KeyCode::Char('J') => self.camera.pan(0.0, -1.0),
            KeyCode::Up if is_shifted => self.camera.pan(0.0, 1.0),
            KeyCode::Down if is_shifted => self.camera.pan(0.0, -1.0),
            KeyCode::Char('+' | '=') => self.camera.zoom(true),
            KeyCode::Char('-' | '_') => self.camera.zoom(false),
            KeyCode::Char('f') => self.follow(),
            KeyCode::Up | KeyCode::Char('k') => return self.choose(-1),
            KeyCode::Down | KeyCode::Char('j') => return self.choose(1),
            KeyCode::Char(' ') => {
                let runs = self.phase() == Some(Phase::Running);
                return self.command(if runs { What::Pause } else { What::Run });
            }
            KeyCode::Char('s') => return self.command(What::Step(1)),
            KeyCode::Char('S') => return self.command(What::Step(100)),
            KeyCode::Char('i') if self.chosen.is_some() => self.prompt = Some(Prompt::default()),
            _ => {}
        }
        Vec::new()
    }

    fn phase(&self) -> Option<Phase> {
        let numbers = self.chosen.as_ref()?.numbers.as_ref();
        numbers.map(|numbers| numbers.phase)
    }

    fn follow(&mut self) {
        self.camera.follow();
        if let Some(state) = self.chosen.as_ref().and_then(|it| it.state.as_ref()) {
            self.camera.see(state);
        }
    }

    fn command(&mut self, what: What) -> Vec<Wish> {
        let Some(chosen) = &self.chosen else {
            return Vec::new();
        };
        let swarm = chosen.name.clone();
        if self.under_way == UNDER_WAY {
            let text = format!("{UNDER_WAY} commands wait for their answers already");
            self.say(text, true);
            return Vec::new();
        }
        self.under_way += 1;
        vec![Wish::Command(Command { swarm, what })]
    }
}
