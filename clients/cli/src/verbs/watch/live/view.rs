//! What is shown, as a pure state: messages change it, nothing in it waits for anything.

use jostle_proto::{Event, EventKind, Reply, State, Status, SwarmSummary};
use ratatui::crossterm::event::KeyEvent;

use super::camera::Camera;
use super::chosen::Chosen;
use super::command::Command;
use super::prompt::Prompt;
use crate::failure::Failure;
use crate::verbs::lookout::BACK;

/// How many lists a swarm may be missing from before another is chosen: a daemon that comes back
/// has its swarms a moment later.
const MISSES: u32 = 4;

/// What comes about.
#[derive(Debug)]
pub enum Message {
    /// A key was pressed.
    Key(KeyEvent),
    /// The terminal has another size.
    Resized,
    /// Which swarms there are.
    Swarms(Vec<SwarmSummary>),
    /// Why nobody tells which there are.
    Away(String),
    /// How the chosen swarm is.
    Status(Box<Reply<Status>>),
    /// Where its bodies are.
    State(Box<State>),
    /// What happened to it.
    Events(Vec<Event>),
    /// What came of a command, or why nothing came of it.
    Answered(Result<String, String>),
    /// What else went wrong.
    Trouble(String),
    /// It is over.
    End(End),
}

impl Message {
    /// Whether an earlier one of its kind is worth nothing any more.
    pub fn is_latest_only(&self) -> bool {
        use Message::{Away, Resized, State, Status, Swarms};
        matches!(self, Resized | Swarms(_) | Away(_) | Status(_) | State(_))
    }
}

/// What the view wants of others.
#[derive(Debug)]
pub enum Wish {
    /// To be told of this swarm, and of no other.
    Follow(Option<String>),
    /// A swarm to do something.
    Command(Command),
    /// To end.
    End(End),
}

/// How it ends.
#[derive(Debug)]
pub enum End {
    /// Enough was seen.
    Quit,
    /// Ctrl-C, or somebody else wants it to end.
    Interrupted,
    /// It cannot go on.
    Failed(Failure),
}

/// Something said to who looks on, until something else is.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// The words.
    pub text: String,
    /// Whether something went wrong.
    pub is_error: bool,
}

/// All that is shown.
#[derive(Debug)]
pub struct View {
    /// Where the daemon is reached.
    pub endpoint: String,
    /// The swarms there are; none before they were told.
    pub swarms: Option<Vec<SwarmSummary>>,
    /// Why nobody tells how things are, if that is so.
    pub away: Option<String>,
    /// The swarm that is looked at.
    pub chosen: Option<Chosen>,
    /// Which part of the plane is in sight.
    pub camera: Camera,
    /// What was said last.
    pub said: Option<Said>,
    /// The questions that are asked.
    pub prompt: Option<Prompt>,
    /// Whether the keys are explained.
    pub is_help_shown: bool,
    /// How many commands wait for their answer.
    pub under_way: usize,
    /// Whether it looks other than when it was last drawn.
    pub is_changed: bool,
    /// How many lists the chosen swarm is missing from.
    misses: u32,
}

impl View {
    /// A view that begins with a swarm, or with the first there is.
    pub fn new(endpoint: &str, swarm: Option<String>) -> Self {
        View {
            endpoint: endpoint.into(),
            swarms: None,
            away: None,
            chosen: swarm.map(Chosen::new),
            camera: Camera::default(),
            said: None,
            prompt: None,
            is_help_shown: false,
            under_way: 0,
            is_changed: true,
            misses: 0,
        }
    }

    /// Takes in what has come about and returns what is to be done about it.
    pub fn update(&mut self, message: Message) -> Vec<Wish> {
        match message {
            Message::Key(key) => return self.press(key),
            Message::Resized => self.is_changed = true,
            Message::Swarms(swarms) => return self.list(swarms),
            Message::Away(why) => {
                self.is_changed |= self.away.as_ref() != Some(&why);
                self.away = Some(why);
            }
            Message::Status(reply) => {
                if let Some(chosen) = self.chosen.as_mut().filter(|it| it.name == reply.swarm) {
                    self.is_changed |= chosen.hear(*reply);
                }
            }
            Message::State(state) => {
                if let Some(chosen) = self.chosen.as_mut().filter(|it| it.name == state.swarm) {
                    self.is_changed |= chosen.see(*state, &mut self.camera);
                }
            }
            Message::Events(events) => self.tell(events),
            Message::Answered(answer) => {
                self.under_way = self.under_way.saturating_sub(1);
                match answer {
                    Ok(text) => self.say(text, false),
                    Err(text) => self.say(text, true),
                }
            }
            Message::Trouble(text) => self.say(text, true),
            Message::End(end) => return vec![Wish::End(end)],
        }
        Vec::new()
    }

