//! Every request that has a name is carried out once: its first answer is given again.
//!
//! A client that got no answer cannot know whether its command was carried out. It sends the same
//! request under the same `client` and `request_id` once more, and gets the answer it missed. What
//! was refused changed nothing, is not kept, and may be tried again under the same name.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jostle_proto::{CBOR, JSON, Request};
use serde_json::Value;

use crate::server::answer::Promise;
use crate::store::{self, Store, Write};
use crate::wire::Payload;

/// Answers remembered, and the bytes they may take; the oldest give way.
const MOST: (usize, usize) = (100_000, 64 * 1024 * 1024);

/// Below this every whole number is a double.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// What an answer takes beside its bytes: its name, its digest, and its share of the tables.
const ANSWER_BYTES: usize = 384;

/// A request's name: who says to have sent it, and what they called it.
pub type Name = (Option<String>, String);

/// A request without what may differ when it is sent again.
pub type Digest = [u8; 32];

/// The named requests, and what they came to. Clones are the same one.
#[derive(Clone)]
pub struct Ledger {
    requests: Arc<Mutex<Requests>>,
    store: Store,
}

struct Requests {
    by_name: HashMap<Arc<Name>, Box<Entry>>,
    done: VecDeque<Arc<Name>>,
    bytes: usize,
}

impl Default for Requests {
    /// With room for as many as there may be: a table that moves when it is full holds up whoever
    /// asks, and takes megabytes more at once.
    fn default() -> Self {
        let (most, _) = MOST;
        Requests {
            by_name: HashMap::with_capacity(most + 1),
            done: VecDeque::with_capacity(most + 1),
            bytes: 0,
        }
    }
}

struct Entry {
    digest: Digest,
    progress: Progress,
}

enum Progress {
    /// Being carried out; these have asked again meanwhile.
    Underway(Vec<Promise>),
    /// Carried out.
    Done(Result<Payload, Payload>),
}

/// What is to be done with a named request.
pub enum Entered {
    /// It is new: carry it out and write down what it came to.
    New(Page),
    /// It is known, and answered now or as soon as it is carried out.
    Known,
    /// Another request has this name.
    Other,
}

/// Where the answer to one request is to be written. Dropped unwritten, the request is forgotten.
pub struct Page {
    ledger: Ledger,
    name: Arc<Name>,
    is_written: bool,
}

impl Ledger {
    /// An empty ledger whose answers are kept in `store` too.
    pub fn new(store: Store) -> Self {
        Ledger {
            requests: Arc::default(),
            store,
        }
    }

    /// Takes in what was kept.
    pub fn fill(&self, answers: Vec<store::Answer>) {
        let mut requests = self.lock();
        for answer in answers {
            let payload = Payload {
                bytes: answer.body,
                encoding: match answer.encoding.as_str() {
                    CBOR => CBOR,
                    _ => JSON,
                },
            };
            let name = Arc::new((answer.client, answer.request_id));
            let answer_ = if answer.is_ok {
                Ok(payload)
            } else {
                Err(payload)
            };
            requests.done(name, answer.digest, answer_);
        }
    }

    /// Enters a request that was taken in before the daemon restarted, and is carried out again.
    /// Whoever asks for it meanwhile waits for its answer. Nothing if it is known.
    pub fn enter_again(&self, name: Name, digest: Digest) -> Option<Page> {
        let mut requests = self.lock();
        if requests.by_name.contains_key(&name) {
            return None;
        }
        let name = Arc::new(name);
        requests.begin(&name, digest);
        Some(Page {
            ledger: self.clone(),
            name,
            is_written: false,
        })
    }

    /// Keeps `promise` with what a request came to, if it is known.
    pub fn tell(&self, key: &str, request: &Request, id: &str, promise: &Promise) {
        let name = (request.client.clone(), id.to_owned());
        let digest = digest(key, request);
        if let Some(entry) = self.lock().by_name.get(&name)
            && entry.digest == digest
            && let Progress::Done(answer) = &entry.progress
        {
            let answer = answer.clone();
            promise.keep(move || answer);
        }
    }

    /// Whether a request of this name is known.
    pub fn knows(&self, client: &Option<String>, id: &str) -> bool {
        let name = (client.clone(), id.to_owned());
        self.lock().by_name.contains_key(&name)
    }

    /// Has an answer kept. It need not be safe before it is sent: a crash in between leaves the
    /// command in the swarm's journal, and what it came to comes about again.
    fn keep(&self, name: &Name, digest: Digest, answer: &Result<Payload, Payload>) {
        let (client, request_id) = name.clone();
        let (Ok(payload) | Err(payload)) = answer;
        let answer = Write::Answer(store::Answer {
            client,
            request_id,
            digest,
            swarm: String::new(),
            number: 0,
            is_ok: answer.is_ok(),
            encoding: payload.encoding.to_owned(),
            body: payload.bytes.clone(),
        });
        self.store.submit(vec![answer], None);
    }

    /// Enters a request under its name. `promise` is kept from here if it is a known one.
    pub fn enter(&self, key: &str, request: &Request, id: &str, promise: &Promise) -> Entered {
        let name = (request.client.clone(), id.to_owned());
        let digest = digest(key, request);
        let mut requests = self.lock();
        let Some(entry) = requests.by_name.get_mut(&name) else {
            let name = Arc::new(name);
            requests.begin(&name, digest);
            return Entered::New(Page {
                ledger: self.clone(),
                name,
                is_written: false,
            });
        };
        if entry.digest != digest {
            return Entered::Other;
        }
        match &mut entry.progress {
            Progress::Underway(promises) => promises.push(promise.clone()),
            Progress::Done(answer) => {
                let answer = answer.clone();
                promise.keep(move || answer);
            }
        }
        Entered::Known
    }

