//! A reference model of a swarm: it executes the commands of the journal with the simulation alone,
//! without the code of the daemon that steps, journals and recovers.

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

/// Replies by client and request.
pub type Answers = HashMap<(String, String), Value>;

/// The client and the `request_id` of a command.
type RequestName = (String, String);

/// The swarm as its journal describes it.
pub struct ReferenceModel {
    name: String,
    simulation: Simulation,
    /// The number of annotations so far, which does not count in the seed of a draw.
    annotations: u64,
    /// Whether it rejects `reset`.
    is_protected: bool,
    moving: Movement,
    waiting: BTreeMap<u64, Vec<(u64, Vec<Change>, RequestName)>>,
    /// The last line that was executed.
    pub line: u64,
    epoch: u64,
    /// The `seq` of each line's command; `None` if it was rejected.
    outcomes: HashMap<u64, Option<u64>>,
    /// The hashes in replies, by step.
    hashes: BTreeMap<u64, String>,
    applied: BTreeMap<RequestName, u64>,
    scheduled: BTreeSet<RequestName>,
    /// Whether the present steps will be rolled back.
    is_trying: bool,
    /// Every hash it had, if they are recorded.
    recorded_hashes: Option<BTreeSet<String>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Movement {
    No,
    /// Running, perhaps until a step.
    To(Option<u64>),
}

impl ReferenceModel {
    pub fn new(name: &str, spec: &Value) -> Self {
        let args: CreateArgs = serde_json::from_value(json!({"name": name, "spec": spec})).unwrap();
        let limits = Limits {
            max_individuals: 2000,
            max_swarms: 100,
            max_memory_bytes: 1 << 32,
            max_hz: 50,
        };
        let spec = create::spec(&args, limits).unwrap();
        ReferenceModel {
            name: name.to_owned(),
            simulation: Simulation::new(&spec).unwrap(),
            annotations: 0,
            is_protected: false,
            moving: Movement::No,
            waiting: BTreeMap::new(),
            line: 0,
            epoch: 1,
            outcomes: HashMap::new(),
            hashes: BTreeMap::new(),
            applied: BTreeMap::new(),
            scheduled: BTreeSet::new(),
            is_trying: false,
            recorded_hashes: None,
        }
    }

    fn seq(&self) -> u64 {
        self.simulation.seq + self.annotations
    }

    fn step(&self) -> u64 {
        self.simulation.state.step
    }

