//! Names of swarms and nodes, and the keys made of them.

use jostle_proto::keys;

/// A name is what the rule says, and stays one chunk of a key that no wildcard is in.
pub fn check(data: &[u8]) {
    let Ok(name) = std::str::from_utf8(data) else {
        return;
    };
    let is_plain = |c: char| matches!(c, 'a'..='z' | '0'..='9');
    let follows_the_rule = name.starts_with(is_plain)
        && name.len() <= 64
        && name.chars().all(|c| is_plain(c) || c == '_' || c == '-');
    assert_eq!(keys::is_name(name), follows_the_rule, "{name:?}");
    if !follows_the_rule {
        return;
    }
    let keys = [
        keys::state("jostle", name),
        keys::order("jostle", name),
        keys::event("jostle", name),
        keys::get("jostle", name, "status"),
        keys::cmd("jostle", name, "step"),
        keys::alive("jostle", name, name),
        keys::node_get("jostle", name, "hello"),
        keys::node_cmd("jostle", name, "create"),
        keys::node_alive("jostle", name),
    ];
    for key in keys {
        assert!((3..=5).contains(&key.split('/').count()), "{key}");
        assert!(key.split('/').all(|chunk| !chunk.is_empty()), "{key}");
        assert!(!key.contains(['*', '$', '?', '#', '\0', ' ']), "{key}");
    }
}
