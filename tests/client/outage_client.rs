//! The client of `outages.rs`, in a process of its own: makes the calls of `tests/outages.toml` at the
//! same time, each again and again.
//!
//! It prints `ready` when each call has begun, reads a line when the outage is over, continues until
//! each call has succeeded after that, and prints what it saw as a line of JSON.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use jostle_client::{
    Client, ConnectOptions, Controller, Error, EventsFrom, Follow, FollowOptions, Update,
};
use jostle_proto::verbs::{AnnotateArgs, JoinArgs, Mode, OnTimeout, Return, Select};
use jostle_proto::{ErrorCode, EventKind};
use serde::{Deserialize, Serialize};

/// Makes a copy of this program the client: the endpoint, and the last step of the swarms.
pub const CLIENT: &str = "JOSTLE_TEST_OUTAGE_CLIENT";
pub const SWARM: &str = "rust";
pub const STEERED: &str = "rust-steered";
pub const LAST_NOTE: &str = "last";

/// The timeout of requests that is longer than each outage, and the short one.
const TIMEOUT: Duration = Duration::from_secs(40);
pub const SHORT_TIMEOUT: Duration = Duration::from_secs(1);
/// Between two requests of a kind.
const PAUSE: Duration = Duration::from_millis(50);
/// Between two notes, of which the daemon accepts ten a second.
const NOTE_PAUSE: Duration = Duration::from_millis(200);

/// What the client saw.
#[derive(Default, Serialize, Deserialize)]
pub struct Seen {
    /// By the call: its beginning, its end and the code of its error.
    pub attempts: BTreeMap<String, Vec<Attempt>>,
    /// By the stream: whether the daemon is reachable, when that changes.
    pub said: BTreeMap<String, Vec<bool>>,
    /// The notes that succeeded.
    pub noted: Vec<String>,
    /// The numbers of the events, and their notes.
    pub events: Vec<(u64, Option<String>)>,
    /// The epochs and the steps of the states.
    pub states: Vec<(u64, u64)>,
    /// The steps that the controller reached.
    pub reached: Vec<u64>,
}

#[derive(Serialize, Deserialize)]
pub struct Attempt {
    pub began: f64,
    pub ended: f64,
    pub code: Option<String>,
}

/// Seconds of the clock that all processes share.
pub fn now() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as f64 + now.tv_nsec as f64 / 1e9
}

/// Not a test: the client, in a copy of this program.
#[tokio::test(flavor = "multi_thread")]
async fn client_process() {
    let Ok(arguments) = std::env::var(CLIENT) else {
        return;
    };
    let (endpoint, last) = arguments.split_once(' ').unwrap();
    let last: u64 = last.parse().unwrap();
    let options = ConnectOptions {
        timeout: TIMEOUT,
        ..ConnectOptions::to(endpoint)
    };
    let client = Client::connect(options).await.unwrap();
    let caller = Caller {
        short: client.with_timeout(SHORT_TIMEOUT),
        client,
        seen: Arc::default(),
        is_over: Arc::default(),
    };
    let calls = [
        tokio::spawn(caller.clone().reads()),
        tokio::spawn(caller.clone().short_reads()),
        tokio::spawn(caller.clone().commands()),
        tokio::spawn(caller.clone().states(last)),
        tokio::spawn(caller.clone().events()),
        tokio::spawn(caller.clone().advances()),
    ];
    while !caller.has_begun() {
        tokio::time::sleep(PAUSE).await;
    }
    println!("ready");
    let over = tokio::task::spawn_blocking(|| std::io::stdin().read_line(&mut String::new()));
    over.await.unwrap().unwrap();
    caller.is_over.store(true, Ordering::SeqCst);
    for call in calls {
        call.await.unwrap();
    }
    println!(
        "{}",
        serde_json::to_string(&*caller.seen.lock().unwrap()).unwrap()
    );
}

#[derive(Clone)]
struct Caller {
    client: Client,
    short: Client,
    seen: Arc<Mutex<Seen>>,
    is_over: Arc<AtomicBool>,
}

impl Caller {
    fn has_begun(&self) -> bool {
        let seen = self.seen.lock().unwrap();
        let requests = ["read", "short_read", "command", "advance"];
        let are_sent = requests.iter().all(|it| seen.attempts.contains_key(*it));
        are_sent && !seen.states.is_empty() && !seen.events.is_empty()
    }

