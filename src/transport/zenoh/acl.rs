//! The configuration of zenoh's access control: which messages each user's session may send on which
//! keys.
//!
//! zenoh drops every other message, so that no client can forge the states and replies of a swarm. A
//! wildcard that exceeds the permitted keys is dropped, too. zenoh identifies a user by the user name
//! of the session and, over TLS, by the certificate as well: both must belong to the same user.

use jostle_proto::{Role, keys};
use serde::Serialize;
use serde_json::{Value, json};

use crate::auth::{Rights, User};

/// Every key. `**` does not match a chunk that begins with `@`.
const ALL_KEYS: [&str; 3] = ["**", "**/@node/**", "**/@adv/**"];

/// Messages that only read.
const READ: [&str; 3] = [
    "declare_subscriber",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Messages that publish, reply or declare something to be found by others.
const WRITE: [&str; 5] = [
    "put",
    "delete",
    "reply",
    "declare_queryable",
    "liveliness_token",
];

/// The id of the rule for claims of other daemons.
const CLAIMS: &str = "claims";

/// The id of the rule for the tokens of waits.
const WAITS: &str = "waits";

/// The links on which a password alone authenticates a session: those within this machine.
const LOCAL_LINKS: [&str; 2] = ["tcp", "unixsock-stream"];

/// The configuration for these users and the keys below `prefix`.
pub fn control(prefix: &str, rights: &Rights) -> Value {
    let mut rules = vec![rule(
        "daemon",
        "egress",
        &[&["query"], &READ[..], &WRITE].concat(),
        &ALL_KEYS,
    )];
    let mut subjects = Vec::new();
    let mut policies = Vec::new();
    match rights.users() {
        None => {
            let asking = [&["query"], &READ[..]].concat();
            rules.push(rule("ask", "ingress", &asking, &ALL_KEYS));
            rules.extend(control_rules(prefix, "steer", &["*".to_owned()]));
            rules.push(claims(prefix));
            rules.push(waits(prefix));
            subjects.push(json!({"id": "everyone"}));
            let names = ["daemon", "ask", "steer_put", "steer_live", CLAIMS, WAITS];
            policies.push(json!({"rules": names, "subjects": ["everyone"]}));
        }
        Some(people) => {
            rules.extend(roles(prefix));
            rules.push(claims(prefix));
            rules.push(waits(prefix));
            for person in people {
                let names = rules_of(prefix, person, &mut rules);
                let ids = subjects_of(person, &mut subjects);
                policies.push(json!({"rules": names, "subjects": ids}));
            }
        }
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

/// The rules that do not depend on the name of a user.
fn roles(prefix: &str) -> Vec<Value> {
    let every = |verb: &str| keys::cmd(prefix, "*", verb);
    let gets = [
        keys::get(prefix, "*", "**"),
        keys::state(prefix, "*"),
        // The cached events, which a new subscriber queries.
        format!("{}/@adv/**", keys::event(prefix, "*")),
        keys::node_get(prefix, "*", "**"),
        keys::experiment(prefix, "*", "*", "**"),
    ];
    let controllers = keys::SWARM_VERBS.into_iter();
    let controllers: Vec<String> = controllers
        .filter(|verb| Role::Controller.may(verb))
        .map(every)
        .collect();
    let everything = [every("**"), keys::node_cmd(prefix, "*", "**")];
    let of_operators = ["recording", "audit"].map(|noun| keys::node_get(prefix, "*", noun));
    let set_points = keys::ctl(prefix, "*", "*");
    vec![
        rule("watch", "ingress", &READ, &ALL_KEYS),
        rule("get", "ingress", &["query"], &gets),
        denial("no_operators", "ingress", "query", &of_operators),
        // A set-point contains the token of its sender.
        denial("no_set_points", "egress", "put", &[set_points]),
        rule("control", "ingress", &["query"], &controllers),
        rule("operate", "ingress", &["query"], &everything),
    ]
}

/// The ids of the rules for a user. Rules that depend on the name of the user are added to `rules`.
fn rules_of(prefix: &str, person: &User, rules: &mut Vec<Value>) -> Vec<String> {
    let name = &person.name;
    let (names, controllers): (&[&str], _) = match person.role {
        Role::Viewer => (&["no_operators", "no_set_points"], Vec::new()),
        Role::Controller => (
            &["no_operators", "no_set_points", "control"],
            vec![name.clone(), format!("{name}-$*")],
        ),
        Role::Operator => (&["operate", CLAIMS], vec!["*".to_owned()]),
    };
    let names = ["daemon", "watch", "get", WAITS].iter().chain(names);
    let mut names: Vec<String> = names.map(ToString::to_string).collect();
    if !controllers.is_empty() {
        names.extend(["put", "live"].map(|what| format!("{name}_{what}")));
        rules.extend(control_rules(prefix, name, &controllers));
    }
    names
}

/// Permits the claims of other daemons, which routers forward. A router that forwards commands
/// connects as an operator, so no other role needs this permission.
fn claims(prefix: &str) -> Value {
    let keys = [
        keys::claim(prefix, "*", "*", "*", "*"),
        keys::node_claim(prefix, "*", "*", "*"),
    ];
    rule(CLAIMS, "ingress", &["liveliness_token"], &keys)
}

/// Permits the tokens of clients that wait for a condition, of every role.
fn waits(prefix: &str) -> Value {
    let keys = [keys::wait_alive(prefix, "*", "*")];
    rule(WAITS, "ingress", &["liveliness_token"], &keys)
}

/// The ids of the subjects that match a user; the subjects are added.
fn subjects_of(person: &User, subjects: &mut Vec<Value>) -> [String; 2] {
    let name = &person.name;
    let ids = [format!("{name}_here"), format!("{name}_by_tls")];
    let [here, by_tls] = &ids;
    subjects.push(json!({"id": here, "usernames": [name], "link_protocols": LOCAL_LINKS}));
    subjects.push(json!({
        "id": by_tls,
        "usernames": [name],
        "cert_common_names": [name],
        "link_protocols": ["tls"],
    }));
    ids
}

/// Permits controllers of these names to publish set-points (`ID_put`) and to declare their token
/// (`ID_live`).
fn control_rules(prefix: &str, id: &str, controllers: &[String]) -> [Value; 2] {
    let each = |suffix: &str, message: &str, key: fn(&str, &str, &str) -> String| {
        let keys: Vec<_> = controllers.iter().map(|it| key(prefix, "*", it)).collect();
        rule(&format!("{id}_{suffix}"), "ingress", &[message], &keys)
    };
    [
        each("put", "put", keys::ctl),
        each("live", "liveliness_token", keys::ctl_alive),
    ]
}

/// Denies messages on keys that another rule allows.
fn denial(id: &str, flow: &str, message: &str, keys: &[String]) -> Value {
    let mut rule = rule(id, flow, &[message], keys);
    rule["permission"] = json!("deny");
    rule
}

fn rule<K: Serialize>(id: &str, flow: &str, messages: &[&str], keys: &[K]) -> Value {
    json!({
        "id": id,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    })
}
