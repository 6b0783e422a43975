//! A model of a swarm without bodies: steps, phases, numbers and scheduled commands.

use std::collections::BTreeMap;

use jostled::swarm::command::When;

/// How many individuals the swarm may grow to.
pub const LIMIT: usize = 4;

/// So slow that a run takes one step only.
pub const SLOW: Option<f64> = Some(1e-6);

/// As fast as possible.
pub const FAST: Option<f64> = None;

/// What phase the model is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModelPhase {
    Paused,
    Running(Option<u64>),
    Stepping(u64),
}

/// A change of the model.
#[derive(Clone, Copy, Debug)]
pub enum Step {
    /// `pi3`, in range or not.
    Set(bool),
    Inform(usize),
    Uninform,
    Inject(usize),
    Remove(usize),
}

/// What a condition does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Effect {
    Pause,
    /// Apply one change, which is valid.
    Change,
    Event,
    /// As `Pause`, and remove the scheduled commands and the conditions without events.
    Stop,
}

/// A command of the model.
#[derive(Clone, Debug)]
pub enum Input {
    Run {
        until: Option<u64>,
        rate: Option<f64>,
    },
    Pause,
    Step(u64),
    Change(Step),
    Batch(Vec<Step>),
    /// A condition that holds in every state.
    When(Effect),
    /// Remove all conditions.
    Cancel,
    /// Reject `Reset` and `Delete`, or accept them again.
    Protect(bool),
    Reset,
    Delete,
}

/// The result that the model expects of a command.
#[derive(Clone, Debug, PartialEq)]
pub enum Expected {
    /// It is executed, at this step and with this `seq`.
    Executed { step: u64, seq: u64 },
    /// It takes so many steps, up to this one.
    Stepped { step: u64, taken: u64 },
    /// It waits for this step.
    Scheduled(u64),
    /// It is rejected, with this variant of the error.
    Rejected(String),
}

/// A swarm without bodies.
#[derive(Debug)]
pub struct Model {
    pub phase: ModelPhase,
    pub step: u64,
    pub epoch: u64,
    pub seq: u64,
    pub n: usize,
    pub n_at_start: usize,
    pub rate: Option<f64>,
    /// Whether a slow run has its first step still to take.
    pub is_due: bool,
    pub waiting: BTreeMap<(u64, u64), Input>,
    pub arrived: u64,
    /// The conditions, in the order of arrival.
    pub conditions: Vec<Effect>,
    /// The step at which the pending `step` began, and its reply.
    pub pending: Option<u64>,
    pub stepped: Option<Expected>,
    /// Those applied, as (seq, epoch, step).
    pub journal: Vec<(u64, u64, u64)>,
    pub rejected_later: usize,
    pub scheduled: usize,
    pub is_protected: bool,
    pub deleted: bool,
}

impl Model {
    pub fn new(n: usize) -> Self {
        Model {
            phase: ModelPhase::Paused,
            step: 0,
            epoch: 1,
            seq: 0,
            n,
            n_at_start: n,
            rate: SLOW,
            is_due: false,
            waiting: BTreeMap::new(),
            arrived: 0,
            conditions: Vec::new(),
            pending: None,
            stepped: None,
            journal: Vec::new(),
            rejected_later: 0,
            scheduled: 0,
            is_protected: false,
            deleted: false,
        }
    }

    /// The result of a command before the swarm steps; `None` for a `step`, whose reply comes later.
    pub fn apply_input(&mut self, input: &Input, when: When) -> Option<Expected> {
        let rejected = |name: &str| Some(Expected::Rejected(name.to_owned()));
        let wrong = |expected: Option<u64>, actual| expected.is_some_and(|it| it != actual);
        if wrong(when.expect_epoch, self.epoch) || wrong(when.expect_step, self.step) {
            return rejected("Conflict");
        }
        match when.at_step {
            Some(at_step) if at_step < self.step => rejected("Late"),
            Some(at_step) if at_step > self.step => {
                if let Some(name) = self.protection(input).or_else(|| cannot_wait(input)) {
                    return rejected(&name);
                }
                self.arrived += 1;
                self.scheduled += 1;
                self.waiting.insert((at_step, self.arrived), input.clone());
                Some(Expected::Scheduled(at_step))
            }
            _ => match self.execute(input) {
                Ok(()) if matches!(input, Input::Step(_)) => {
                    self.stepped = None;
                    None
                }
                Ok(()) => Some(Expected::Executed {
                    step: self.step,
                    seq: self.seq,
                }),
                Err(name) => Some(Expected::Rejected(name)),
            },
        }
    }

