//! The actions of keys.

use jostle_proto::Phase;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::command::{Command, Verb};
use super::prompt::{KeyAction, Prompt};
use super::view::{Action, End, View};

/// The keys with their actions, as shown.
pub const KEYS: [(&str, &str); 12] = [
    ("↑ ↓ j k", "select a swarm"),
    ("space", "pause or run it"),
    ("s  S", "one step, or a hundred"),
    ("i", "inform some of it"),
    ("+ -", "zoom"),
    ("← →", "pan; with Shift up and down, too"),
    ("H J K L", "pan"),
    ("f", "follow the group, or stop following"),
    ("m  M", "draw the next measure, or the one before"),
    ("?", "show these keys"),
    ("Esc", "close the popup"),
    ("q", "quit; the swarms go on"),
];
/// The maximum number of commands that wait for replies.
const MAX_PENDING: usize = 8;

impl View {
    /// Handles a key.
    pub fn press(&mut self, key: KeyEvent) -> Vec<Action> {
        if key.kind == KeyEventKind::Release {
            return Vec::new();
        }
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        if is_control && key.code == KeyCode::Char('c') {
            return vec![Action::End(End::Interrupted)];
        }
        self.is_changed = true;
        if let Some(prompt) = &mut self.prompt {
            let pressed = prompt.press(key);
            if pressed != KeyAction::Open {
                self.prompt = None;
            }
            return match pressed {
                KeyAction::Submitted(args) => self.command(Verb::Inform(args)),
                _ => Vec::new(),
            };
        }
        let was_help_shown = std::mem::take(&mut self.is_help_shown);
        self.notice = None;
        let is_shifted = key.modifiers.contains(KeyModifiers::SHIFT);
        match key.code {
            KeyCode::Char('q') => return vec![Action::End(End::Quit)],
            KeyCode::Char('?') => self.is_help_shown = !was_help_shown,
            KeyCode::Left | KeyCode::Char('H') => self.camera.pan(-1.0, 0.0),
            KeyCode::Right | KeyCode::Char('L') => self.camera.pan(1.0, 0.0),
            KeyCode::Char('K') => self.camera.pan(0.0, 1.0),
            KeyCode::Char('J') => self.camera.pan(0.0, -1.0),
            KeyCode::Up if is_shifted => self.camera.pan(0.0, 1.0),
            KeyCode::Down if is_shifted => self.camera.pan(0.0, -1.0),
            KeyCode::Char('+' | '=') => self.camera.zoom(true),
            KeyCode::Char('-' | '_') => self.camera.zoom(false),
            KeyCode::Char('m') => self.choose_measure(1),
            KeyCode::Char('M') => self.choose_measure(-1),
            KeyCode::Char('f') => self.follow(),
            KeyCode::Up | KeyCode::Char('k') => return self.move_selection(-1),
            KeyCode::Down | KeyCode::Char('j') => return self.move_selection(1),
            KeyCode::Char(' ') => {
                let runs = self.phase() == Some(Phase::Running);
                return self.command(if runs { Verb::Pause } else { Verb::Run });
            }
            KeyCode::Char('s') => return self.command(Verb::Step(1)),
            KeyCode::Char('S') => return self.command(Verb::Step(100)),
            KeyCode::Char('i') if self.selected.is_some() => self.prompt = Some(Prompt::default()),
            _ => {}
        }
        Vec::new()
    }

    fn phase(&self) -> Option<Phase> {
        let numbers = self.selected.as_ref()?.numbers.as_ref();
        numbers.map(|numbers| numbers.phase)
    }

    fn follow(&mut self) {
        self.camera.follow();
        if let Some(state) = self.selected.as_ref().and_then(|it| it.state.as_ref()) {
            self.camera.track(state);
        }
    }

    fn command(&mut self, verb: Verb) -> Vec<Action> {
        let Some(selected) = &self.selected else {
            return Vec::new();
        };
        let swarm = selected.name.clone();
        if self.pending == MAX_PENDING {
            let text = format!("{MAX_PENDING} commands are waiting for replies");
            self.notify(text, true);
            return Vec::new();
        }
        self.pending += 1;
        vec![Action::Command(Command { swarm, verb })]
    }
}