    /// Says something.
    pub fn say(&mut self, text: String, is_error: bool) {
        self.said = Some(Said { text, is_error });
        self.is_changed = true;
    }

    /// Chooses the swarm `by` further down the list.
    pub fn choose(&mut self, by: isize) -> Vec<Wish> {
        let swarms = self.swarms.as_deref().unwrap_or_default();
        let Some(last) = swarms.len().checked_sub(1) else {
            return Vec::new();
        };
        // One that is gone was where it would stand now.
        let name = self.chosen.as_ref().map_or("", |chosen| &chosen.name);
        let at = swarms.partition_point(|it| it.swarm.as_str() < name);
        let to = at.saturating_add_signed(by).min(last);
        let name = swarms[to].swarm.clone();
        if self.chosen.as_ref().is_some_and(|it| it.name == name) {
            return Vec::new();
        }
        self.turn_to(Some(name))
    }

    fn turn_to(&mut self, name: Option<String>) -> Vec<Wish> {
        self.chosen = name.clone().map(Chosen::new);
        self.camera = Camera::default();
        self.misses = 0;
        self.is_changed = true;
        vec![Wish::Follow(name)]
    }

    fn list(&mut self, swarms: Vec<SwarmSummary>) -> Vec<Wish> {
        let is_first = self.swarms.is_none();
        self.is_changed |= self.swarms.as_ref() != Some(&swarms);
        let is_back = self.away.take().is_some() && !is_first;
        if is_back {
            self.say(BACK.into(), false);
        }
        let listed = |name: &str| swarms.iter().find(|it| it.swarm == name);
        let was_missing = self.misses > 0;
        if let Some(chosen) = &mut self.chosen {
            match listed(&chosen.name) {
                Some(summary) => {
                    self.misses = 0;
                    self.is_changed |= chosen.glance(summary);
                }
                None => self.misses += 1,
            }
        }
        self.swarms = Some(swarms);
        match &self.chosen {
            None => self.choose(0),
            Some(chosen) if self.misses >= MISSES => {
                let text = format!("{} is no longer there", chosen.name);
                self.say(text, false);
                self.choose_another()
            }
            Some(chosen) if is_first || is_back || was_missing && self.misses == 0 => {
                vec![Wish::Follow(Some(chosen.name.clone()))]
            }
            Some(_) => Vec::new(),
        }
    }

    /// Chooses whichever is next to the one that is gone.
    fn choose_another(&mut self) -> Vec<Wish> {
        let name = self.chosen.take().map(|chosen| chosen.name);
        if let Some(swarms) = &mut self.swarms {
            swarms.retain(|it| Some(&it.swarm) != name.as_ref());
            let at = swarms.partition_point(|it| Some(&it.swarm) < name.as_ref());
            let next = swarms.get(at).or(swarms.last());
            let next = next.map(|it| it.swarm.clone());
            return self.turn_to(next);
        }
        self.turn_to(None)
    }

    fn tell(&mut self, events: Vec<Event>) {
        let Some(chosen) = &mut self.chosen else {
            return;
        };
        for event in events {
            if event.swarm != chosen.name {
                continue;
            }
            let last = chosen.events.back();
            let is_new = last.is_none_or(|it| event.number > it.number);
            let begins_anew = event.event == (EventKind::Created {});
            if !is_new && !begins_anew || last == Some(&event) {
                continue;
            }
            if begins_anew {
                chosen.events.clear();
            }
            if event.event == (EventKind::Deleted {}) {
                // Whatever list comes next, it is not waited for; one of its name is another.
                self.misses = MISSES;
                let events = std::mem::take(&mut chosen.events);
                *chosen = Chosen {
                    events,
                    ..Chosen::new(event.swarm.clone())
                };
            }
            chosen.happened(event);
            self.is_changed = true;
        }
    }
}
