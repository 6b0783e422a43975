//! The state of the view: messages update it, without I/O.

use jostle_measures::Measure;
use jostle_proto::{Event, EventKind, Reply, State, Status, SwarmSummary};
use ratatui::crossterm::event::KeyEvent;

use super::camera::Camera;
use super::command::Command;
use super::filter::Filter;
use super::measured;
use super::prompt::Prompt;
use super::selected::Selected;
use crate::failure::Failure;
use crate::verbs::outage::DAEMON_BACK;

/// The number of lists a swarm may be missing from before another is selected: a restarted daemon
/// lists its swarms after a delay.
const MAX_MISSES: u32 = 4;

/// A message to the view.
#[derive(Debug)]
pub enum Message {
    /// A key was pressed.
    Key(KeyEvent),
    /// A text was pasted.
    Pasted(String),
    /// The terminal has another size.
    Resized,
    /// The list of swarms.
    Swarms(Vec<SwarmSummary>),
    /// The daemon does not reply, with the reason.
    Away(String),
    /// The status of the selected swarm.
    Status(Box<Reply<Status>>),
    State(Box<State>),
    Events(Vec<Event>),
    /// The outcome of a command, or its error.
    Outcome(Result<String, String>),
    /// The selected swarm cannot be followed, with the reason.
    Failed(String),
    /// The view ends.
    End(End),
}

impl Message {
    /// Whether it replaces earlier messages of its kind.
    pub fn is_latest_only(&self) -> bool {
        use Message::{Away, Resized, State, Status, Swarms};
        matches!(self, Resized | Swarms(_) | Away(_) | Status(_) | State(_))
    }
}

/// An action for the tasks that send requests.
#[derive(Debug)]
pub enum Action {
    /// Follow this swarm, and no other.
    Follow(Option<String>),
    /// Send a command.
    Command(Command),
    /// End the view.
    End(End),
}

/// Why the view ends.
#[derive(Debug)]
pub enum End {
    /// The user quit.
    Quit,
    /// Ctrl-C or another signal.
    Interrupted,
    Failed(Failure),
}

/// A text in the status bar.
#[derive(Clone, Debug, PartialEq)]
pub struct Notice {
    pub text: String,
    /// Whether it is an error.
    pub is_error: bool,
}

/// The state of the view.
#[derive(Debug)]
pub struct View {
    pub endpoint: String,
    /// The swarms; none before the first list.
    pub swarms: Option<Vec<SwarmSummary>>,
    /// Which of them the list shows.
    pub filter: Filter,
    /// Why the daemon does not reply, if it does not.
    pub away: Option<String>,
    pub selected: Option<Selected>,
    /// Whether it was selected without a key, since the selected one went.
    pub is_selected_instead: bool,
    /// The measure of the second chart; none if that shows the drift.
    pub measure: Option<Measure>,
    /// The visible part of the plane.
    pub camera: Camera,
    /// The last notice.
    pub notice: Option<Notice>,
    /// The open prompt.
    pub prompt: Option<Prompt>,
    /// Whether the keys are shown.
    pub is_help_shown: bool,
    /// The number of commands without a reply so far.
    pub pending: usize,
    /// Whether it has changed since it was last drawn.
    pub is_changed: bool,
    /// The number of lists that the selected swarm is missing from.
    misses: u32,
}

impl View {
    /// A view that selects `swarm`, or the first of the list.
    pub fn new(endpoint: &str, swarm: Option<String>) -> Self {
        View {
            endpoint: endpoint.into(),
            swarms: None,
            filter: Filter::default(),
            away: None,
            selected: swarm.map(Selected::new),
            is_selected_instead: false,
            measure: None,
            camera: Camera::default(),
            notice: None,
            prompt: None,
            is_help_shown: false,
            pending: 0,
            is_changed: true,
            misses: 0,
        }
    }

    /// Applies a message and returns the resulting actions.
    pub fn update(&mut self, message: Message) -> Vec<Action> {
        match message {
            Message::Key(key) => return self.press(key),
            Message::Pasted(text) => return self.paste(&text),
            Message::Resized => self.is_changed = true,
            Message::Swarms(swarms) => return self.list(swarms),
            Message::Away(why) => {
                self.is_changed |= self.away.as_ref() != Some(&why);
                self.away = Some(why);
            }
            Message::Status(reply) => {
                if let Some(selected) = self.selected.as_mut().filter(|it| it.name == reply.swarm) {
                    self.is_changed |= selected.set_status(*reply);
                }
            }
            Message::State(state) => {
                if let Some(selected) = self.selected.as_mut().filter(|it| it.name == state.swarm) {
                    self.is_changed |= selected.set_state(*state, &mut self.camera, self.measure);
                }
            }
            Message::Events(events) => self.add_events(events),
            Message::Outcome(outcome) => {
                self.pending = self.pending.saturating_sub(1);
                let is_error = outcome.is_err();
                self.notify(outcome.unwrap_or_else(|text| text), is_error);
            }
            Message::Failed(text) => self.notify(text, true),
            Message::End(end) => return vec![Action::End(end)],
        }
        Vec::new()
    }

    pub fn notify(&mut self, text: String, is_error: bool) {
        self.notice = Some(Notice { text, is_error });
        self.is_changed = true;
    }

