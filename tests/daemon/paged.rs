//! Pages of every kind: whatever their size, one after the other they are the whole.

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::experiments::{rows as rows_of_runs, submit, wait_for_phase};
use crate::support::{Client, Daemon, NODE, PREFIX, http, until};

/// Eleven commands, with the creation of the swarm twelve events.
const COMMANDS: u64 = 11;

/// Six runs of 11 entries of the order, 6 of the measures, and 3 times `n` of the trajectory.
const RUNS: &str = "name = \"runs\"\nseed = 3\nreplicates = 2\nduration = 2\n[[grid]]\nn = [4, 2, \
                    3]\ninformed = [1]\n[measure]\norder_every = 10\nseries_every = \
                    20\nrecord_every = 50\ncolumns = [\"order\", \"milling\"]\n";

/// The largest page of all.
const ALL: usize = 1000;

/// What is read in pages.
struct Paged {
    what: &'static str,
    /// The key and the first parameters.
    selector: String,
    /// The parameter that names the next page.
    place: &'static str,
    /// The entries of a page.
    entries: fn(&Value) -> Vec<Value>,
    /// Where the next page begins; null after the last.
    next: fn(&Value, &[Value]) -> Value,
    /// A number of each entry as expected, in order.
    expected: Vec<u64>,
    number: fn(&Value) -> u64,
}

impl Paged {
    /// All entries, in pages of so many.
    async fn read(&self, client: &Client, size: usize) -> Vec<Value> {
        let (mut all, mut next) = (Vec::new(), Value::Null);
        loop {
            let mark = match &next {
                Value::Null => String::new(),
                next => format!(";{}={next}", self.place),
            };
            let selector = format!("{}limit={size}{mark}", self.selector);
            let page = client.query(&selector, None).await.unwrap();
            let entries = (self.entries)(&page);
            assert!(entries.len() <= size, "{selector}: {page}");
            next = (self.next)(&page, &entries);
            let is_full = entries.len() == size;
            assert!(is_full || next.is_null(), "{selector}: {page}");
            all.extend(entries);
            if next.is_null() {
                return all;
            }
            assert!(all.len() < ALL, "{selector} does not end");
        }
    }
}

/// The columns of a page in CBOR as entries.
fn columns<const N: usize>(page: &Value, names: [&str; N]) -> Vec<Value> {
    let column = |name: &str| {
        page[name]
            .as_array()
            .unwrap_or_else(|| panic!("{page}"))
            .clone()
    };
    rows(&names.map(column))
}

fn rows(columns: &[Vec<Value>]) -> Vec<Value> {
    let entry = |k: usize| columns.iter().map(|column| column[k].clone()).collect();
    assert!(columns.iter().all(|it| it.len() == columns[0].len()));
    (0..columns[0].len()).map(entry).collect()
}

fn series(page: &Value) -> Vec<Value> {
    let mut all = vec![page["step"].as_array().unwrap().clone()];
    all.push(page["time"].as_array().unwrap().clone());
    for measure in page["measures"].as_array().unwrap() {
        all.push(measure["value"].as_array().unwrap().clone());
    }
    assert!(all.len() >= 4, "{page}");
    rows(&all)
}

fn list(page: &Value, place: &str) -> Vec<Value> {
    page.pointer(place).unwrap().as_array().unwrap().clone()
}

/// The `field` of the last entry, if it is not the newest.
fn after_the_last(page: &Value, entries: &[Value], field: &str) -> Value {
    let last = entries.last().map(|it| it[field].clone());
    last.filter(|last| *last != page["result"]["newest"])
        .unwrap_or_default()
}

/// The nearest whole number.
fn whole(number: f64) -> u64 {
    format!("{number:.0}").parse().unwrap()
}

