//! Clients that send requests with a `request_id`, and retry them until they get a reply.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::crash::rng::Rng;
use crate::support::reference_model::Answers;
use crate::support::{Client, NODE, PREFIX};

/// Why commands are rejected on a healthy disk: their step is in the past, or the swarm was paused.
const EXPECTED: [ErrorCode; 2] = [ErrorCode::Conflict, ErrorCode::IncorrectState];

/// The state that the clients share.
pub struct Traffic {
    /// Set when the daemon was killed: clients stop waiting.
    pub is_over: AtomicBool,
    /// Requests without a reply.
    pub under_way: AtomicUsize,
    /// The time of the last reply.
    pub answered: Mutex<Instant>,
    /// Replies to commands of this daemon.
    pub answers: Mutex<Answers>,
    /// Whether writes of the disk fail, which rejects commands.
    pub disk_fails: bool,
    /// Commands of this daemon that were rejected therefore.
    pub rejected_as_full: AtomicUsize,
    /// Commands of this daemon that were rejected.
    pub rejected: Mutex<Vec<(String, String)>>,
}

/// The commands that a client sends.
#[derive(Clone, Copy, PartialEq)]
pub enum Role {
    /// Runs, pauses, steps, resets and schedules changes.
    Moves,
    /// Changes parameters and the group.
    Changes,
    /// Creates, forks and deletes swarms of one name.
    Creates,
}

/// One client: it has at most one request without a reply.
pub struct Sender {
    pub name: String,
    swarm: String,
    role: Role,
    rng: Rng,
    count: u64,
    is_running: bool,
    step: u64,
    pub unanswered: Option<SentRequest>,
    /// Of a client that creates: whether its swarm and the fork of it exist.
    has: (bool, bool),
}

