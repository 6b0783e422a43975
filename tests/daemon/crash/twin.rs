//! What a swarm must be: the commands that its journal names carried out anew, by nothing that
//! the daemon steps, journals or recovers with.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use jostle_physics::simulation::Change;
use jostle_physics::simulation::Simulation;
use jostle_proto::verbs::CreateArgs;
use jostle_proto::{Phase, Request};
use jostled::convert::commands::{self, create};
use jostled::persistence::writer;
use jostled::store::Row;
use jostled::swarm::command::{Command, Until};
use jostled::swarm::journal::Record;
use jostled::swarm::registry::Limits;
use jostled::swarm::sender::Sender;
use serde_json::value::RawValue;
use serde_json::{Value, json};

/// What was sent and answered: by client and request.
pub type Answers = HashMap<(String, String), Value>;

/// A command's name.
type Name = (String, String);

/// A swarm carried out anew, as far as its journal goes.
pub struct Twin {
    name: String,
    simulation: Simulation,
    /// The notes so far, which the number of a draw does not count.
    annotations: u64,
    moving: Moving,
    waiting: BTreeMap<u64, Vec<(u64, Vec<Change>, Name)>>,
    /// The last line carried out.
    pub line: u64,
    epoch: u64,
    /// What became of each line's command: its number, or nothing if it was refused.
    record_outcome: HashMap<u64, Option<u64>>,
    /// The hashes that steps were answered with.
    hashes: BTreeMap<u64, String>,
    applied: BTreeMap<Name, u64>,
    schedule_command: BTreeSet<Name>,
    /// Whether what it does now is to be undone.
    is_trying: bool,
    /// Every hash it had, if it is to remember them.
    passed: Option<BTreeSet<String>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Moving {
    No,
    /// Running, perhaps until a step.
    To(Option<u64>),
}

impl Twin {
    pub fn new(name: &str, spec: &Value) -> Self {
        let args: CreateArgs = serde_json::from_value(json!({"name": name, "spec": spec})).unwrap();
        let limits = Limits {
            max_individuals: 2000,
            max_swarms: 100,
            max_memory_bytes: 1 << 32,
            max_hz: 50,
        };
        let recipe = create::spec(&args, limits).unwrap();
        Twin {
            name: name.to_owned(),
            simulation: Simulation::new(&recipe).unwrap(),
            annotations: 0,
            moving: Moving::No,
            waiting: BTreeMap::new(),
            line: 0,
            epoch: 1,
            record_outcome: HashMap::new(),
            hashes: BTreeMap::new(),
            applied: BTreeMap::new(),
            schedule_command: BTreeSet::new(),
            is_trying: false,
            passed: None,
        }
    }

    fn seq(&self) -> u64 {
        self.simulation.seq + self.annotations
    }

    fn at(&self) -> u64 {
        self.simulation.state.step
    }