    /// Notes how an attempt of a call ended; returns whether it succeeded and none must follow.
    async fn note<T>(
        &self,
        call: &str,
        attempt: impl Future<Output = Result<T, Error>>,
    ) -> Option<T> {
        let began = now();
        let outcome = attempt.await;
        let code = outcome.as_ref().err().map(code);
        let attempt = Attempt {
            began,
            ended: now(),
            code,
        };
        let mut seen = self.seen.lock().unwrap();
        seen.attempts
            .entry(call.to_owned())
            .or_default()
            .push(attempt);
        outcome.ok()
    }

    fn is_over(&self) -> bool {
        self.is_over.load(Ordering::SeqCst)
    }

    async fn repeat_read(&self, call: &str, client: &Client) {
        loop {
            let is_last = self.is_over();
            let reply = self.note(call, client.status(SWARM)).await;
            if reply.is_some() && is_last {
                return;
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    async fn reads(self) {
        self.repeat_read("read", &self.client).await;
    }

    async fn short_reads(self) {
        self.repeat_read("short_read", &self.short).await;
    }

    /// Writes numbered notes into the journal.
    async fn commands(self) {
        for number in 0.. {
            let is_last = self.is_over();
            let text = format!("note {number}");
            let args = AnnotateArgs { text: text.clone() };
            let reply = self
                .note("command", self.client.execute(SWARM, &args))
                .await;
            if reply.is_some() {
                self.seen.lock().unwrap().noted.push(text);
                if is_last {
                    return;
                }
            }
            tokio::time::sleep(NOTE_PAUSE).await;
        }
    }

    /// Advances by a step each time, and joins again if the controller was removed.
    async fn advances(self) {
        let args = JoinArgs {
            controller: "ada".into(),
            select: Some(Select::Ids(vec![0])),
            mode: Mode::Lockstep,
            deadline_secs: 60.0,
            on_timeout: OnTimeout::Hold,
            driving: false,
            again: false,
        };
        let (mut ada, _) = self.client.join(STEERED, args).await.unwrap();
        loop {
            let is_last = self.is_over();
            let reached = self.note("advance", advance(&mut ada)).await;
            if let Some(step) = reached {
                self.seen.lock().unwrap().reached.push(step);
                if is_last {
                    return;
                }
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Reads the stream of states until the last one.
    async fn states(self, last: u64) {
        let options = FollowOptions {
            states: Some(64),
            ..FollowOptions::default()
        };
        let mut updates = self.client.follow(SWARM, options).await.unwrap();
        let take = |seen: &mut Seen, update: &Update| match update {
            Update::State(state) => {
                seen.states.push((state.epoch, state.step));
                state.step == last
            }
            _ => false,
        };
        self.note("states", self.read("states", &mut updates, take))
            .await;
    }

    /// Reads the stream of events until the last note.
    async fn events(self) {
        let options = FollowOptions {
            events: Some(EventsFrom::After(0)),
            ..FollowOptions::default()
        };
        let mut updates = self.client.follow(SWARM, options).await.unwrap();
        let take = |seen: &mut Seen, update: &Update| match update {
            Update::Event(event) => {
                let text = match &event.event {
                    EventKind::Command { args, .. } => args["text"].as_str().map(str::to_owned),
                    _ => None,
                };
                seen.events.push((event.number, text.clone()));
                text.as_deref() == Some(LAST_NOTE)
            }
            _ => false,
        };
        self.note("events", self.read("events", &mut updates, take))
            .await;
    }

    async fn read(
        &self,
        call: &str,
        updates: &mut Follow,
        take: impl Fn(&mut Seen, &Update) -> bool,
    ) -> Result<(), Error> {
        while let Some(update) = updates.next().await {
            let update = update?;
            let mut seen = self.seen.lock().unwrap();
            if matches!(update, Update::Away | Update::Back) {
                let said = seen.said.entry(call.to_owned()).or_default();
                said.push(matches!(update, Update::Back));
            }
            if take(&mut seen, &update) {
                return Ok(());
            }
        }
        Err(Error::NotRecovered {
            swarm: SWARM.into(),
        })
    }
}

async fn advance(ada: &mut Controller) -> Result<u64, Error> {
    match ada.advance(1, None, Return::None).await {
        Err(error) if error.is_not_found() => {
            ada.sync().await?;
            Err(error)
        }
        outcome => Ok(outcome?.step),
    }
}

/// The code of an error as the table has it.
fn code(error: &Error) -> String {
    match error {
        Error::Rejected(error) if error.code == ErrorCode::NotFound => "not_found".to_owned(),
        Error::Rejected(error) => format!("{:?}: {}", error.code, error.message),
        Error::NoDaemon { .. }
        | Error::NoNode { .. }
        | Error::Silent { .. }
        | Error::TimedOut { .. } => "unavailable".to_owned(),
        error => error.to_string(),
    }
}
