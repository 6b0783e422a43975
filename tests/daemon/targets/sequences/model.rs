//! A swarm without bodies: steps, phases, numbers, and what waits for its step.

use std::collections::BTreeMap;

use jostled::swarm::command::When;

/// How many individuals the swarm may grow to.
pub const LIMIT: usize = 4;

/// So slow that after the first step of a run no second one comes.
pub const SLOW: Option<f64> = Some(1e-6);

/// As fast as possible.
pub const FAST: Option<f64> = None;

/// What phase the model is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doing {
    Paused,
    Running(Option<u64>),
    Stepping(u64),
}

/// A change as the model sees it.
#[derive(Clone, Copy, Debug)]
pub enum Step {
    /// `pi3`, in range or not.
    Set(bool),
    Inform(usize),
    Uninform,
    Inject(usize),
    Remove(usize),
}

/// An order as the model sees it.
#[derive(Clone, Debug)]
pub enum Told {
    Run {
        until: Option<u64>,
        rate: Option<f64>,
    },
    Pause,
    Step(u64),
    Change(Step),
    Batch(Vec<Step>),
    Reset,
    Delete,
}

/// What an order came to, as far as the model can tell.
#[derive(Clone, Debug, PartialEq)]
pub enum Came {
    /// It was carried out, at this step and with this `seq`.
    Out { step: u64, seq: u64 },
    /// It took so many steps, up to this one.
    Stepped { step: u64, taken: u64 },
    /// It waits for this step.
    Scheduled(u64),
    /// It was refused, by this variant of the error.
    Refused(String),
}

/// A swarm without bodies.
#[derive(Debug)]
pub struct Model {
    pub doing: Doing,
    pub step: u64,
    pub epoch: u64,
    pub seq: u64,
    pub n: usize,
    pub n_at_start: usize,
    pub rate: Option<f64>,
    /// Whether a slow run has its first step still to take.
    pub is_due: bool,
    pub waiting: BTreeMap<(u64, u64), Told>,
    pub arrived: u64,
    /// Where the `step` began that waits for its answer, and what it was answered.
    pub pending: Option<u64>,
    pub stepped: Option<Came>,
    /// Those applied, as (seq, epoch, step).
    pub journal: Vec<(u64, u64, u64)>,
    pub refused_later: usize,
    pub scheduled: usize,
    pub deleted: bool,
}

impl Model {
    pub fn new(n: usize) -> Self {
        Model {
            doing: Doing::Paused,
            step: 0,
            epoch: 1,
            seq: 0,
            n,
            n_at_start: n,
            rate: SLOW,
            is_due: false,
            waiting: BTreeMap::new(),
            arrived: 0,
            pending: None,
            stepped: None,
            journal: Vec::new(),
            refused_later: 0,
            scheduled: 0,
            deleted: false,
        }
    }

    /// What an order comes to before anything moves; `None` for a `step`, which is answered later.
    pub fn tell(&mut self, told: &Told, when: When) -> Option<Came> {
        let refused = |name: &str| Some(Came::Refused(name.to_owned()));
        let wrong = |expected: Option<u64>, actual| expected.is_some_and(|it| it != actual);
        if wrong(when.expect_epoch, self.epoch) || wrong(when.expect_step, self.step) {
            return refused("Conflict");
        }
        match when.at_step {
            Some(at_step) if at_step < self.step => refused("Late"),
            Some(at_step) if at_step > self.step => {
                if let Some(name) = cannot_wait(told) {
                    return refused(&name);
                }
                self.arrived += 1;
                self.scheduled += 1;
                self.waiting.insert((at_step, self.arrived), told.clone());
                Some(Came::Scheduled(at_step))
            }
            _ => match self.execute(told) {
                Ok(()) if matches!(told, Told::Step(_)) => {
                    self.stepped = None;
                    None
                }
                Ok(()) => Some(Came::Out {
                    step: self.step,
                    seq: self.seq,
                }),
                Err(name) => Some(Came::Refused(name)),
            },
        }
    }

