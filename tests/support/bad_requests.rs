//! Bad requests: the tables in `tests/daemon/abuse/`, one request a line.

use jostle_proto::{ErrorCode, keys};
use serde_json::json;

use super::{Client, NODE, PREFIX};

const TO_A_SWARM: &str = include_str!("../daemon/abuse/to_a_swarm.txt");

const TO_THE_NODE: &str = include_str!("../daemon/abuse/to_the_node.txt");

const SELECTORS: &str = include_str!("../daemon/abuse/selectors.txt");

/// A bad request and how it is rejected.
pub struct BadRequest {
    pub selector: String,
    pub payload: Option<Vec<u8>>,
    pub code: ErrorCode,
    /// What `details.field` says; none if the error is about no field.
    pub field: Option<String>,
}

impl BadRequest {
    /// What is sent, as far as it fits a line.
    pub fn summary(&self) -> String {
        let payload = self.payload.as_deref().unwrap_or_default();
        let text: String = String::from_utf8_lossy(payload).chars().take(200).collect();
        format!("{} {text}", self.selector)
    }
}

/// The lines of a table that are not empty or remarks, each cut into `columns` words and the rest.
fn lines(table: &str, columns: usize) -> impl Iterator<Item = (Vec<&str>, &str)> {
    let lines = table.lines();
    let rows = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(move |line| {
        let mut rest = line;
        let words = (0..columns).map(|_| {
            let (word, others) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            rest = others.trim_start();
            word
        });
        (words.collect(), rest)
    })
}

fn code(name: &str) -> ErrorCode {
    serde_json::from_value(json!(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn field(name: &str) -> Option<String> {
    (name != "-").then(|| name.to_owned())
}

fn to_keys(table: &'static str, key_of: fn(&str) -> String) -> impl Iterator<Item = BadRequest> {
    lines(table, 3).map(move |(words, payload)| BadRequest {
        selector: key_of(words[0]),
        payload: Some(payload.as_bytes().to_vec()),
        code: code(words[1]),
        field: field(words[2]),
    })
}

/// Every bad request there is a line for.
pub fn read_all() -> Vec<BadRequest> {
    let to_a_swarm = to_keys(TO_A_SWARM, |verb| keys::cmd(PREFIX, "victim", verb));
    let to_the_node = to_keys(TO_THE_NODE, |verb| keys::node_cmd(PREFIX, NODE, verb));
    let selectors = lines(SELECTORS, 3).map(|(words, _)| BadRequest {
        selector: words[0].to_owned(),
        payload: None,
        code: code(words[1]),
        field: field(words[2]),
    });
    to_a_swarm.chain(to_the_node).chain(selectors).collect()
}

/// Two swarms as the tables have them: at step 20, with one change behind them.
pub async fn prepare_swarms(client: &Client, names: &[&str; 2]) {
    for (name, id) in names.iter().zip(["taken", "other"]) {
        client.create(name, json!({"n": 10, "seed": 4})).await;
        client.ok(name, "step", json!({"steps": 20})).await;
        let request = json!({"client": "me", "request_id": id, "args": {"pi3": 1}});
        client.ok(name, "set", request).await;
    }
}
