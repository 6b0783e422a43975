//! Clients that send named requests, and send them again until they are answered.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::crash::dice::Dice;
use crate::crash::twin::Answers;
use crate::support::{Client, NODE, PREFIX};

/// Why commands are rejected on a healthy disk: their step is in the past, or the swarm was paused.
const EXPECTED: [ErrorCode; 2] = [ErrorCode::Conflict, ErrorCode::IncorrectState];

/// What the clients share.
pub struct Traffic {
    /// Set when the daemon was killed: who waits need not wait on.
    pub is_over: AtomicBool,
    /// Requests under way.
    pub under_way: AtomicUsize,
    /// When an answer last came.
    pub answered: Mutex<Instant>,
    /// Answers to commands, since they were last taken.
    pub answers: Mutex<Answers>,
    /// Whether writes of the disk fail, which rejects commands.
    pub disk_fails: bool,
    /// How many were rejected therefore, since they were last counted.
    pub refused_as_full: AtomicUsize,
    /// Commands that were rejected since.
    pub refused: Mutex<Vec<(String, String)>>,
}

/// What a client does.
#[derive(Clone, Copy, PartialEq)]
pub enum Role {
    /// Runs, pauses, steps, resets, and puts changes off.
    Moves,
    /// Changes parameters and the group.
    Changes,
    /// Creates, forks and deletes swarms of one name.
    Creates,
}

/// One client: it has at most one request under way.
pub struct Sender {
    pub name: String,
    swarm: String,
    role: Role,
    dice: Dice,
    count: u64,
    is_running: bool,
    step: u64,
    pub unanswered: Option<Sent>,
    /// What this one has, if it creates: whether its swarm, and the fork of it, are there.
    has: (bool, bool),
}

#[derive(Clone, Debug)]
pub struct Sent {
    key: String,
    verb: String,
    request: Value,
}

impl Sender {
    pub fn new(swarm: &str, role: Role, seed: u64) -> Self {
        let kind = match role {
            Role::Moves => "moves",
            Role::Changes => "changes",
            Role::Creates => "creates",
        };
        Sender {
            name: format!("{kind}-{swarm}"),
            swarm: swarm.to_owned(),
            role,
            dice: Dice::new(seed),
            count: 0,
            is_running: false,
            step: 0,
            unanswered: None,
            has: (false, false),
        }
    }

    /// Sends one request after the other until the daemon is killed. The first is the one that was
    /// not answered before.
    pub async fn send_on(&mut self, client: &Client, traffic: &Arc<Traffic>) {
        while !traffic.is_over.load(Ordering::Relaxed) {
            if self.unanswered.is_none() {
                self.unanswered = Some(self.make());
            }
            if !self.send(client, traffic).await {
                return;
            }
        }
    }