    pub fn hash(&self) -> String {
        let hash = self.simulation.state.hash();
        hash.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Remembers every hash it has from now on.
    pub fn remember_all(&mut self) {
        self.passed = Some(BTreeSet::new());
        self.remember();
    }

    /// Every hash it had.
    pub fn passed(self) -> BTreeSet<String> {
        self.passed.unwrap_or_default()
    }

    fn remember(&mut self) {
        if self.passed.is_some() {
            let hash = self.hash();
            self.passed.get_or_insert_default().insert(hash);
        }
    }

    /// Carries out what the journal says since, and holds it against what was answered.
    pub fn tell(&mut self, rows: Vec<Row>, answers: &Answers) {
        for row in rows {
            assert_eq!(row.number, self.line + 1, "{}: a gap", self.name);
            self.line = row.number;
            match writer::read_record(&row.body).unwrap() {
                Record::Input {
                    at_step, sender, ..
                } => {
                    assert_eq!(row.epoch, self.epoch, "{}: {sender:?}", self.name);
                    self.step_to(row.step);
                    self.execute(at_step, &sender, answers);
                }
                Record::Outcome { input, seq, .. } => {
                    // A step's line says itself; so early a line was told before the last kill.
                    if let Some(record_outcome) = self.record_outcome.get(&input) {
                        assert_eq!(*record_outcome, seq, "{}: line {input}", self.name);
                    }
                }
                Record::Resumed(epoch) => {
                    assert!(epoch > self.epoch, "{}: {epoch}", self.name);
                    self.step_to(row.step);
                    self.epoch = epoch;
                }
                Record::Hash(_) => {}
                Record::Fault(reason) => panic!("{}: {reason}", self.name),
            }
        }
    }

    fn step_to(&mut self, step: u64) {
        let name = self.name.clone();
        assert!(
            self.at() <= step,
            "{name}: {} is taken back to {step}",
            self.at()
        );
        while self.at() < step {
            let Moving::To(until) = self.moving else {
                panic!("{name}: stands at {} and is to be at {step}", self.at());
            };
            self.simulation.step().unwrap();
            self.remember();
            let at = self.at();
            if until == Some(at) {
                self.moving = Moving::No;
            }
            for (line, changes, id) in self.waiting.remove(&at).unwrap_or_default() {
                let made = self.apply(&changes);
                if self.is_trying {
                    continue;
                }
                self.record_outcome.insert(line, made);
                if made.is_some() {
                    self.note(id);
                }
            }
            if let Some(hash) = self.hashes.remove(&at) {
                assert_eq!(hash, self.hash(), "{}: answered at step {at}", self.name);
            }
        }
    }

    fn execute(&mut self, at_step: Option<u64>, sender: &Sender, answers: &Answers) {
        let id = (
            sender.client.clone().unwrap(),
            sender.request_id.clone().unwrap(),
        );
        let answer = answers.get(&id);
        let step = self.at();
        let made = match (order(sender), at_step) {
            (Command::Change(change), None) => self.apply(&[change]),
            (Command::Batch(changes), None) => self.apply(&changes),
            (Command::Change(change), Some(at_step)) => {
                let waiting = self.waiting.entry(at_step).or_default();
                waiting.push((self.line, vec![change], id.clone()));
                let told = format!("{}: {id:?} was put off twice", self.name);
                assert!(self.schedule_command.insert(id), "{told}");
                if let Some(answer) = answer {
                    assert_eq!(answer["result"]["applies_at_step"], at_step);
                }
                return;
            }
            (
                Command::Run {
                    until: Some(Until::Step(until)),
                    ..
                },
                None,
            ) if until < step => None,
            (Command::Annotate, None) => {
                self.annotations += 1;
                Some(self.seq())
            }
            (order, None) => {
                self.simulation.seq += 1;
                self.move_by(order, answer);
                Some(self.seq())
            }
            (order, at_step) => panic!("{}: {order:?} at {at_step:?}", self.name),
        };
        self.record_outcome.insert(self.line, made);
        let Some(seq) = made else { return };
        if let Some(answer) = answer.filter(|_| sender.verb != "step") {
            let told = [&answer["seq"], &answer["step"]].map(|it| it.as_u64().unwrap());
            let step = if sender.verb == "reset" { 0 } else { step };
            assert_eq!(told, [seq, step], "{}: {sender:?}: {answer}", self.name);
        }
        self.note(id);
    }

    fn move_by(&mut self, order: Command, answer: Option<&Value>) {
        match order {
            Command::Step(steps) => {
                assert_eq!(self.moving, Moving::No, "{}", self.name);
                let until = self.at() + steps;
                self.moving = Moving::To(Some(until));
                if let Some(answer) = answer {
                    assert_eq!(answer["step"], until, "{}: {answer}", self.name);
                    let hash = answer["result"]["state_hash"].as_str().unwrap();
                    self.hashes.insert(until, hash.to_owned());
                }
            }
            Command::Run { until, .. } => {
                let until = until.map(|until| match until {
                    Until::Step(step) => step,
                    Until::Time(time) => panic!("until {time}"),
                });
                self.moving = match self.moving {
                    Moving::To(end) => Moving::To(until.or(end)),
                    Moving::No if until == Some(self.at()) => Moving::No,
                    Moving::No => Moving::To(until),
                };
            }
            Command::Pause => self.moving = Moving::No,
            Command::Reset(seed) => {
                let fresh = self.simulation.build_start(seed).unwrap();
                self.simulation.restart(fresh);
                self.epoch += 1;
                self.waiting.clear();
                self.hashes.clear();
                self.moving = Moving::No;
            }
            other => panic!("{other:?}"),
        }
    }

    /// Makes changes under the next number, if they are possible, and tells the last one's.
    fn apply(&mut self, changes: &[Change]) -> Option<u64> {
        let before = self.simulation.save();
        self.simulation.seq += 1;
        if self.simulation.apply_all(changes).is_ok() {
            self.remember();
            return Some(self.seq());
        }
        self.simulation.rollback(before);
        None
    }

    fn note(&mut self, id: Name) {
        let told = format!("{}: {id:?} was carried out twice", self.name);
        let before = self.applied.insert(id, self.seq());
        assert!(before.is_none(), "{told}");
    }

    /// Whether what was sent under this name was carried out, or put off until its step.
    pub fn has(&self, id: &Name) -> bool {
        self.applied.contains_key(id) || self.schedule_command.contains(id)
    }

    /// Holds an answer against what was carried out, perhaps long before it was given.
    pub fn check(&self, id: &Name, answer: &Value) {
        let is_a_step = answer["result"]["durable_step"].is_u64();
        if let Some(seq) = self.applied.get(id)
            && !is_a_step
            && !self.schedule_command.contains(id)
        {
            assert_eq!(answer["seq"], *seq, "{}: {id:?}: {answer}", self.name);
        }
    }

    /// Runs to a step with nobody else there.
    pub fn run_to(&mut self, step: u64) {
        self.moving = Moving::To(None);
        self.step_to(step);
    }

    /// Compares the swarm, as it came back, with what it must be.
    pub fn compare(&mut self, status: &Value) {
        let name = self.name.clone();
        let number = |field: &str| status[field].as_u64().unwrap();
        let (step, seq, epoch) = (number("step"), number("seq"), number("epoch"));
        assert!(epoch > self.epoch, "{name}: {status}");
        let phase: Phase = serde_json::from_value(status["phase"].clone()).unwrap();
        let (before, moving) = (self.simulation.save(), self.moving);
        let (waiting, hashes) = (self.waiting.clone(), self.hashes.clone());
        self.is_trying = true;
        self.step_to(step);
        self.is_trying = false;
        let expected = match self.moving {
            Moving::No => Phase::Paused,
            Moving::To(_) => Phase::Running,
        };
        assert_eq!(phase, expected, "{name}: {status}");
        assert_eq!(self.seq(), seq, "{name}: {status}");
        let hash = &status["result"]["state_hash"];
        assert_eq!(*hash, self.hash(), "{name} at step {step}, {moving:?}");
        // A crash may take it back to here once more.
        self.simulation.rollback(before);
        (self.moving, self.waiting, self.hashes) = (moving, waiting, hashes);
    }
}

fn order(sender: &Sender) -> Command {
    let args = RawValue::from_string(sender.args.clone()).unwrap();
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    let (message, _) = commands::read(sender.verb, &request).ok().unwrap();
    message.command
}