    fn lock(&self) -> MutexGuard<'_, Requests> {
        // Nothing between two changes can panic.
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Page {
    /// Writes the answer down, so that it can be given again.
    pub fn write(mut self, answer: &Result<Payload, Payload>) {
        self.is_written = true;
        let mut requests = self.ledger.lock();
        let Some(entry) = requests.by_name.get_mut(&self.name) else {
            return;
        };
        let digest = entry.digest;
        let before = std::mem::replace(&mut entry.progress, Progress::Done(answer.clone()));
        requests.done.push_back(self.name.clone());
        requests.bytes += bytes(answer);
        requests.forget_oldest();
        drop(requests);
        self.ledger.keep(&self.name, digest, answer);
        if let Progress::Underway(promises) = before {
            for promise in promises {
                let answer = answer.clone();
                promise.keep(move || answer);
            }
        }
    }

    /// Forgets the request, which changed nothing. Whoever asked again hears why.
    pub fn tear_out(mut self, refusal: &Payload) {
        for promise in self.remove() {
            let refusal = refusal.clone();
            promise.keep(move || Err(refusal));
        }
    }

    fn remove(&mut self) -> Vec<Promise> {
        self.is_written = true;
        let entry = self.ledger.lock().by_name.remove(&self.name);
        match entry.map(|it| it.progress) {
            Some(Progress::Underway(promises)) => promises,
            Some(Progress::Done(_)) | None => Vec::new(),
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        if !self.is_written {
            self.remove();
        }
    }
}

impl Requests {
    fn begin(&mut self, name: &Arc<Name>, digest: Digest) {
        let progress = Progress::Underway(Vec::new());
        let entry = Box::new(Entry { digest, progress });
        self.by_name.insert(name.clone(), entry);
    }

    fn done(&mut self, name: Arc<Name>, digest: Digest, answer: Result<Payload, Payload>) {
        self.bytes += bytes(&answer);
        let progress = Progress::Done(answer);
        let entry = Box::new(Entry { digest, progress });
        let before = self.by_name.insert(name.clone(), entry);
        match before.map(|it| it.progress) {
            Some(Progress::Done(before)) => self.bytes -= bytes(&before),
            Some(Progress::Underway(_)) | None => self.done.push_back(name),
        }
        self.forget_oldest();
    }

    fn forget_oldest(&mut self) {
        let (most, most_bytes) = MOST;
        while self.done.len() > most || (self.bytes > most_bytes && self.done.len() > 1) {
            let Some(name) = self.done.pop_front() else {
                return;
            };
            if let Some(Progress::Done(answer)) = self.by_name.remove(&name).map(|it| it.progress) {
                self.bytes -= bytes(&answer);
            }
        }
    }
}

fn bytes(answer: &Result<Payload, Payload>) -> usize {
    let (Ok(payload) | Err(payload)) = answer;
    ANSWER_BYTES + payload.bytes.len()
}

/// What makes two requests the same one: not how long their senders wait.
pub fn digest(key: &str, request: &Request) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(key.as_bytes());
    for number in [request.at_step, request.expect_epoch, request.expect_step] {
        hasher.update(&[u8::from(number.is_some())]);
        hasher.update(&number.unwrap_or_default().to_le_bytes());
    }
    // By value: however it is spelled, and in whichever order its fields come.
    let args = request.args.as_ref().map_or("{}", |args| args.get());
    match serde_json::from_str(args) {
        Ok(args) => add(&mut hasher, &args),
        Err(_) => drop(hasher.update(args.as_bytes())),
    }
    *hasher.finalize().as_bytes()
}

/// Adds a value to a digest, with what tells it from any other.
fn add(hasher: &mut blake3::Hasher, value: &Value) {
    match value {
        Value::Null => drop(hasher.update(b"n")),
        Value::Bool(is_true) => drop(hasher.update(if *is_true { b"t" } else { b"f" })),
        Value::Number(number) => {
            // 1 and 1.0 are one number; what a double cannot hold differs in its text.
            let double = number.as_f64().unwrap_or(f64::NAN);
            let text = match number.as_f64() {
                Some(double) if double.fract() == 0.0 && double.abs() < EXACT => String::new(),
                _ => number.to_string(),
            };
            hasher.update(b"d").update(&double.to_le_bytes());
            add_text(hasher, &text);
        }
        Value::String(text) => {
            hasher.update(b"s");
            add_text(hasher, text);
        }
        Value::Array(values) => {
            hasher.update(b"l").update(&values.len().to_le_bytes());
            values.iter().for_each(|value| add(hasher, value));
        }
        Value::Object(fields) => {
            hasher.update(b"o").update(&fields.len().to_le_bytes());
            let fields: BTreeMap<_, _> = fields.iter().collect();
            for (name, value) in fields {
                add_text(hasher, name);
                add(hasher, value);
            }
        }
    }
}

fn add_text(hasher: &mut blake3::Hasher, text: &str) {
    hasher
        .update(&text.len().to_le_bytes())
        .update(text.as_bytes());
}