    /// Sends the request that is not answered until it is; whether it was.
    pub async fn send(&mut self, client: &Client, traffic: &Arc<Traffic>) -> bool {
        let Some(sent) = self.unanswered.clone() else {
            return true;
        };
        let payload = sent.request.to_string();
        traffic.under_way.fetch_add(1, Ordering::Relaxed);
        let answer = loop {
            let answers = tokio::select! {
                biased;
                answers = client.ask(&sent.key, Some(payload.as_bytes())) => answers,
                () = over(traffic) => break None,
            };
            match answers.into_iter().next() {
                Some(Err(error)) if is_temporary(error.code) => {}
                Some(Err(error))
                    if self.role == Role::Creates && error.code == ErrorCode::StorageFull =>
                {
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
                Some(answer) => break Some(answer),
                None => tokio::time::sleep(Duration::from_millis(1)).await,
            }
            if traffic.is_over.load(Ordering::Relaxed) {
                break None;
            }
        };
        if traffic.is_over.load(Ordering::Relaxed) && answer.is_none() {
            return false;
        }
        traffic.under_way.fetch_sub(1, Ordering::Relaxed);
        *traffic.answered.lock().unwrap() = Instant::now();
        self.unanswered = None;
        let answer = answer.unwrap();
        if self.role == Role::Creates {
            self.check_created(&sent, answer);
            return true;
        }
        let id = sent.request["request_id"].as_str().unwrap().to_owned();
        let name = (self.name.clone(), id);
        match answer {
            Ok(reply) => {
                self.learn(&sent, &reply);
                traffic.answers.lock().unwrap().insert(name, reply);
            }
            Err(error) => {
                let may_be_full = traffic.disk_fails && error.code == ErrorCode::StorageFull;
                let is_expected = may_be_full || EXPECTED.contains(&error.code);
                assert!(is_expected, "{sent:?}: {error:?}");
                traffic
                    .refused_as_full
                    .fetch_add(usize::from(may_be_full), Ordering::Relaxed);
                traffic.refused.lock().unwrap().push(name);
            }
        }
        true
    }

    fn learn(&mut self, sent: &Sent, reply: &Value) {
        self.step = reply["step"].as_u64().unwrap();
        match sent.verb.as_str() {
            "run" => self.is_running = true,
            "pause" | "step" | "reset" => self.is_running = false,
            _ => {}
        }
    }

    /// Whoever creates and deletes is told that it has, however often it had to ask: there is
    /// nobody else who could have.
    fn check_created(&mut self, sent: &Sent, answer: Result<Value, jostle_proto::Error>) {
        let reply = answer.unwrap_or_else(|error| panic!("{sent:?}: {error:?}"));
        match sent.verb.as_str() {
            "create" | "fork" => {
                assert_eq!(reply["result"]["created"], true, "{sent:?}: {reply}");
            }
            _ => {}
        }
        match (sent.verb.as_str(), sent.request["args"]["name"].as_str()) {
            ("create", _) => self.has.0 = true,
            ("fork", _) => self.has.1 = true,
            ("delete", _) if sent.key.contains("-fork/") => self.has.1 = false,
            ("delete", _) => self.has.0 = false,
            _ => {}
        }
    }

    /// What this one's swarms are: its own and the fork of it.
    pub fn has(&self) -> Option<[(String, bool); 2]> {
        let fork = format!("{}-fork", self.swarm);
        (self.role == Role::Creates).then(|| [(self.swarm.clone(), self.has.0), (fork, self.has.1)])
    }

    fn make(&mut self) -> Sent {
        self.count += 1;
        let (verb, at_step, args) = match self.role {
            Role::Moves => self.a_move(),
            Role::Changes => self.a_change(),
            Role::Creates => return self.a_creation(),
        };
        self.sent(keys::cmd(PREFIX, &self.swarm, verb), verb, at_step, &args)
    }

    fn sent(&self, key: String, verb: &str, at_step: Option<u64>, args: &Value) -> Sent {
        let mut request = json!({
            "client": self.name, "request_id": self.count.to_string(), "timeout_secs": 60,
            "args": args,
        });
        if let Some(at_step) = at_step {
            request["at_step"] = json!(at_step);
        }
        Sent {
            key,
            verb: verb.to_owned(),
            request,
        }
    }

    fn a_move(&mut self) -> (&'static str, Option<u64>, Value) {
        let dice = &mut self.dice;
        match (dice.below(12), self.is_running) {
            (0, _) => ("reset", None, json!({"seed": dice.below(5)})),
            (1 | 2, _) => {
                let at_step = self.step + 5 + dice.below(200);
                let args = json!({"select": {"count": 2}, "direction": dice.part()});
                ("inform", Some(at_step), args)
            }
            (3, _) => {
                let at_step = self.step + 5 + dice.below(200);
                ("remove", Some(at_step), json!({"select": {"count": 1}}))
            }
            (4, false) => {
                let until = self.step + 1 + dice.below(400);
                let rate = dice.pick(&[json!(null), json!(20.0), json!(100.0)]).clone();
                ("run", None, json!({"until_step": until, "rate": rate}))
            }
            (5 | 6, false) => ("run", None, json!({"rate": dice.pick(&[2.0, 10.0, 50.0])})),
            (_, false) => ("step", None, json!({"steps": 1 + dice.below(60)})),
            (4 | 5, true) => ("run", None, json!({"rate": 5.0 + 20.0 * dice.part()})),
            (_, true) => ("pause", None, json!({})),
        }
    }

    fn a_change(&mut self) -> (&'static str, Option<u64>, Value) {
        let dice = &mut self.dice;
        let (direction, weight) = (6.0 * dice.part(), 0.05 + 0.4 * dice.part());
        let inform = json!({
            "select": {"count": 2}, "direction": direction, "weight": weight, "for_time": 0.5,
        });
        match dice.below(7) {
            0 => ("set", None, json!({"pi3": 0.9 + 0.2 * dice.part()})),
            1 | 2 => ("inform", None, inform),
            3 => ("uninform", None, json!({"select": {"fraction": 0.5}})),
            4 => (
                "batch",
                None,
                json!({"commands": [
                    {"verb": "inject", "args": {"count": 1}},
                    {"verb": "remove", "args": {"select": {"count": 1}}},
                    {"verb": "inform", "args": inform},
                ]}),
            ),
            5 => (
                "annotate",
                None,
                json!({"text": format!("note {}", self.count)}),
            ),
            _ => ("inject", None, json!({"count": 1, "direction": direction})),
        }
    }

    fn a_creation(&mut self) -> Sent {
        let fork = format!("{}-fork", self.swarm);
        let (create, delete) = (keys::node_cmd(PREFIX, NODE, "create"), |swarm: &str| {
            keys::cmd(PREFIX, swarm, "delete")
        });
        match (self.has, self.dice.below(4)) {
            ((false, _), _) => {
                let spec = json!({"n": 5 + self.dice.below(20), "seed": self.count});
                let args = json!({"name": self.swarm, "spec": spec});
                self.sent(create, "create", None, &args)
            }
            ((true, false), 0) => {
                let key = keys::cmd(PREFIX, &self.swarm, "fork");
                self.sent(key, "fork", None, &json!({"name": fork}))
            }
            ((true, true), 0) => self.sent(delete(&fork), "delete", None, &json!({})),
            ((true, _), 1) => self.sent(delete(&self.swarm), "delete", None, &json!({})),
            _ => {
                let key = keys::cmd(PREFIX, &self.swarm, "step");
                let args = json!({"steps": 1 + self.dice.below(20)});
                self.sent(key, "step", None, &args)
            }
        }
    }
}

async fn over(traffic: &Traffic) {
    while !traffic.is_over.load(Ordering::Relaxed) {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

fn is_temporary(code: ErrorCode) -> bool {
    matches!(code, ErrorCode::Busy | ErrorCode::DeadlineExceeded)
}
