//! The key expressions of a daemon and its swarms.
//!
//! Reading (`get`) and changing (`cmd`) are apart because access control sees only keys.

pub use crate::verbs::{NODE_VERBS, OWN_VERBS, SWARM_VERBS};

/// The first chunk of every key unless a daemon is configured otherwise.
pub const DEFAULT_PREFIX: &str = "jostle";

/// The nouns that `{prefix}/{swarm}/get/` answers.
pub const SWARM_GETS: [&str; 11] = [
    "status",
    "controllers",
    "spec",
    "parameters",
    "measures",
    "events",
    "journal",
    "snapshot",
    "verify",
    "experiment",
    "wait",
];

/// The nouns that `{prefix}/@node/{node}/get/` answers.
pub const NODE_GETS: [&str; 10] = [
    "hello",
    "whoami",
    "status",
    "swarms",
    "schema",
    "metrics",
    "experiments",
    "audit",
    "recordings",
    "recording",
];

/// The nouns that `{prefix}/@node/{node}/experiment/{experiment}/` answers.
pub const EXPERIMENT_GETS: [&str; 4] = ["progress", "results", "order", "series"];

/// The longest name of a swarm, a node, an experiment, a recording or a controller, in
/// bytes.
pub const MAX_NAME_LENGTH: usize = 64;

/// The pattern of names, for messages.
pub const NAME_RULE: &str = "^[a-z0-9][a-z0-9_-]{0,63}$";

/// Whether `name` may name a swarm, a node, an experiment, a recording or a controller.
///
/// zenoh itself would take `*`, a NUL or 70,000 bytes, and a wildcard there would hit every swarm.
pub fn is_name(name: &str) -> bool {
    let plain = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit();
    match name.as_bytes() {
        [] => false,
        [first, rest @ ..] => {
            name.len() <= MAX_NAME_LENGTH
                && plain(*first)
                && rest.iter().all(|&c| plain(c) || c == b'_' || c == b'-')
        }
    }
}

/// The key a swarm's states are published on, and answered on when queried.
pub fn state(prefix: &str, swarm: &str) -> String {
    format!("{prefix}/{swarm}/state")
}

/// The key a swarm's order is published on.
pub fn order(prefix: &str, swarm: &str) -> String {
    format!("{prefix}/{swarm}/order")
}

/// The key a swarm's events are published on.
pub fn event(prefix: &str, swarm: &str) -> String {
    format!("{prefix}/{swarm}/event")
}

/// The liveliness token of a swarm, held by the daemon that hosts it.
pub fn alive(prefix: &str, swarm: &str, node: &str) -> String {
    format!("{prefix}/{swarm}/alive/{node}")
}

/// The liveliness token by which a daemon claims a swarm's name. `instance` identifies one run of
/// the daemon, so that two daemons never declare the same key.
pub fn claim(prefix: &str, swarm: &str, node: &str, instance: &str, standing: &str) -> String {
    format!("{prefix}/{swarm}/claim/{node}/{instance}/{standing}")
}

/// The liveliness token by which a daemon claims its own name.
pub fn node_claim(prefix: &str, node: &str, instance: &str, standing: &str) -> String {
    format!("{prefix}/@node/{node}/claim/{instance}/{standing}")
}

/// The key that answers `noun` about a swarm; changes nothing.
pub fn get(prefix: &str, swarm: &str, noun: &str) -> String {
    format!("{prefix}/{swarm}/get/{noun}")
}

/// The key that executes `verb` on a swarm.
pub fn cmd(prefix: &str, swarm: &str, verb: &str) -> String {
    format!("{prefix}/{swarm}/cmd/{verb}")
}

/// The key on which a controller puts set-points while the swarm runs.
pub fn ctl(prefix: &str, swarm: &str, controller: &str) -> String {
    format!("{prefix}/{swarm}/ctl/{controller}")
}

/// The liveliness token of a controller: when it goes, the controller has left.
pub fn ctl_alive(prefix: &str, swarm: &str, controller: &str) -> String {
    format!("{prefix}/{swarm}/ctl/{controller}/alive")
}

/// The liveliness token of a client that waits for a condition, by the id of its wait: when it goes, the
/// wait ends.
pub fn wait_alive(prefix: &str, swarm: &str, id: &str) -> String {
    format!("{prefix}/{swarm}/wait/{id}/alive")
}

/// The liveliness token of a daemon.
pub fn node_alive(prefix: &str, node: &str) -> String {
    format!("{prefix}/@node/{node}/alive")
}

/// The key that answers `noun` about a daemon; changes nothing.
pub fn node_get(prefix: &str, node: &str, noun: &str) -> String {
    format!("{prefix}/@node/{node}/get/{noun}")
}

/// The key that executes `verb` on a daemon.
pub fn node_cmd(prefix: &str, node: &str, verb: &str) -> String {
    format!("{prefix}/@node/{node}/cmd/{verb}")
}

/// The key that answers `noun` about an experiment; `progress` is published there too.
pub fn experiment(prefix: &str, node: &str, experiment: &str, noun: &str) -> String {
    format!("{prefix}/@node/{node}/experiment/{experiment}/{noun}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_the_documented_form() {
        assert_eq!(ctl("jostle", "a", "ada"), "jostle/a/ctl/ada");
        assert_eq!(ctl_alive("jostle", "a", "ada"), "jostle/a/ctl/ada/alive");
        assert_eq!(wait_alive("jostle", "a", "w1"), "jostle/a/wait/w1/alive");
        assert_eq!(node_alive("jostle", "lab"), "jostle/@node/lab/alive");
    }

    #[test]
    fn names_that_zenoh_would_take_but_must_not_be_names_are_rejected() {
        let long = "a".repeat(65);
        for name in [
            "", "*", "**", "a$*", "@node", "a/b", "A", "-a", "_a", "a b", "a\0", "ä", "..", &long,
        ] {
            assert!(!is_name(name), "{name:?}");
        }
        for name in ["a", "0", "demo", "exp-42_b", &"a".repeat(64)] {
            assert!(is_name(name), "{name:?}");
        }
    }
}