#[derive(Clone, Debug)]
pub struct SentRequest {
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
            rng: Rng::new(seed),
            count: 0,
            is_running: false,
            step: 0,
            unanswered: None,
            has: (false, false),
        }
    }

    /// Sends one request after the other until the daemon is killed, beginning with the one that has no
    /// reply yet.
    pub async fn send_until_over(&mut self, client: &Client, traffic: &Arc<Traffic>) {
        while !traffic.is_over.load(Ordering::Relaxed) {
            if self.unanswered.is_none() {
                self.unanswered = Some(self.next_request());
            }
            if !self.send(client, traffic).await {
                return;
            }
        }
    }

    /// Retries the request that has no reply. Returns whether it got one.
    pub async fn send(&mut self, client: &Client, traffic: &Arc<Traffic>) -> bool {
        let Some(sent) = self.unanswered.clone() else {
            return true;
        };
        let payload = sent.request.to_string();
        traffic.under_way.fetch_add(1, Ordering::Relaxed);
        let answer = loop {
            let answers = tokio::select! {
                biased;
                answers = client.query_all(&sent.key, Some(payload.as_bytes())) => answers,
                () = wait_until_over(traffic) => break None,
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
                self.apply_reply(&sent, &reply);
                traffic.answers.lock().unwrap().insert(name, reply);
            }
            Err(error) => {
                let may_be_full = traffic.disk_fails && error.code == ErrorCode::StorageFull;
                let is_expected = may_be_full || EXPECTED.contains(&error.code);
                assert!(is_expected, "{sent:?}: {error:?}");
                traffic
                    .rejected_as_full
                    .fetch_add(usize::from(may_be_full), Ordering::Relaxed);
                traffic.rejected.lock().unwrap().push(name);
            }
        }
        true
    }

    fn apply_reply(&mut self, sent: &SentRequest, reply: &Value) {
        self.step = reply["step"].as_u64().unwrap();
        match sent.verb.as_str() {
            "run" => self.is_running = true,
            "pause" | "step" | "reset" => self.is_running = false,
            _ => {}
        }
    }

    /// A client that creates and deletes gets the result of its command, however often it retries: no
    /// other client uses the name.
    fn check_created(&mut self, sent: &SentRequest, answer: Result<Value, jostle_proto::Error>) {
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

    /// The swarms of a client that creates, and whether they exist.
    pub fn has(&self) -> Option<[(String, bool); 2]> {
        let fork = format!("{}-fork", self.swarm);
        (self.role == Role::Creates).then(|| [(self.swarm.clone(), self.has.0), (fork, self.has.1)])
    }

    fn next_request(&mut self) -> SentRequest {
        self.count += 1;
        let (verb, at_step, args) = match self.role {
            Role::Moves => self.next_move(),
            Role::Changes => self.next_change(),
            Role::Creates => return self.next_creation(),
        };
        self.request(keys::cmd(PREFIX, &self.swarm, verb), verb, at_step, &args)
    }

    fn request(&self, key: String, verb: &str, at_step: Option<u64>, args: &Value) -> SentRequest {
        let mut request = json!({
            "client": self.name, "request_id": self.count.to_string(), "timeout_secs": 60,
            "args": args,
        });
        if let Some(at_step) = at_step {
            request["at_step"] = json!(at_step);
        }
        SentRequest {
            key,
            verb: verb.to_owned(),
            request,
        }
    }

    fn next_move(&mut self) -> (&'static str, Option<u64>, Value) {
        let rng = &mut self.rng;
        match (rng.below(12), self.is_running) {
            (0, _) => ("reset", None, json!({"seed": rng.below(5)})),
            (1 | 2, _) => {
                let at_step = self.step + 5 + rng.below(200);
                let args = json!({"select": {"count": 2}, "direction": rng.part()});
                ("inform", Some(at_step), args)
            }
            (3, _) => {
                let at_step = self.step + 5 + rng.below(200);
                ("remove", Some(at_step), json!({"select": {"count": 1}}))
            }
            (4, false) => {
                let until = self.step + 1 + rng.below(400);
                let rate = rng.pick(&[json!(null), json!(20.0), json!(100.0)]).clone();
                ("run", None, json!({"until_step": until, "rate": rate}))
            }
            (5 | 6, false) => ("run", None, json!({"rate": rng.pick(&[2.0, 10.0, 50.0])})),
            (_, false) => ("step", None, json!({"steps": 1 + rng.below(60)})),
            (4 | 5, true) => ("run", None, json!({"rate": 5.0 + 20.0 * rng.part()})),
            (_, true) => ("pause", None, json!({})),
        }
    }

    fn next_change(&mut self) -> (&'static str, Option<u64>, Value) {
        let rng = &mut self.rng;
        let (direction, weight) = (6.0 * rng.part(), 0.05 + 0.4 * rng.part());
        let inform = json!({
            "select": {"count": 2}, "direction": direction, "weight": weight, "for_time": 0.5,
        });
        match rng.below(7) {
            0 => ("set", None, json!({"pi3": 0.9 + 0.2 * rng.part()})),
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
            // It never holds, and counts as a note.
            5 if self.count.is_multiple_of(2) => (
                "when",
                None,
                json!({"condition": "msd(0.5) >= 0 and order > 1 for 1000", "event": "mine"}),
            ),
            5 if self.count.is_multiple_of(3) => {
                ("protect", None, json!({"on": rng.below(3) == 0}))
            }
            5 => (
                "annotate",
                None,
                json!({"text": format!("note {}", self.count)}),
            ),
            _ => ("inject", None, json!({"count": 1, "direction": direction})),
        }
    }

    fn next_creation(&mut self) -> SentRequest {
        let fork = format!("{}-fork", self.swarm);
        let (create, delete) = (keys::node_cmd(PREFIX, NODE, "create"), |swarm: &str| {
            keys::cmd(PREFIX, swarm, "delete")
        });
        match (self.has, self.rng.below(4)) {
            ((false, _), _) => {
                let spec = json!({"n": 5 + self.rng.below(20), "seed": self.count});
                let args = json!({"name": self.swarm, "spec": spec});
                self.request(create, "create", None, &args)
            }
            ((true, false), 0) => {
                let key = keys::cmd(PREFIX, &self.swarm, "fork");
                self.request(key, "fork", None, &json!({"name": fork}))
            }
            ((true, true), 0) => self.request(delete(&fork), "delete", None, &json!({})),
            ((true, _), 1) => self.request(delete(&self.swarm), "delete", None, &json!({})),
            _ => {
                let key = keys::cmd(PREFIX, &self.swarm, "step");
                let args = json!({"steps": 1 + self.rng.below(20)});
                self.request(key, "step", None, &args)
            }
        }
    }
}

async fn wait_until_over(traffic: &Traffic) {
    while !traffic.is_over.load(Ordering::Relaxed) {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

fn is_temporary(code: ErrorCode) -> bool {
    matches!(code, ErrorCode::Busy | ErrorCode::DeadlineExceeded)
}