    /// The swarms that the list shows, by name.
    pub fn visible(&self) -> impl Iterator<Item = &SwarmSummary> {
        let swarms = self.swarms.iter().flatten();
        swarms.filter(|it| self.filter.shows(&it.swarm))
    }

    /// Selects a swarm that the list shows, if the selected one is not among them.
    pub fn select_visible(&mut self) -> Vec<Action> {
        let selected = self.selected.as_ref().map(|it| it.name.as_str());
        match selected.is_some_and(|name| self.filter.shows(name)) {
            true => Vec::new(),
            false => self.move_selection(0),
        }
    }

    /// Selects a swarm if it is still there.
    pub fn select_again(&mut self, name: Option<String>) -> Vec<Action> {
        let mut swarms = self.swarms.iter().flatten();
        let name = name.filter(|name| swarms.any(|it| it.swarm == *name));
        let selected = self.selected.as_ref().map(|it| &it.name);
        match name.is_some() && name.as_ref() != selected {
            true => self.follow_swarm(name),
            false => self.select_visible(),
        }
    }

    /// Moves the selection `by` swarms down the list.
    pub fn move_selection(&mut self, by: isize) -> Vec<Action> {
        let swarms: Vec<&SwarmSummary> = self.visible().collect();
        let Some(last) = swarms.len().checked_sub(1) else {
            return Vec::new();
        };
        // A deleted swarm keeps its position in the order of names.
        let name = self.selected.as_ref().map_or("", |selected| &selected.name);
        let at = swarms.partition_point(|it| it.swarm.as_str() < name);
        let to = at.saturating_add_signed(by).min(last);
        let name = swarms[to].swarm.clone();
        self.is_selected_instead = false;
        if self.selected.as_ref().is_some_and(|it| it.name == name) {
            return Vec::new();
        }
        self.follow_swarm(Some(name))
    }

    /// Draws the measure `by` places further in the menu.
    pub fn choose_measure(&mut self, by: isize) {
        self.measure = measured::neighbour(self.measure, by);
        if let Some(selected) = &mut self.selected {
            selected.choose(self.measure);
        }
        let name = self.measure.map_or("drift".to_owned(), |it| it.to_string());
        self.notify(format!("the second chart shows {name}"), false);
    }

    fn follow_swarm(&mut self, name: Option<String>) -> Vec<Action> {
        self.selected = name.clone().map(Selected::new);
        self.camera = Camera::default();
        self.misses = 0;
        self.is_changed = true;
        vec![Action::Follow(name)]
    }

    fn list(&mut self, swarms: Vec<SwarmSummary>) -> Vec<Action> {
        let is_first = self.swarms.is_none();
        self.is_changed |= self.swarms.as_ref() != Some(&swarms);
        let is_back = self.away.take().is_some() && !is_first;
        if is_back {
            self.notify(DAEMON_BACK.into(), false);
        }
        let listed = |name: &str| swarms.iter().find(|it| it.swarm == name);
        let was_missing = self.misses > 0;
        if let Some(selected) = &mut self.selected {
            match listed(&selected.name) {
                Some(summary) => {
                    self.misses = 0;
                    self.is_changed |= selected.set_summary(summary);
                }
                None => self.misses += 1,
            }
        }
        self.swarms = Some(swarms);
        match &self.selected {
            None => self.move_selection(0),
            Some(selected) if self.misses >= MAX_MISSES => {
                let text = format!("{} is no longer there", selected.name);
                self.notify(text, false);
                self.select_next()
            }
            Some(selected) if is_first || is_back || was_missing && self.misses == 0 => {
                vec![Action::Follow(Some(selected.name.clone()))]
            }
            Some(_) => Vec::new(),
        }
    }

    /// Selects the neighbour of a swarm that no longer exists.
    fn select_next(&mut self) -> Vec<Action> {
        let name = self.selected.take().map(|selected| selected.name);
        if let Some(swarms) = &mut self.swarms {
            swarms.retain(|it| Some(&it.swarm) != name.as_ref());
        }
        let next = self.visible().find(|it| Some(&it.swarm) > name.as_ref());
        let next = next.or_else(|| self.visible().last());
        let next = next.map(|it| it.swarm.clone());
        self.is_selected_instead = next.is_some();
        self.follow_swarm(next)
    }

    fn add_events(&mut self, events: Vec<Event>) {
        let Some(selected) = &mut self.selected else {
            return;
        };
        for event in events {
            if event.swarm != selected.name {
                continue;
            }
            let last = selected.events.back();
            let is_new = last.is_none_or(|it| event.number > it.number);
            let is_recreated = matches!(event.event, EventKind::Created { .. });
            if !is_new && !is_recreated || last == Some(&event) {
                continue;
            }
            if is_recreated {
                selected.events.clear();
            }
            if matches!(event.event, EventKind::Deleted { .. }) {
                // Not waited for: a swarm of this name in the next list is another one.
                self.misses = MAX_MISSES;
                let events = std::mem::take(&mut selected.events);
                *selected = Selected {
                    events,
                    ..Selected::new(event.swarm.clone())
                };
            }
            selected.push_event(event);
            self.is_changed = true;
        }
    }
}
