//! The actions of keys.

use jostle_proto::Phase;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::chord::is_chord;
use super::command::{Command, Verb};
use super::filter::Edit;
use super::prompt::{KeyAction, Prompt};
use super::view::{Action, End, View};

/// The keys with their actions, as shown.
pub const KEYS: [(&str, &str); 13] = [
    ("↑ ↓ j k", "select a swarm"),
    ("/", "list only names with a text; Esc: all"),
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
                KeyAction::Submitted(swarm, args) => self.send(swarm, Verb::Inform(args)),
                _ => Vec::new(),
            };
        }
        self.notice = None;
        if self.filter.is_open {
            return self.press_in_filter(key);
        }
        if is_chord(key) {
            return Vec::new();
        }
        // A key that closes the list of keys does nothing else, except to quit.
        if std::mem::take(&mut self.is_help_shown) && key.code != KeyCode::Char('q') {
            return Vec::new();
        }
        let is_shifted = key.modifiers.contains(KeyModifiers::SHIFT);
        match key.code {
            KeyCode::Char('q') => return vec![Action::End(End::Quit)],
            KeyCode::Char('?') => self.is_help_shown = true,
            KeyCode::Char('/') => {
                self.filter.is_open = true;
                self.filter.selected_before = self.selected.as_ref().map(|it| it.name.clone());
            }
            KeyCode::Esc => self.filter.text.clear(),
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
            KeyCode::Char('i') => self.prompt = self.steered().map(Prompt::of),
            _ => {}
        }
        Vec::new()
    }

    /// A paste, which is text and no keys.
    pub fn paste(&mut self, text: &str) -> Vec<Action> {
        self.is_changed = true;
        if let Some(prompt) = &mut self.prompt {
            prompt.insert(text);
        } else if self.filter.is_open {
            self.filter.insert(text);
            return self.select_visible();
        } else {
            self.notify("keys are typed, not pasted: nothing was sent".into(), true);
        }
        Vec::new()
    }

    fn press_in_filter(&mut self, key: KeyEvent) -> Vec<Action> {
        match self.filter.press(key) {
            Edit::Text => self.select_visible(),
            Edit::Move(by) => self.move_selection(by),
            Edit::Cancel(before) => self.select_again(before),
            Edit::Keep if self.visible().next().is_some() => {
                self.filter.is_open = false;
                self.select_visible()
            }
            // The keys after it would steer a swarm that is not shown.
            Edit::Keep => {
                let text = format!("no swarm matches {}: Esc lists all", self.filter.text);
                self.notify(text, true);
                Vec::new()
            }
        }
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

    /// The swarm that keys steer; none, with a notice, if it was selected since another one went.
    fn steered(&mut self) -> Option<String> {
        let swarm = self.selected.as_ref()?.name.clone();
        if std::mem::take(&mut self.is_selected_instead) {
            self.notify(format!("{swarm} is selected now: press again"), true);
            return None;
        }
        Some(swarm)
    }

    fn command(&mut self, verb: Verb) -> Vec<Action> {
        match self.steered() {
            Some(swarm) => self.send(swarm, verb),
            None => Vec::new(),
        }
    }

    fn send(&mut self, swarm: String, verb: Verb) -> Vec<Action> {
        if self.pending == MAX_PENDING {
            let text = format!("{MAX_PENDING} commands are waiting for replies");
            self.notify(text, true);
            return Vec::new();
        }
        self.pending += 1;
        vec![Action::Command(Command { swarm, verb })]
    }
}
