//! The messages that the daemons of the scenario sent, by the name of the fixture.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Mutex;

use jostle_proto::contract::{is_received, messages};
use jostle_proto::verbs::{AdvanceResult, StepResult};
use jostle_proto::{Attachment, OrderPage, Reply, SeriesPage, Snapshot, State, to_cbor};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use zenoh::bytes::Encoding;

use crate::contract::proto;

/// Writes the fixtures instead of comparing them.
const RECORD: &str = "JOSTLE_RECORD";

/// The command that a failure prints.
const COMMAND: &str = "JOSTLE_RECORD=1 cargo test --release --test daemon recorded";

/// Values that differ from run to run, and their replacements in the fixture: the message, a JSON
/// pointer in which `*` is every item, and the value. `null` is never replaced.
const FIXED: &[(&str, &str, &str)] = &[
    ("event", "/unix_secs", "1795531201.25"),
    (
        "events.reply",
        "/result/events/*/unix_secs",
        "1795531201.25",
    ),
    (
        "journal.reply",
        "/result/entries/*/unix_secs",
        "1795531201.25",
    ),
    // States are numbered as they are published, which depends on time.
    ("state", "/frame", "4"),
    ("order", "/frame", "50"),
    ("attachment", "/stepped_unix_nanos", "1795531201250000000"),
    ("attachment", "/published_unix_nanos", "1795531201250150000"),
    ("step.reply", "/result/state/frame", "3"),
    ("advance.reply", "/result/state/frame", "3"),
    // How much of the journal is on the disk by then depends on the disk.
    ("step.reply", "/result/durable_step", "50"),
    ("advance.reply", "/result/durable_step", "1"),
    ("status.reply", "/result/waiting_for/*/secs", "1.25"),
    ("status.reply", "/result/verifying", "0.25"),
    (
        "controllers.reply",
        "/result/controllers/*/waited_secs",
        "1.25",
    ),
    (
        "error",
        "/details/instances",
        r#"["01919f5dc9f2-5f0e2b1c", "01919f5dd3a1-a41c09d7"]"#,
    ),
    ("experiment.progress", "/elapsed_secs", "3.5"),
    (
        "node.experiments.reply",
        "/result/experiments/*/elapsed_secs",
        "3.5",
    ),
    (
        "node.experiments.reply",
        "/result/experiments/*/left_secs",
        "10.5",
    ),
    (
        "node.experiments.reply",
        "/result/experiments/*/running/*/share",
        "0.25",
    ),
    (
        "node.experiments.reply",
        "/result/experiments/1/share",
        "0.25",
    ),
    (
        "node.experiments.reply",
        "/result/experiments/5/share",
        "0.25",
    ),
    ("node.hello.reply", "/result/version", "\"0.1.0\""),
    ("node.hello.reply", "/result/unix_secs", "1795275152.815602"),
    (
        "node.hello.reply",
        "/result/data_id",
        "\"5d0c7b1e93f24a6890b2c4e1f7a3d586\"",
    ),
    (
        "node.hello.reply",
        "/result/limits/max_memory_bytes",
        "2147483648",
    ),
    (
        "node.hello.reply",
        "/result/http",
        "\"http://127.0.0.1:8080\"",
    ),
    (
        "node.audit.reply",
        "/result/lines/*/unix_secs",
        "1795531201.25",
    ),
    (
        "node.audit.reply",
        "/result/lines/*/last_unix_secs",
        "1795531201.75",
    ),
    ("node.status.reply", "/result/uptime_secs", "0.728186592"),
    ("node.metrics.reply", "/result/uptime_secs", "3600.5"),
    ("node.metrics.reply", "/result/cpu_secs", "812.25"),
    ("node.metrics.reply", "/result/cores", "2"),
    ("node.metrics.reply", "/result/memory_bytes", "31457280"),
    ("node.metrics.reply", "/result/step_secs", "14.5"),
    ("node.metrics.reply", "/result/frames", "90210"),
    ("node.metrics.reply", "/result/frames_dropped", "12"),
    ("node.metrics.reply", "/result/store/commits", "4321"),
    ("node.metrics.reply", "/result/store/commit_secs", "1.75"),
    (
        "node.metrics.reply",
        "/result/store/last_commit_secs",
        "0.0004",
    ),
    ("node.metrics.reply", "/result/store/waiting", "7"),
    ("node.metrics.reply", "/result/store/disk_bytes", "1048576"),
    ("node.metrics.reply", "/result/recordings_bytes", "22151168"),
    (
        "node.metrics.reply",
        "/result/experiments_bytes",
        "734003200",
    ),
    ("node.metrics.reply", "/result/swarms/*/step_secs", "3.25"),
    ("node.metrics.reply", "/result/swarms/*/late_secs", "20.5"),
    ("node.recording.reply", "/result/offset", "524288"),
    ("node.recording.reply", "/result/length", "524296"),
    ("record.reply", "/result/frames", "1"),
    ("record.reply", "/result/bytes", "4096"),
    ("record.reply", "/result/began_unix_secs", "1785000000"),
    (
        "node.recordings.reply",
        "/result/recordings/*/bytes",
        "7340032",
    ),
    (
        "node.recordings.reply",
        "/result/recordings/*/began_unix_secs",
        "1785000000",
    ),
];