    /// Executes a command, or returns the error that rejects it.
    fn execute(&mut self, input: &Input) -> Result<(), String> {
        if let Some(name) = self.protection(input) {
            return Err(name);
        }
        let at = self.step;
        let applied = match input {
            Input::Step(steps) => match self.phase {
                ModelPhase::Paused => {
                    self.answer_pending();
                    self.phase = ModelPhase::Stepping(self.step + steps);
                    self.pending = Some(self.step);
                    1
                }
                ModelPhase::Running(_) | ModelPhase::Stepping(_) => {
                    return Err("Phase(Running)".into());
                }
            },
            Input::Run { until, rate } => {
                let until = match self.phase {
                    ModelPhase::Running(end) => until.or(end),
                    _ => *until,
                };
                if until.is_some_and(|until| until < self.step) {
                    return Err("Past".into());
                }
                self.answer_pending();
                self.rate = *rate;
                self.is_due = true;
                self.phase = ModelPhase::Running(until);
                self.pause_at_end();
                1
            }
            Input::Pause => {
                self.answer_pending();
                self.phase = ModelPhase::Paused;
                1
            }
            Input::Change(change) => {
                self.n = changed(self.n, *change)?;
                1
            }
            Input::Batch(changes) => {
                let mut n = self.n;
                for change in changes {
                    n = changed(n, *change).map_err(|name| format!("InBatch({name})"))?;
                }
                self.n = n;
                changes.len() as u64
            }
            Input::When(effect) => {
                self.conditions.retain(|it| it != effect);
                self.conditions.push(*effect);
                1
            }
            Input::Cancel => {
                self.conditions.clear();
                1
            }
            Input::Protect(on) => {
                self.is_protected = *on;
                1
            }
            Input::Reset => {
                self.conditions.clear();
                self.answer_pending();
                self.phase = ModelPhase::Paused;
                self.step = 0;
                self.epoch += 1;
                self.n = self.n_at_start;
                self.rejected_later += self.waiting.len();
                self.waiting.clear();
                1
            }
            Input::Delete => {
                self.answer_pending();
                self.deleted = true;
                1
            }
        };
        self.seq += applied;
        let at = if matches!(input, Input::Reset) { 0 } else { at };
        if !self.deleted {
            self.journal.push((self.seq, self.epoch, at));
        }
        Ok(())
    }

    /// The error of a command that the protection rejects.
    fn protection(&self, input: &Input) -> Option<String> {
        let ends = matches!(input, Input::Reset | Input::Delete);
        (self.is_protected && ends).then(|| "Protected".into())
    }

    /// Steps until the swarm is paused or waits.
    pub fn run_until_idle(&mut self) {
        while !self.deleted {
            match self.phase {
                ModelPhase::Stepping(_) => {}
                ModelPhase::Running(_) if self.rate == FAST || self.is_due => {}
                _ => return,
            }
            self.is_due = false;
            self.step += 1;
            let had_ended = self.pause_at_end();
            self.fire();
            while let Some(first) = self.waiting.first_entry() {
                if first.key().0 > self.step {
                    break;
                }
                let input = first.remove();
                if self.execute(&input).is_err() {
                    self.rejected_later += 1;
                }
                if self.deleted {
                    return;
                }
            }
            if had_ended && !matches!(self.phase, ModelPhase::Stepping(_)) {
                self.answer_pending();
            }
        }
    }

    /// Executes all conditions, once: each holds. One that stops is executed without the others, except
    /// for events.
    fn fire(&mut self) {
        let mut firing = std::mem::take(&mut self.conditions);
        if firing.contains(&Effect::Stop) {
            firing.retain(|it| matches!(it, Effect::Stop | Effect::Event));
        }
        for effect in firing {
            match effect {
                Effect::Pause | Effect::Stop => {
                    self.answer_pending();
                    self.phase = ModelPhase::Paused;
                }
                Effect::Change | Effect::Event => {}
            }
            self.seq += 1;
            self.journal.push((self.seq, self.epoch, self.step));
            if effect == Effect::Stop {
                self.rejected_later += self.waiting.len();
                self.waiting.clear();
            }
        }
    }

    /// Pauses if the end of the run is reached. Returns whether it was.
    fn pause_at_end(&mut self) -> bool {
        let until = match self.phase {
            ModelPhase::Running(until) => until,
            ModelPhase::Stepping(until) => Some(until),
            ModelPhase::Paused => None,
        };
        let has_arrived = until.is_some_and(|until| self.step >= until);
        if has_arrived {
            self.phase = ModelPhase::Paused;
        }
        has_arrived
    }

    fn answer_pending(&mut self) {
        if let Some(from) = self.pending.take() {
            // Scheduled commands have no client that waits for a reply.
            self.stepped.get_or_insert(Expected::Stepped {
                step: self.step,
                taken: self.step - from,
            });
        }
    }
}

/// The size of a group after a change, or the error that rejects it.
fn changed(n: usize, change: Step) -> Result<usize, String> {
    match change {
        Step::Set(true) | Step::Uninform => Ok(n),
        Step::Set(false) => Err("Parameters".into()),
        Step::Inform(count) if count <= n => Ok(n),
        Step::Inject(count) if n + count <= LIMIT => Ok(n + count),
        Step::Inject(_) => Err("TooMany".into()),
        Step::Remove(count) if count == n => Err("NoneLeft".into()),
        Step::Remove(count) if count < n => Ok(n - count),
        Step::Inform(_) | Step::Remove(_) => Err("Selection".into()),
    }
}

/// The error that rejects a command when it is scheduled: an argument that is invalid in every state.
fn cannot_wait(input: &Input) -> Option<String> {
    let is_wrong = |change: &Step| matches!(change, Step::Set(false));
    match input {
        Input::Change(change) if is_wrong(change) => Some("Parameters".into()),
        Input::Batch(changes) if changes.iter().any(is_wrong) => Some("InBatch(Parameters)".into()),
        _ => None,
    }
}
