//! The permissions of each role, as a literal. The tests compare the daemon with it and with no
//! function of the program.

use std::collections::BTreeSet;
use std::fs;

use jostle_proto::contract::{CHANNELS, ChannelKind};
use jostle_proto::{Role, keys};

/// The roles of the columns, each with a person who has it.
pub const COLUMNS: [(&str, &str); 3] = [
    ("viewer", "vera"),
    ("controller", "cleo"),
    ("operator", "olga"),
];

const NOBODY_BUT_OPERATORS: [&str; 3] = ["no", "no", "yes"];
const THEIR_CONTROLLERS: [&str; 3] = ["no", "own", "yes"];
const CONTROLLERS_TOO: [&str; 3] = ["no", "yes", "yes"];
const EVERYBODY: [&str; 3] = ["yes", "yes", "yes"];

/// Every request, and whether a viewer, a controller and an operator may send it; `own`
/// is for controllers named after the person alone.
pub const TABLE: [(&str, [&str; 3]); 54] = [
    ("{swarm}/cmd/delete", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/run", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/pause", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/step", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/reset", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/set", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/inform", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/uninform", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/inject", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/remove", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/batch", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/fork", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/join", THEIR_CONTROLLERS),
    ("{swarm}/cmd/advance", THEIR_CONTROLLERS),
    ("{swarm}/cmd/leave", THEIR_CONTROLLERS),
    ("{swarm}/cmd/annotate", CONTROLLERS_TOO),
    ("{swarm}/cmd/seek", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/when", NOBODY_BUT_OPERATORS),
    ("{swarm}/cmd/protect", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/create", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/restore", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/discard", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/experiment", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/replay", NOBODY_BUT_OPERATORS),
    ("@node/{node}/cmd/record", NOBODY_BUT_OPERATORS),
    ("{swarm}/ctl/{controller}", THEIR_CONTROLLERS),
    ("{swarm}/ctl/{controller}/alive", THEIR_CONTROLLERS),
    ("{swarm}/wait/{id}/alive", EVERYBODY),
    ("{swarm}/state", EVERYBODY),
    ("{swarm}/get/status", EVERYBODY),
    ("{swarm}/get/controllers", EVERYBODY),
    ("{swarm}/get/spec", EVERYBODY),
    ("{swarm}/get/parameters", EVERYBODY),
    ("{swarm}/get/measures", EVERYBODY),
    ("{swarm}/get/events", EVERYBODY),
    ("{swarm}/get/journal", EVERYBODY),
    ("{swarm}/get/snapshot", EVERYBODY),
    ("{swarm}/get/verify", EVERYBODY),
    ("{swarm}/get/experiment", EVERYBODY),
    ("{swarm}/get/wait", EVERYBODY),
    ("@node/{node}/get/hello", EVERYBODY),
    ("@node/{node}/get/whoami", EVERYBODY),
    ("@node/{node}/get/status", EVERYBODY),
    ("@node/{node}/get/swarms", EVERYBODY),
    ("@node/{node}/get/schema", EVERYBODY),
    ("@node/{node}/get/metrics", EVERYBODY),
    ("@node/{node}/get/experiments", EVERYBODY),
    ("@node/{node}/get/audit", NOBODY_BUT_OPERATORS),
    ("@node/{node}/get/recordings", EVERYBODY),
    ("@node/{node}/get/recording", NOBODY_BUT_OPERATORS),
    ("@node/{node}/experiment/{experiment}/progress", EVERYBODY),
    ("@node/{node}/experiment/{experiment}/results", EVERYBODY),
    ("@node/{node}/experiment/{experiment}/order", EVERYBODY),
    ("@node/{node}/experiment/{experiment}/series", EVERYBODY),
];

/// Whether the person of a column, or a client without a token, may send a request; as themselves
/// where the table says `own`.
pub fn may(cells: [&str; 3], person: Option<&str>) -> bool {
    let column = COLUMNS.iter().position(|(_, it)| Some(*it) == person);
    column.is_some_and(|column| cells[column] != "no")
}

/// The cells of a request.
pub fn cells(key: &str) -> [&'static str; 3] {
    let mut rows = TABLE.iter();
    rows.find(|(it, _)| *it == key).expect(key).1
}

/// The least role that may send a request, with its article.
pub fn least(cells: [&str; 3]) -> &'static str {
    match cells {
        ["no", "no", _] => "an operator",
        ["no", ..] => "a controller",
        _ => "a viewer",
    }
}

/// The table that `docs/security.md` shows.
fn documented_table() -> Vec<(String, Vec<String>)> {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/security.md");
    let page = fs::read_to_string(page).unwrap();
    let mut lines = page.lines();
    let header = "| request | viewer | controller | operator |";
    assert!(lines.any(|line| line == header), "{header}");
    assert_eq!(lines.next(), Some("|---|---|---|---|"));
    let rows = lines.take_while(|line| line.starts_with('|'));
    rows.map(|row| {
        let mut cells = row.trim_matches('|').split('|').map(str::trim);
        let key = cells.next().unwrap().trim_matches('`').to_owned();
        (key, cells.map(str::to_owned).collect())
    })
    .collect()
}

#[test]
fn the_page_shows_this_table() {
    let table = TABLE.map(|(key, cells)| (key.to_owned(), cells.map(str::to_owned).to_vec()));
    assert_eq!(documented_table(), table);
}

#[test]
fn each_role_may_send_the_verbs_that_the_table_says() {
    let commands = TABLE.iter().filter_map(|(key, cells)| {
        let (_, verb) = key.split_once("/cmd/")?;
        Some((verb, cells))
    });
    let mut verbs = 0;
    for (verb, cells) in commands {
        let roles = [Role::Viewer, Role::Controller, Role::Operator];
        let may = cells.map(|cell| cell != "no");
        assert_eq!(roles.map(|role| role.may(verb)), may, "{verb}");
        verbs += 1;
    }
    assert_eq!(verbs, keys::SWARM_VERBS.len() + keys::NODE_VERBS.len());
}

#[test]
fn the_table_has_every_request_of_the_contract() {
    let mut expected: BTreeSet<String> = CHANNELS
        .iter()
        .filter(|channel| match channel.kind {
            ChannelKind::PublishedAndQueried(_)
            | ChannelKind::Get(_)
            | ChannelKind::Command(..)
            | ChannelKind::Put(_)
            | ChannelKind::ClientToken => true,
            ChannelKind::Published(_) | ChannelKind::Token => false,
        })
        .map(|channel| channel.key.to_owned())
        .collect();
    // The lists of names, each a second source.
    for verb in keys::SWARM_VERBS {
        expected.insert(format!("{{swarm}}/cmd/{verb}"));
    }
    for noun in keys::SWARM_GETS {
        expected.insert(format!("{{swarm}}/get/{noun}"));
    }
    for verb in keys::NODE_VERBS {
        expected.insert(format!("@node/{{node}}/cmd/{verb}"));
    }
    for noun in keys::NODE_GETS {
        expected.insert(format!("@node/{{node}}/get/{noun}"));
    }
    for noun in keys::EXPERIMENT_GETS {
        expected.insert(format!("@node/{{node}}/experiment/{{experiment}}/{noun}"));
    }
    let keys: BTreeSet<String> = TABLE.map(|(key, _)| key.to_owned()).into();
    assert_eq!(keys.len(), TABLE.len(), "a key stands twice");
    assert_eq!(keys, expected);
}