    pub fn hash(&self) -> String {
        let hash = self.simulation.state.hash();
        hash.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Records every hash from now on.
    pub fn record_hashes(&mut self) {
        self.recorded_hashes = Some(BTreeSet::new());
        self.record_hash();
    }

    /// Every hash it had.
    pub fn recorded_hashes(self) -> BTreeSet<String> {
        self.recorded_hashes.unwrap_or_default()
    }

    fn record_hash(&mut self) {
        if self.recorded_hashes.is_some() {
            let hash = self.hash();
            self.recorded_hashes.get_or_insert_default().insert(hash);
        }
    }

    /// Executes the next rows of the journal, and compares the results with the replies.
    pub fn replay(&mut self, rows: Vec<Row>, answers: &Answers) {
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
                    // The line of a `step` has its own outcome; an earlier line was read before the
                    // last kill.
                    if let Some(outcomes) = self.outcomes.get(&input) {
                        assert_eq!(*outcomes, seq, "{}: line {input}", self.name);
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
            self.step() <= step,
            "{name}: {} cannot go back to {step}",
            self.step()
        );
        while self.step() < step {
            let Movement::To(until) = self.moving else {
                panic!("{name}: paused at {}, before step {step}", self.step());
            };
            self.simulation.step().unwrap();
            self.record_hash();
            let at = self.step();
            if until == Some(at) {
                self.moving = Movement::No;
            }
            for (line, changes, id) in self.waiting.remove(&at).unwrap_or_default() {
                let applied = self.apply(&changes);
                if self.is_trying {
                    continue;
                }
                self.outcomes.insert(line, applied);
                if applied.is_some() {
                    self.record_applied(id);
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
        let step = self.step();
        let applied = match (parse_command(sender), at_step) {
            (Command::Change(change), None) => self.apply(&[change]),
            (Command::Batch { changes, .. }, None) => self.apply(&changes),
            (Command::Change(change), Some(at_step)) => {
                let waiting = self.waiting.entry(at_step).or_default();
                waiting.push((self.line, vec![change], id.clone()));
                let context = format!("{}: {id:?} was scheduled twice", self.name);
                assert!(self.scheduled.insert(id), "{context}");
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
            (Command::Reset(_), None) if self.is_protected => None,
            (command, None) if command.is_annotation() => {
                if let Command::Protect(on) = command {
                    self.is_protected = on;
                }
                self.annotations += 1;
                Some(self.seq())
            }
            (command, None) => {
                self.simulation.seq += 1;
                self.apply_movement(command, answer);
                Some(self.seq())
            }
            (command, at_step) => panic!("{}: {command:?} at {at_step:?}", self.name),
        };
        self.outcomes.insert(self.line, applied);
        let Some(seq) = applied else { return };
        if let Some(answer) = answer.filter(|_| sender.verb != "step") {
            let actual = [&answer["seq"], &answer["step"]].map(|it| it.as_u64().unwrap());
            let step = if sender.verb == "reset" { 0 } else { step };
            assert_eq!(actual, [seq, step], "{}: {sender:?}: {answer}", self.name);
        }
        self.record_applied(id);
    }

    fn apply_movement(&mut self, command: Command, answer: Option<&Value>) {
        match command {
            Command::Step(steps) => {
                assert_eq!(self.moving, Movement::No, "{}", self.name);
                let until = self.step() + steps;
                self.moving = Movement::To(Some(until));
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
                    Movement::To(end) => Movement::To(until.or(end)),
                    Movement::No if until == Some(self.step()) => Movement::No,
                    Movement::No => Movement::To(until),
                };
            }
            Command::Pause => self.moving = Movement::No,
            Command::Reset(seed) => {
                let fresh = self.simulation.build_start(seed).unwrap();
                self.simulation.restart(fresh);
                self.epoch += 1;
                self.waiting.clear();
                self.hashes.clear();
                self.moving = Movement::No;
            }
            other => panic!("{other:?}"),
        }
    }

    /// Applies changes under the next `seq`, and returns it; `None` if one is rejected.
    fn apply(&mut self, changes: &[Change]) -> Option<u64> {
        let before = self.simulation.save();
        let first = self.simulation.seq + 1;
        if self.simulation.apply_all_at(first, changes).is_ok() {
            self.record_hash();
            return Some(self.seq());
        }
        self.simulation.rollback(before);
        None
    }

    fn record_applied(&mut self, id: RequestName) {
        let context = format!("{}: {id:?} was executed twice", self.name);
        let before = self.applied.insert(id, self.seq());
        assert!(before.is_none(), "{context}");
    }

    /// Whether a command was executed or scheduled.
    pub fn has(&self, id: &RequestName) -> bool {
        self.applied.contains_key(id) || self.scheduled.contains(id)
    }

    /// Compares a reply with the command's execution.
    pub fn check(&self, id: &RequestName, answer: &Value) {
        let is_a_step = answer["result"]["durable_step"].is_u64();
        if let Some(seq) = self.applied.get(id)
            && !is_a_step
            && !self.scheduled.contains(id)
        {
            assert_eq!(answer["seq"], *seq, "{}: {id:?}: {answer}", self.name);
        }
    }

    /// Runs to a step without further commands.
    pub fn run_to(&mut self, step: u64) {
        self.moving = Movement::To(None);
        self.step_to(step);
    }

    /// Compares the status of the recovered swarm with the model.
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
            Movement::No => Phase::Paused,
            Movement::To(_) => Phase::Running,
        };
        assert_eq!(phase, expected, "{name}: {status}");
        assert_eq!(self.seq(), seq, "{name}: {status}");
        let is_protected = status["result"]["protected"] == true;
        assert_eq!(is_protected, self.is_protected, "{name}: {status}");
        let hash = &status["result"]["state_hash"];
        assert_eq!(*hash, self.hash(), "{name} at step {step}, {moving:?}");
        // The next crash may roll the swarm back to here again.
        self.simulation.rollback(before);
        (self.moving, self.waiting, self.hashes) = (moving, waiting, hashes);
    }
}

fn parse_command(sender: &Sender) -> Command {
    let args = RawValue::from_string(sender.args.clone()).unwrap();
    let request = Request {
        args: Some(args),
        ..Request::default()
    };
    let (message, _) = commands::read(sender.verb, &request).ok().unwrap();
    message.command
}
