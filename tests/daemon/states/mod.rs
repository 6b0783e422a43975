//! Which values start over and which continue after a change of state: a table for each kind of thing,
//! whose cells are what the documentation promises.

mod experiments;
mod page;
mod playback;
mod recordings;
pub mod swarms;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use serde_json::Value;

use crate::support::process::jostled;
use crate::support::programs::ROOT;
use crate::support::{Client, NODE, TIMEOUT};

/// The observations of one thing at one time, by the names of the table's rows.
pub type Observation = BTreeMap<&'static str, Value>;

/// A literal table. The cells of a row are:
///
/// - `still V`: before and after the change it is V, as JSON
/// - a JSON value: it is that after the change, and was another one before
/// - `unchanged`: as before the change, which differs from when the thing was made
/// - `as made`: as when the thing was made, which differs from before the change
/// - `+N`: greater by N than before the change
/// - `goes on`: a number that has not decreased, or a list or map that has what it had before
/// - `anew`: a map with nothing that it had before under the same names
/// - `agrees`: a map that has under the names that it had before what it had, or nothing
/// - `starts over`: a number that is 0 or 1, and was greater
/// - `absent`: `null`, and was something
/// - `refused CODE`: what was answered before is rejected with this code
/// - `n/a N`: not applicable, for the reason in note N
pub struct Table {
    changes: Vec<&'static str>,
    rows: Vec<(&'static str, Vec<&'static str>)>,
    judged: BTreeSet<&'static str>,
    wrong: Vec<String>,
}

/// The text of a file of this repository, kept for the whole test.
fn text_of(path: &str) -> &'static str {
    let path = Path::new(ROOT).join(path);
    fs::read_to_string(path).unwrap().leak()
}

impl Table {
    /// The table of a kind of thing, in the file of its name beside this one.
    pub fn of(kind: &str) -> Self {
        Self::read(text_of(&format!("tests/daemon/states/{kind}.txt")))
    }

    /// Reads a Markdown table and the numbered notes below it. Each cell must say something, and a
    /// note must give a reason.
    pub fn read(text: &'static str) -> Self {
        let mut lines = text.lines().filter(|line| line.starts_with('|'));
        let cells = |line: &'static str| -> Vec<&'static str> {
            let inner = line.trim().trim_matches('|');
            inner.split('|').map(str::trim).collect()
        };
        let changes = cells(lines.next().unwrap())[1..].to_vec();
        lines.next();
        let notes: BTreeMap<&str, &str> = text
            .lines()
            .filter(|line| !line.starts_with('|'))
            .filter_map(|line| line.split_once(": "))
            .collect();
        let mut rows = Vec::new();
        let mut used = BTreeSet::new();
        for line in lines {
            let cells = cells(line);
            let [name, cells @ ..] = &cells[..] else {
                panic!("{line}");
            };
            assert_eq!(
                cells.len(),
                changes.len(),
                "{name} has a cell for each change"
            );
            for cell in cells {
                assert!(!cell.is_empty(), "{name}: an empty cell");
                if let Some(note) = cell.strip_prefix("n/a ") {
                    let reason = notes.get(note).copied().unwrap_or_default();
                    assert!(
                        reason.split(' ').count() > 3,
                        "{name}: {cell} has no reason"
                    );
                    used.insert(note);
                }
            }
            rows.push((*name, cells.to_vec()));
        }
        let noted: BTreeSet<&str> = notes.into_keys().collect();
        assert_eq!(used, noted, "each note is used");
        Table {
            changes,
            rows,
            judged: BTreeSet::new(),
            wrong: Vec::new(),
        }
    }

    /// The cells of a change by the names of the rows.
    pub fn column(&self, change: &str) -> BTreeMap<&'static str, &'static str> {
        let position = self.changes.iter().position(|it| *it == change);
        let column = position.unwrap_or_else(|| panic!("no column {change}"));
        let cell = |(name, cells): &(&'static str, Vec<&'static str>)| (*name, cells[column]);
        self.rows.iter().map(cell).collect()
    }

