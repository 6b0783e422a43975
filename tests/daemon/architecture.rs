//! Who may use whom: the house's rules, read off the source.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Each module and those of the daemon it may use.
const MAY_USE: [(&str, &[&str]); 25] = [
    ("session_pool", &[]),
    ("process", &[]),
    ("meter", &[]),
    ("swarm", &["meter"]),
    ("host", &["swarm"]),
    ("store", &["meter"]),
    ("health", &["meter", "swarm", "host", "store"]),
    ("rights", &[]),
    (
        "gateway",
        &["meter", "swarm", "health", "rights", "session_pool"],
    ),
    (
        "command",
        &[
            "swarm",
            "host",
            "lab",
            "recording",
            "replay",
            "rights",
            "wire",
        ],
    ),
    ("wire", &["swarm", "host", "lab", "recording", "health"]),
    (
        "publish",
        &["meter", "swarm", "command", "wire", "session_pool"],
    ),
    ("lab", &[]),
    ("replay", &["swarm", "wire"]),
    ("recording", &["swarm", "wire"]),
    ("backup", &["store"]),
    ("batch", &[]),
    ("config", &["host"]),
    (
        "server",
        &[
            "meter",
            "swarm",
            "host",
            "lab",
            "recording",
            "replay",
            "rights",
            "command",
            "config",
            "publish",
            "session_pool",
            "store",
            "wire",
            "health",
            "gateway",
        ],
    ),
    ("supervisor", &["health", "host"]),
    ("demo", &["swarm", "host", "command", "server"]),
    (
        "main",
        &[
            "backup",
            "batch",
            "config",
            "demo",
            "gateway",
            "people",
            "process",
            "server",
            "supervisor",
        ],
    ),
    ("people", &["rights"]),
    ("lib", &[]),
    ("", &[]),
];

/// Crates and modules that only these modules may name.
const ONLY_IN: [(&str, &[&str]); 24] = [
    ("zenoh::", &["gateway", "publish", "server", "session_pool"]),
    ("zenoh_ext::", &["publish"]),
    (
        "jostle_proto",
        &[
            "command",
            "config",
            "demo",
            "gateway",
            "lab",
            "people",
            "publish",
            "recording",
            "rights",
            "server",
            "session_pool",
            "wire",
        ],
    ),
    (
        "serde",
        &[
            "backup",
            "batch",
            "command",
            "demo",
            "gateway",
            "lab",
            "people",
            "recording",
            "rights",
            "server",
            "wire",
        ],
    ),
    ("jostle_results", &["lab", "recording", "replay", "wire"]),
    ("indicatif::", &["batch"]),
    ("axum::", &["gateway"]),
    ("hyper::", &["gateway"]),
    ("hyper_util::", &["gateway"]),
    ("rust_embed", &["gateway"]),
    ("prometheus_client::", &["gateway"]),
    (
        "tokio::",
        &[
            "demo",
            "gateway",
            "main",
            "rights/live",
            "server",
            "supervisor",
        ],
    ),
    ("sd_notify::", &["supervisor"]),
    ("clap::", &["main", "people"]),
    ("clap_mangen::", &["main"]),
    (
        "std::thread",
        &[
            "backup",
            "batch",
            "health",
            "host",
            "lab",
            "process",
            "publish",
            "recording",
            "server",
            "store",
        ],
    ),
    (
        "std::time",
        &[
            "backup",
            "batch",
            "command",
            "demo",
            "gateway",
            "health",
            "host",
            "lab",
            "main",
            "meter",
            "publish",
            "recording",
            "replay/uploads",
            "server",
            "store",
            "supervisor",
            "swarm",
        ],
    ),
    (
        "std::fs",
        &[
            "backup",
            "batch",
            "config",
            "gateway/token",
            "health",
            "lab/shelf",
            "main",
            "recording/shelf",
            "replay",
            "rights",
            "store",
        ],
    ),
    (
        "std::sync",
        &[
            "batch",
            "command",
            "demo",
            "gateway",
            "health",
            "host",
            "lab",
            "meter",
            "publish",
            "recording",
            "replay",
            "rights/live",
            "server",
            "session_pool",
            "store",
            "supervisor",
            "swarm",
            "wire",
        ],
    ),
    ("rcgen::", &["rights"]),
    ("tokio_rustls::", &["gateway"]),
    ("rusqlite::", &["store"]),
    ("libc::", &["process", "swarm/rank"]),
    ("tempfile::", &["main"]),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.ends_with("tests") {
            continue;
        }
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// The code of every source file by its path below `src`, without extension, tests or comments.
fn code() -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut code = BTreeMap::new();
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        let lines = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        let path = file.strip_prefix(&root).unwrap().with_extension("");
        code.insert(
            path.to_str().unwrap().to_owned(),
            lines.collect::<Vec<_>>().join("\n"),
        );
    }
    assert!(code.len() > 30, "the source is read");
    code
}

fn module(path: &str) -> &str {
    path.split('/').next().unwrap()
}

#[test]
fn modules_use_only_those_that_the_table_allows() {
    for (path, text) in code() {
        let module = module(&path);
        let (_, may_use) = MAY_USE
            .iter()
            .find(|(name, _)| *name == module)
            .unwrap_or_else(|| panic!("{path} is not in the table"));
        for (other, _) in MAY_USE {
            let names = ["crate::", "jostled::"].iter().any(|root| {
                let direct = format!("{root}{other}");
                text.match_indices(&direct).any(|(at, _)| {
                    let next = text[at + direct.len()..].chars().next();
                    !next.is_some_and(|c| c.is_alphanumeric() || c == '_')
                })
            });
            if !other.is_empty() && names && other != module {
                assert!(may_use.contains(&other), "{path} uses {other}");
            }
        }
    }
}

#[test]
fn each_library_is_named_only_where_it_belongs() {
    for (path, text) in code() {
        for (library, rooms) in ONLY_IN {
            let names = text.match_indices(library).any(|(at, _)| {
                let before = text[..at].chars().next_back();
                !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
            });
            let is_room = rooms
                .iter()
                .any(|room| path == *room || module(&path) == *room);
            assert!(!names || is_room, "{path} names {library}");
        }
    }
}