/// The schemas that the fixture of `get/schema` shows; a daemon sends all of them.
const SCHEMAS: [&str; 3] = ["pause.args", "reset.args", "run.args"];

/// The fixtures that are in CBOR as well, as it was sent.
const IN_CBOR: [&str; 4] = ["attachment", "snapshot.reply", "state", "step.reply.state"];

/// A payload as a daemon sent it.
pub struct Document {
    pub encoding: Encoding,
    pub bytes: Vec<u8>,
}

/// The text or the bytes of each fixture.
#[derive(Default)]
pub struct Recorded {
    files: Mutex<BTreeMap<String, Vec<u8>>>,
    /// Those of [`FIXED`] that replaced something.
    met: Mutex<BTreeSet<usize>>,
}

impl Recorded {
    /// Adds a document as the fixture of this name, with the daemon's data folder as `/data`.
    pub fn add(&self, name: &str, document: &Document, data: &Path) {
        let message = message(name);
        let data = data.to_str().unwrap();
        let fix = |value: &mut Value| {
            replace(value, data, "/data");
            if let Some(schemas) = value.pointer_mut("/result/schemas") {
                let schemas = schemas.as_object_mut().unwrap();
                schemas.retain(|name, _| SCHEMAS.contains(&&**name));
            }
            self.fix(name, message, value);
        };
        let value = if document.encoding == Encoding::APPLICATION_CBOR {
            let bytes = &document.bytes;
            let (value, bytes) = match message {
                "state" => in_cbor::<State>(bytes, fix),
                "attachment" => in_cbor::<Attachment>(bytes, fix),
                "step.reply" => in_cbor::<Reply<StepResult>>(bytes, fix),
                "advance.reply" => in_cbor::<Reply<AdvanceResult>>(bytes, fix),
                "snapshot.reply" => in_cbor::<Reply<Snapshot>>(bytes, fix),
                "experiment.order" => in_cbor::<OrderPage>(bytes, fix),
                "experiment.series" => in_cbor::<SeriesPage>(bytes, fix),
                _ => panic!("{name} came as CBOR"),
            };
            if IN_CBOR.contains(&name) {
                self.insert(format!("{name}.cbor"), bytes);
            }
            value
        } else {
            assert_eq!(document.encoding, Encoding::APPLICATION_JSON, "{name}");
            let mut value = serde_json::from_slice(&document.bytes).unwrap();
            fix(&mut value);
            value
        };
        // In the order of the type's fields.
        let text = jostle_contract::rewrite(message, &value.to_string());
        let text = text.unwrap_or_else(|error| panic!("{name}: {error}")) + "\n";
        let back: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(back, value, "{name} is what its type says");
        self.insert(format!("{name}.json"), text.into_bytes());
    }

    fn insert(&self, file: String, bytes: Vec<u8>) {
        let mut files = self.files.lock().unwrap();
        if let Some(before) = files.get(&file) {
            assert_eq!(difference(before, &bytes), None, "{file} came twice");
        }
        files.insert(file, bytes);
    }

    /// Replaces what differs from run to run.
    fn fix(&self, name: &str, message: &str, value: &mut Value) {
        for (number, (of, pointer, fixed)) in FIXED.iter().enumerate() {
            if *of != message {
                continue;
            }
            let fixed: Value = serde_json::from_str(fixed).unwrap();
            for place in places(value, pointer) {
                let before = value.pointer_mut(&place).unwrap();
                assert_eq!(kind(before), kind(&fixed), "{name} {place}");
                *before = fixed.clone();
                self.met.lock().unwrap().insert(number);
            }
        }
    }