    /// Compares what was observed around a change with its column.
    pub fn judge(
        &mut self,
        change: &'static str,
        made: &Observation,
        before: &Observation,
        after: &Observation,
    ) {
        assert!(self.judged.insert(change), "{change} is judged once");
        let rows: BTreeSet<&str> = self.rows.iter().map(|(name, _)| *name).collect();
        for look in [made, before, after] {
            let observed: BTreeSet<&str> = look.keys().copied().collect();
            let without = observed.difference(&rows).collect::<Vec<_>>();
            assert!(without.is_empty(), "{change}: no row for {without:?}");
        }
        for (name, cell) in self.column(change) {
            if cell.starts_with("n/a ") {
                continue;
            }
            let [Some(before), Some(after)] = [before, after].map(|look| look.get(name)) else {
                self.wrong
                    .push(format!("{change}: {name} was not observed"));
                continue;
            };
            let made = made.get(name).unwrap_or(&Value::Null);
            if let Err(problem) = holds(cell, made, before, after) {
                self.wrong.push(format!(
                    "{change}: {name} should be `{cell}` and {problem}: made {made}, before {before}, \
                     after {after}"
                ));
            }
        }
    }

    /// Fails unless every change was judged and every cell holds.
    pub fn finish(self) {
        let changes: BTreeSet<&str> = self.changes.iter().copied().collect();
        assert_eq!(self.judged, changes, "every change is judged");
        assert!(self.wrong.is_empty(), "\n{}", self.wrong.join("\n"));
    }
}

/// Compares numbers by value: 0 and 0.0 are the same.
fn same(a: &Value, b: &Value) -> bool {
    match (a.as_f64(), b.as_f64()) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

/// Checks one cell. A cell that would hold for every behaviour of the daemon is a problem too.
fn holds(cell: &str, made: &Value, before: &Value, after: &Value) -> Result<(), &'static str> {
    let literal = |text: &str| -> Value {
        serde_json::from_str(text).unwrap_or_else(|_| panic!("no such cell: `{cell}`"))
    };
    let is = |holds: bool| if holds { Ok(()) } else { Err("is not") };
    let shows = |shows: bool| if shows { Ok(()) } else { Err("shows nothing") };
    match cell {
        "unchanged" => shows(!same(before, made)).and(is(same(before, after))),
        "as made" => shows(!same(before, made)).and(is(same(after, made))),
        "absent" => shows(!before.is_null()).and(is(after.is_null())),
        "anew" | "agrees" => {
            let [before, after] = [before, after].map(|it| it.as_object().unwrap());
            shows(!before.is_empty() && !after.is_empty())?;
            is(after.iter().all(|(name, it)| match before.get(name) {
                Some(before) => (cell == "agrees") == (before == it),
                None => true,
            }))
        }
        "starts over" => {
            shows(before.as_f64() > Some(1.0))?;
            is(after.as_f64().is_some_and(|it| it <= 1.0))
        }
        "goes on" => {
            shows(!same(before, made))?;
            match (before, after) {
                (Value::Array(before), Value::Array(after)) => is(after.starts_with(before)),
                (Value::Object(before), Value::Object(after)) => {
                    is(before.iter().all(|(name, it)| after.get(name) == Some(it)))
                }
                _ => is(after.is_number() && after.as_f64() >= before.as_f64()),
            }
        }
        cell => {
            if let Some(code) = cell.strip_prefix("refused ") {
                let rejected = Value::String(format!("refused {code}"));
                shows(before != &rejected).and(is(after == &rejected))
            } else if let Some(more) = cell.strip_prefix('+') {
                let more: f64 = more.parse().unwrap();
                is(after.as_f64() == before.as_f64().map(|it| it + more))
            } else if let Some(value) = cell.strip_prefix("still ") {
                let value = literal(value);
                is(same(before, &value) && same(after, &value))
            } else {
                let value = literal(cell);
                shows(!same(before, &value)).and(is(same(after, &value)))
            }
        }
    }
}