    /// Carries an order out, or says by which error it is refused.
    fn execute(&mut self, told: &Told) -> Result<(), String> {
        let at = self.step;
        let applied = match told {
            Told::Step(steps) => match self.doing {
                Doing::Paused => {
                    self.answer_pending();
                    self.doing = Doing::Stepping(self.step + steps);
                    self.pending = Some(self.step);
                    1
                }
                Doing::Running(_) | Doing::Stepping(_) => return Err("Phase(Running)".into()),
            },
            Told::Run { until, rate } => {
                let until = match self.doing {
                    Doing::Running(end) => until.or(end),
                    _ => *until,
                };
                if until.is_some_and(|until| until < self.step) {
                    return Err("Past".into());
                }
                self.answer_pending();
                self.rate = *rate;
                self.is_due = true;
                self.doing = Doing::Running(until);
                self.arrive();
                1
            }
            Told::Pause => {
                self.answer_pending();
                self.doing = Doing::Paused;
                1
            }
            Told::Change(change) => {
                self.n = changed(self.n, *change)?;
                1
            }
            Told::Batch(changes) => {
                let mut n = self.n;
                for change in changes {
                    n = changed(n, *change).map_err(|name| format!("InBatch({name})"))?;
                }
                self.n = n;
                changes.len() as u64
            }
            Told::Reset => {
                self.answer_pending();
                self.doing = Doing::Paused;
                self.step = 0;
                self.epoch += 1;
                self.n = self.n_at_start;
                self.refused_later += self.waiting.len();
                self.waiting.clear();
                1
            }
            Told::Delete => {
                self.answer_pending();
                self.deleted = true;
                1
            }
        };
        self.seq += applied;
        let at = if matches!(told, Told::Reset) { 0 } else { at };
        if !self.deleted {
            self.journal.push((self.seq, self.epoch, at));
        }
        Ok(())
    }

    /// Moves until nothing more happens by itself.
    pub fn settle(&mut self) {
        while !self.deleted {
            match self.doing {
                Doing::Stepping(_) => {}
                Doing::Running(_) if self.rate == FAST || self.is_due => {}
                _ => return,
            }
            self.is_due = false;
            self.step += 1;
            let had_ended = self.arrive();
            while let Some(first) = self.waiting.first_entry() {
                if first.key().0 > self.step {
                    break;
                }
                let told = first.remove();
                if self.execute(&told).is_err() {
                    self.refused_later += 1;
                }
                if self.deleted {
                    return;
                }
            }
            if had_ended && !matches!(self.doing, Doing::Stepping(_)) {
                self.answer_pending();
            }
        }
    }

    /// Pauses if this is where it was to go. Tells whether it was.
    fn arrive(&mut self) -> bool {
        let until = match self.doing {
            Doing::Running(until) => until,
            Doing::Stepping(until) => Some(until),
            Doing::Paused => None,
        };
        let has_arrived = until.is_some_and(|until| self.step >= until);
        if has_arrived {
            self.doing = Doing::Paused;
        }
        has_arrived
    }

    fn answer_pending(&mut self) {
        if let Some(from) = self.pending.take() {
            // Of those that follow by themselves nobody waits for the answer.
            self.stepped.get_or_insert(Came::Stepped {
                step: self.step,
                taken: self.step - from,
            });
        }
    }
}

/// The size of a group after a change, or the error it is refused with.
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

/// Why an order is refused already when it is put off: a number that no state would allow.
fn cannot_wait(told: &Told) -> Option<String> {
    let is_wrong = |change: &Step| matches!(change, Step::Set(false));
    match told {
        Told::Change(change) if is_wrong(change) => Some("Parameters".into()),
        Told::Batch(changes) if changes.iter().any(is_wrong) => Some("InBatch(Parameters)".into()),
        _ => None,
    }
}