/// What the daemon has in pages; the entries of one run are those of this one.
fn all(run_of_three: &str) -> Vec<Paged> {
    let swarm =
        |noun: &str, parameters: &str| format!("{}?{parameters}", keys::get(PREFIX, "a", noun));
    let run = |noun: &str, parameters: &str| {
        let key = keys::experiment(PREFIX, NODE, "runs", noun);
        format!("{key}?{parameters}")
    };
    let audit = |page: &Value| list(page, "/result/lines");
    let step = |entry: &Value| whole(entry[0].as_f64().unwrap());
    let number = |entry: &Value| entry["number"].as_u64().unwrap();
    let seq = |entry: &Value| entry["seq"].as_u64().unwrap();
    let journal = |page: &Value| list(page, "/result/entries");
    vec![
        Paged {
            what: "events",
            selector: swarm("events", ""),
            place: "after",
            entries: |page| list(page, "/result/events"),
            next: |page, entries| after_the_last(page, entries, "number"),
            expected: (1..=COMMANDS + 1).collect(),
            number,
        },
        Paged {
            what: "the journal by line",
            selector: swarm("journal", ""),
            place: "line",
            entries: journal,
            next: |page, _| page["result"]["next"].clone(),
            expected: (1..=COMMANDS).collect(),
            number: seq,
        },
        Paged {
            what: "some of the journal",
            selector: swarm("journal", "verb=step;"),
            place: "line",
            entries: journal,
            next: |page, _| page["result"]["next"].clone(),
            expected: vec![4, 8],
            number: seq,
        },
        Paged {
            what: "the audit log",
            selector: format!("{}?verb=create;", keys::node_get(PREFIX, NODE, "audit")),
            place: "after",
            entries: audit,
            next: |page, entries| match entries.last() {
                // `newest` is of all verbs.
                Some(it) if it["name"] != "last" => it["number"].clone(),
                _ => {
                    assert!(!entries.is_empty(), "{page}");
                    Value::Null
                }
            },
            expected: (1..=6).collect(),
            number: |line| {
                let names = ["a", "b", "c", "d", "e", "last"].iter();
                let place = names.zip(1..).find(|(it, _)| line["name"] == **it);
                place.map_or(0, |(_, place)| place)
            },
        },
        Paged {
            what: "results",
            selector: run("results", ""),
            place: "after",
            entries: |page| list(page, "/rows"),
            next: |page, _| page["next"].clone(),
            expected: vec![4, 4, 2, 2, 3, 3],
            number: |row| row["n"].as_u64().unwrap(),
        },
        Paged {
            what: "the order of a run",
            selector: run("order", &format!("run={run_of_three};")),
            place: "after",
            entries: |page| columns(page, ["time", "order", "drift"]),
            next: |page, _| page["next"].clone(),
            // Steps of 0.02.
            expected: (0..=100).step_by(10).collect(),
            number: |entry| whole(entry[0].as_f64().unwrap() * 50.0),
        },
        Paged {
            what: "the measures of a run",
            selector: run("series", &format!("run={run_of_three};")),
            place: "after",
            entries: series,
            next: |page, _| page["next"].clone(),
            expected: (0..=100).step_by(20).collect(),
            number: step,
        },
        Paged {
            what: "the trajectory of a run",
            selector: run("series", &format!("run={run_of_three};of=individuals;")),
            place: "after",
            entries: series,
            next: |page, _| page["next"].clone(),
            expected: vec![0, 0, 0, 50, 50, 50, 100, 100, 100],
            number: step,
        },
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_any_size_make_the_whole() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("a", json!({"n": 3})).await;
    for number in 1..=COMMANDS {
        match number % 4 {
            0 => client.ok("a", "step", json!({"steps": number})).await,
            _ => {
                client
                    .ok("a", "set", json!({"pi3": 1.0 + number as f64}))
                    .await
            }
        };
    }
    for name in ["b", "c", "d", "e", "last"] {
        client.create(name, json!({"n": 1})).await;
    }
    submit(client, RUNS).await;
    wait_for_phase(client, "runs", "finished").await;
    let audit = format!("{}?name=last", keys::node_get(PREFIX, NODE, "audit"));
    until("the last line is written", async || {
        let page = client.query(&audit, None).await.unwrap();
        !list(&page, "/result/lines").is_empty()
    })
    .await;
    let rows = rows_of_runs(client, "runs", 1000).await;
    let run = rows.last().unwrap()["run"].as_str().unwrap();
    for paged in all(run) {
        let Paged { what, expected, .. } = &paged;
        let all = paged.read(client, ALL).await;
        let numbers: Vec<u64> = all.iter().map(paged.number).collect();
        assert_eq!(numbers, *expected, "{what}: {all:?}");
        let count = all.len();
        for size in (1..=count + 1).chain([2 * count, ALL]) {
            assert_eq!(paged.read(client, size).await, all, "{what} by {size}");
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_backwards_make_the_whole_audit_log() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let names = ["a", "b", "c", "d", "e", "f"];
    for name in names {
        client.create(name, json!({"n": 1})).await;
    }
    let key = keys::node_get(PREFIX, NODE, "audit");
    let page = async |limit: usize, before: u64| {
        let selector = format!("{key}?limit={limit};before={before}");
        let page = client.query(&selector, None).await.unwrap();
        list(&page, "/result/lines")
    };
    until("the lines are written", async || {
        page(ALL, u64::MAX).await.len() == names.len()
    })
    .await;
    for size in 1..=names.len() + 1 {
        let (mut all, mut before) = (Vec::new(), u64::MAX);
        loop {
            let mut lines = page(size, before).await;
            let Some(first) = lines.first() else { break };
            before = first["number"].as_u64().unwrap();
            lines.append(&mut all);
            all = lines;
        }
        let read: Vec<&Value> = all.iter().map(|line| &line["name"]).collect();
        assert_eq!(read, names, "by {size}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_separator_of_parameters_is_answered_with_those_of_zenoh_and_http() {
    let daemon = Daemon::start().await;
    let (client, address) = (&daemon.client, http::of_daemon(&daemon));
    client.create("a", json!({"n": 5})).await;
    for (noun, name) in [
        ("journal?limit=2%26after=1", "limit"),
        ("journal?line=2%26after=1", "line"),
        ("experiment?replicates=2%26setpoints=a", "replicates"),
    ] {
        let (status, _, body) = http::get(&address, &format!("/api/get/a/get/{noun}"));
        let over_http: Value = serde_json::from_str(&body).unwrap();
        assert_eq!(status, 400, "{body}");
        let key = keys::get(PREFIX, "a", &noun.replace("%26", "&"));
        let over_zenoh = client.query(&key, None).await.unwrap_err().message;
        for message in [over_http["message"].as_str().unwrap(), &over_zenoh] {
            assert!(message.starts_with(&format!("{name} is not ")), "{message}");
            let remedy = "; separate parameters with `;`, over HTTP with `&`";
            assert!(message.ends_with(remedy), "{message}");
        }
    }
    daemon.stop().await;
}