    /// Compares what was recorded with the fixtures, or writes them.
    pub fn compare(self) {
        let folder = proto().join("fixtures");
        let (files, met) = (
            self.files.into_inner().unwrap(),
            self.met.into_inner().unwrap(),
        );
        let records = std::env::var_os(RECORD).is_some();
        let mut wrong = Vec::new();
        for (file, bytes) in &files {
            let path = folder.join(file);
            if records {
                fs::write(&path, bytes).unwrap();
            }
            match fs::read(&path) {
                Ok(there) => {
                    let difference = difference(&there, bytes);
                    wrong.extend(difference.map(|it| format!("{file}: {it}")));
                }
                Err(error) => wrong.push(format!("{file}: {error}")),
            }
        }
        for entry in fs::read_dir(&folder).unwrap() {
            let file = entry.unwrap().file_name().into_string().unwrap();
            let message = message(file.rsplit_once('.').unwrap().0);
            let is_sent_by_clients = is_received(message);
            if !is_sent_by_clients && !files.contains_key(&file) {
                wrong.push(format!("{file}: no daemon of the scenario sent it"));
            }
        }
        for (number, (message, pointer, _)) in FIXED.iter().enumerate() {
            if !met.contains(&number) {
                wrong.push(format!("{message} {pointer}: replaces nothing"));
            }
        }
        let wrong = wrong.join("\n");
        assert!(wrong.is_empty(), "{wrong}\n`{COMMAND}` writes the fixtures");
        println!("{} fixtures are as recorded", files.len());
    }
}

/// The message that a fixture is of.
fn message(name: &str) -> &'static str {
    let messages = messages().into_iter().filter(|message| {
        let rest = name.strip_prefix(message);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    });
    let longest = messages.max_by_key(|message| message.len());
    longest.unwrap_or_else(|| panic!("{name} is of no message"))
}

/// The value in CBOR, which its type writes as it came, after a change.
fn in_cbor<T: DeserializeOwned + Serialize>(
    bytes: &[u8],
    change: impl FnOnce(&mut Value),
) -> (Value, Vec<u8>) {
    let message: T = ciborium::from_reader(bytes).unwrap();
    assert!(to_cbor(&message) == bytes, "the type writes what came");
    let mut value = serde_json::to_value(message).unwrap();
    change(&mut value);
    let message: T = serde_json::from_value(value.clone()).unwrap();
    (value, to_cbor(&message))
}

/// Replaces a text within all strings.
fn replace(value: &mut Value, text: &str, by: &str) {
    match value {
        Value::String(string) => *string = string.replace(text, by),
        Value::Array(items) => items.iter_mut().for_each(|it| replace(it, text, by)),
        Value::Object(fields) => fields.values_mut().for_each(|it| replace(it, text, by)),
        _ => {}
    }
}

/// The pointers that a pointer with `*` matches and whose value is not `null`.
fn places(value: &Value, pointer: &str) -> Vec<String> {
    let mut places = vec![String::new()];
    for part in pointer.split('/').skip(1) {
        let mut next = Vec::new();
        for place in &places {
            let here = value.pointer(place).unwrap();
            match (part, here) {
                ("*", Value::Array(items)) => {
                    next.extend((0..items.len()).map(|i| format!("{place}/{i}")));
                }
                _ => next.push(format!("{place}/{part}")),
            }
        }
        next.retain(|place| value.pointer(place).is_some_and(|it| !it.is_null()));
        places = next;
    }
    places
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(it) if it.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    }
}

/// The first difference of a fixture and the recorded document.
fn difference(there: &[u8], recorded: &[u8]) -> Option<String> {
    if there == recorded {
        return None;
    }
    let parsed = |bytes| serde_json::from_slice::<Value>(bytes);
    match (parsed(there), parsed(recorded)) {
        (Ok(there), Ok(recorded)) => {
            let found = first_difference(&there, &recorded, "");
            Some(found.unwrap_or_else(|| "the same values are written otherwise".to_owned()))
        }
        _ => Some(format!("{there:02x?} and {recorded:02x?}")),
    }
}

fn first_difference(there: &Value, recorded: &Value, place: &str) -> Option<String> {
    match (there, recorded) {
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => a
            .iter()
            .find_map(|(name, a)| first_difference(a, &b[name], &format!("{place}/{name}"))),
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => a
            .iter()
            .zip(b)
            .enumerate()
            .find_map(|(i, (a, b))| first_difference(a, b, &format!("{place}/{i}"))),
        _ if there == recorded => None,
        _ => Some(format!("{place} is {there}, and a daemon sent {recorded}")),
    }
}
