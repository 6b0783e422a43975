//! Each verb is in the files that no compiler holds to the list of verbs, or the table below says why not.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use jostle_contract::folder;
use jostle_proto::verbs::{Definition, NodeVerb, SwarmVerb};

const SWARM: &[Definition] = SwarmVerb::DEFINITIONS;
const NODE: &[Definition] = NodeVerb::DEFINITIONS;

/// Files, or folders with all files below them.
struct Place {
    paths: &'static [&'static str],
    verbs: &'static [&'static [Definition]],
    /// Whether a text has the verb.
    has: fn(&str, &str) -> bool,
    /// Verbs that are not there, and why.
    without: &'static [(&'static str, &'static str)],
}

fn is_quoted(text: &str, verb: &str) -> bool {
    text.contains(&format!("\"{verb}\""))
}

/// As a string, or as the text of a button, which begins with a capital letter.
fn is_on_a_button(text: &str, verb: &str) -> bool {
    is_quoted(text, verb) || is_quoted(text, &capitalized(verb))
}

fn capitalized(verb: &str) -> String {
    let (first, rest) = verb.split_at(1);
    format!("{}{rest}", first.to_uppercase())
}

fn begins_a_line(text: &str, verb: &str) -> bool {
    let mut words = text.lines().filter_map(|line| line.split(' ').next());
    words.any(|word| word == verb)
}

fn is_code(text: &str, verb: &str) -> bool {
    text.contains(&format!("`{verb}`")) || text.contains(&format!(".{verb}("))
}

fn is_an_input(text: &str, verb: &str) -> bool {
    text.contains(&format!("Input::{}", capitalized(verb)))
}

const A_CHANGE: &str = "sent as `Input::Change`";
const OF_CONTROLLERS: &str = "`tests/daemon/controllers/` has the tests of controllers";
const A_PROGRAM: &str = "a controller is a program";

const PLACES: [Place; 7] = [
    Place {
        paths: &["tests/daemon/abuse/to_a_swarm.txt"],
        verbs: &[SWARM],
        has: begins_a_line,
        without: &[],
    },
    Place {
        paths: &["tests/daemon/abuse/to_the_node.txt"],
        verbs: &[NODE],
        has: begins_a_line,
        without: &[],
    },
    Place {
        paths: &["tests/measured/crash/clients.rs"],
        verbs: &[SWARM],
        has: is_quoted,
        without: &[
            ("join", OF_CONTROLLERS),
            ("advance", OF_CONTROLLERS),
            ("leave", OF_CONTROLLERS),
            ("seek", "of a playback nothing is stored"),
        ],
    },
    Place {
        paths: &["tests/daemon/targets/sequences.rs"],
        verbs: &[SWARM],
        has: is_an_input,
        without: &[
            ("set", A_CHANGE),
            ("inform", A_CHANGE),
            ("uninform", A_CHANGE),
            ("inject", A_CHANGE),
            ("remove", A_CHANGE),
            ("join", OF_CONTROLLERS),
            ("advance", OF_CONTROLLERS),
            ("leave", OF_CONTROLLERS),
            ("annotate", "a note has no effect that a model predicts"),
            ("fork", "executed by the daemon"),
            ("seek", "executed by a playback"),
        ],
    },
    Place {
        paths: &["tests/daemon/replay.rs"],
        verbs: &[SWARM],
        has: is_quoted,
        without: &[],
    },
    Place {
        // Of the verbs of a daemon it sends `create` only.
        paths: &["clients/web/src/panels"],
        verbs: &[SWARM],
        has: is_on_a_button,
        without: &[
            ("join", A_PROGRAM),
            ("advance", A_PROGRAM),
            ("leave", A_PROGRAM),
        ],
    },
    Place {
        paths: &["proto/README.md", "clients/python/README.md"],
        verbs: &[SWARM, NODE],
        has: is_code,
        without: &[],
    },
];

/// The text of a file, or of all files below a folder.
fn read(path: &Path) -> String {
    if path.is_dir() {
        let entries = fs::read_dir(path).unwrap();
        return entries.map(|it| read(&it.unwrap().path())).collect();
    }
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn each_verb_is_in_the_files_that_list_verbs_by_hand() {
    let mut wrong = Vec::new();
    for place in &PLACES {
        let verbs: BTreeSet<&str> = place
            .verbs
            .iter()
            .copied()
            .flatten()
            .map(|it| it.name)
            .collect();
        for path in place.paths {
            let text = read(&folder().join("..").join(path));
            for verb in &verbs {
                let is_there = (place.has)(&text, verb);
                if is_there == place.without.iter().any(|(name, _)| name == verb) {
                    wrong.push(format!("{path}: {verb} is there: {is_there}"));
                }
            }
        }
        let names = place.without.iter().map(|(name, _)| *name);
        wrong.extend(
            names
                .filter(|it| !verbs.contains(it))
                .map(|it| format!("no verb {it}")),
        );
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
