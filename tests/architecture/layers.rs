//! The layers of the daemon: no module names one of a higher layer, and libraries stay in theirs.

use std::fs;
use std::path::{Path, PathBuf};

/// The modules of the daemon by layer, the lowest first.
const LAYERS: [&[&str]; 7] = [
    &["failpoint", "lanes", "metrics", "suspension"],
    &["swarm", "store", "auth"],
    &[
        "audit",
        "backup",
        "config",
        "convert",
        "experiments",
        "health",
        "jobs",
        "persistence",
        "playback",
        "recording",
    ],
    &["api"],
    &["transport"],
    &["app", "doctor"],
    &["cli", "lib", "main"],
];

/// Files that name a higher layer, and the module that they name; the list only shrinks.
const UPWARD: [(&str, &str); 0] = [];

/// Libraries, and the modules that may name them.
const LIBRARIES: [(&str, &[&str]); 10] = [
    ("zenoh", &["app", "transport"]),
    ("zenoh_ext", &["transport/zenoh"]),
    ("axum", &["transport/http"]),
    ("hyper", &["transport/http"]),
    ("rusqlite", &["store"]),
    ("clap", &["cli", "main"]),
    (
        "tokio",
        &[
            "api/responder",
            "app",
            "auth/live",
            "cli",
            "main",
            "transport",
        ],
    ),
    ("jostle_client", &["cli/demo"]),
    ("libc", &["cli/process", "swarm/scheduler"]),
    (
        "jostle_proto",
        &[
            "api",
            "app",
            "auth",
            "cli",
            "config",
            "convert",
            "doctor",
            "experiments",
            "persistence",
            "recording",
            "transport",
        ],
    ),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("tests") {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Each source file by its path below `src`, without tests and comments.
fn code() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let code = files.iter().map(|file| {
        let text = fs::read_to_string(file).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        let lines = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        let path = file.strip_prefix(&root).unwrap().with_extension("");
        let path = path.to_str().unwrap().to_owned();
        (path, lines.collect::<Vec<_>>().join("\n"))
    });
    code.collect()
}

/// Whether `text` contains `path` as the beginning of a path.
fn names(text: &str, path: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(path).any(|(at, _)| {
        let (before, after) = (&text[..at], &text[at + path.len()..]);
        !before.ends_with(|c| is_part(c) || c == ':') && !after.starts_with(is_part)
    })
}

#[test]
fn no_module_names_one_of_a_higher_layer() {
    let mut upward = Vec::new();
    for (path, text) in code() {
        let module = path.split('/').next().unwrap();
        let layer = LAYERS.iter().position(|it| it.contains(&module));
        let layer = layer.unwrap_or_else(|| panic!("{path} is in no layer"));
        for other in LAYERS[layer + 1..].concat() {
            if names(&text, &format!("crate::{other}")) {
                upward.push((path.clone(), other.to_owned()));
            }
        }
    }
    let listed = UPWARD.map(|(path, other)| (path.to_owned(), other.to_owned()));
    upward.sort();
    assert_eq!(upward, listed);
}

#[test]
fn each_library_is_named_only_where_it_belongs() {
    for (path, text) in code() {
        for (library, modules) in LIBRARIES {
            let is_permitted = modules.iter().any(|it| path.starts_with(it));
            let is_named = text.match_indices(library).any(|(at, _)| {
                let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
                text[at + library.len()..].starts_with("::") && !text[..at].ends_with(is_part)
            });
            assert!(is_permitted || !is_named, "{path} names {library}");
        }
    }
}