/// A daemon in a process of its own that serves HTTP; it is killed when dropped.
pub struct Served {
    child: Child,
    pub http: String,
    pub client: Client,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Served {
    /// Starts a daemon on `folder` that fails at these points, and a client of it.
    pub async fn on(folder: &Path, points: &str) -> Self {
        let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", NODE]);
        command.args(["--http", "127.0.0.1:0", "--data-dir"]);
        command.arg(folder).env("FAILPOINTS", points);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut line = |start: &str| {
            let line = lines.next().unwrap().unwrap();
            line.strip_prefix(start).expect(&line).to_owned()
        };
        let endpoint = line("listening on ");
        let http = line("http on http://");
        Served {
            child,
            http,
            client: Client::open(&endpoint).await,
        }
    }

    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Stops it with SIGTERM.
    pub fn stop(&mut self) {
        let pid = self.child.id().to_string();
        let signalled = Command::new("kill").args(["-TERM", &pid]).status();
        assert!(signalled.unwrap().success());
        let began = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(began.elapsed() < TIMEOUT, "it does not end");
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
    }

    pub fn end(&mut self, how: End) {
        match how {
            End::Stop => self.stop(),
            End::Kill => self.kill(),
        }
    }
}

/// How a daemon ends.
#[derive(Clone, Copy, PartialEq)]
pub enum End {
    Stop,
    Kill,
}

#[test]
fn a_cell_that_is_wrong_or_shows_nothing_is_reported() {
    use serde_json::json;

    let [null, zero, one, two] = [json!(null), json!(0), json!(1), json!(2)];
    for (cell, made, before, after) in [
        ("unchanged", &zero, &one, &one),
        ("as made", &zero, &one, &zero),
        ("absent", &null, &one, &null),
        ("starts over", &zero, &two, &one),
        ("goes on", &zero, &one, &two),
        ("goes on", &json!([]), &json!([1]), &json!([1, 2])),
        (
            "goes on",
            &json!({}),
            &json!({"a": 1}),
            &json!({"b": 2, "a": 1}),
        ),
        ("anew", &json!({}), &json!({"1": 1}), &json!({"2": 1})),
        ("anew", &json!({}), &json!({"1": 1}), &json!({"1": 2})),
        (
            "agrees",
            &json!({}),
            &json!({"1": 1}),
            &json!({"2": 1, "1": 1}),
        ),
        ("+1", &null, &one, &two),
        ("still 1", &null, &one, &one),
        ("2", &null, &one, &json!(2.0)),
        ("refused busy", &null, &one, &json!("refused busy")),
    ] {
        assert_eq!(holds(cell, made, before, after), Ok(()), "{cell}");
    }
    for (cell, made, before, after) in [
        ("unchanged", &zero, &one, &two),
        ("unchanged", &one, &one, &one),
        ("as made", &zero, &one, &one),
        ("as made", &zero, &zero, &zero),
        ("absent", &null, &null, &null),
        ("absent", &null, &one, &one),
        ("starts over", &zero, &two, &two),
        ("starts over", &zero, &one, &one),
        ("goes on", &zero, &two, &one),
        ("goes on", &zero, &one, &null),
        ("goes on", &json!([]), &json!([1, 2]), &json!([1])),
        ("goes on", &json!({}), &json!({"a": 1}), &json!({"a": 2})),
        (
            "anew",
            &json!({}),
            &json!({"1": 1}),
            &json!({"1": 1, "2": 1}),
        ),
        ("agrees", &json!({}), &json!({"1": 1}), &json!({"1": 2})),
        ("anew", &json!({}), &json!({"1": 1}), &json!({})),
        ("+1", &null, &one, &one),
        ("still 1", &null, &two, &one),
        ("still 1", &null, &one, &two),
        ("2", &null, &one, &one),
        ("2", &null, &two, &two),
        ("refused busy", &null, &one, &json!("refused conflict")),
    ] {
        assert!(holds(cell, made, before, after).is_err(), "{cell}");
    }
}

#[test]
#[should_panic(expected = "a cell for each")]
fn a_table_must_have_a_cell_for_each_change() {
    Table::read("| a | b | c |\n|---|---|---|\n| x | 1 |\n");
}

#[test]
#[should_panic(expected = "has no reason")]
fn what_is_not_applicable_has_a_reason() {
    Table::read("| a | b |\n|---|---|\n| x | n/a 1 |\n");
}
