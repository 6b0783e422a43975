//! Permissions by role, for a daemon with users.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use serde_json::{Map, Value, json};

use crate::{Error, ErrorCode, keys};

/// What a person may do. Each may do what the one before may.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Watch: every `get`, states, orders, events.
    Viewer,
    /// Steer individuals: join swarms as a controller of one's own name, advance, put set-points.
    /// Also write notes into a swarm's journal.
    Controller,
    /// Everything.
    Operator,
}

impl Role {
    /// Every role, the least first.
    pub const ALL: [Role; 3] = [Role::Viewer, Role::Controller, Role::Operator];

    fn with_article(self) -> String {
        match self {
            Role::Operator => format!("an {self}"),
            _ => format!("a {self}"),
        }
    }

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Role::Viewer => "viewer",
            Role::Controller => "controller",
            Role::Operator => "operator",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// The message for a request that requires another role, of a known person or an unknown one.
pub fn rejection_message(person: Option<(&str, Role)>, verb: &str) -> String {
    let who = match person {
        Some((name, role)) => format!("you are {name}, {}", role.with_article()),
        None => "the request has no token of a known person".into(),
    };
    let least = Role::least(verb).with_article();
    format!("{who}, and {verb} takes {least}: ask whoever runs the daemon")
}

/// The error for a request that requires another role.
pub fn rejection(person: Option<(&str, Role)>, verb: &str) -> Error {
    let details = json!({
        "person": person.map(|(name, _)| name),
        "role": person.map(|(_, role)| role),
        "verb": verb,
        "takes": Role::least(verb),
    });
    let details = match details {
        Value::Object(details) => details,
        _ => Map::new(),
    };
    Error {
        code: ErrorCode::PermissionDenied,
        message: rejection_message(person, verb),
        details,
        step: None,
    }
}

/// Whether `name` may name a person: a name without hyphens, since a controller of theirs is named
/// after them and one.
pub fn is_person(name: &str) -> bool {
    keys::is_name(name) && !name.contains('-')
}

/// Whether a controller's name is a person's to take: their own, or theirs, a hyphen and more.
pub fn is_controller_of(person: &str, controller: &str) -> bool {
    let rest = controller.strip_prefix(person);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
}

/// The person and role that a daemon assigns to a client, by the token of the query.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WhoAmI {
    /// The person; `null` from a daemon without users, and for an unknown token.
    pub person: Option<String>,
    /// The role; `null` for an unknown token.
    pub role: Option<Role>,
    /// The permitted commands of swarms.
    pub verbs: Vec<String>,
    /// The permitted commands of the daemon.
    pub node_verbs: Vec<String>,
}

/// The content of `credentials.json` in a person's folder of credentials. It is not sent as a
/// whole: the password authenticates a session, the token a request.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct Credentials {
    /// Who it is.
    pub person: String,
    /// What they are.
    pub role: Role,
    /// Where the daemon is reached, such as `tls/lab.example:7447`.
    pub endpoint: String,
    /// Where its page is, such as `https://lab.example:8443`, if it serves HTTP. Folders of earlier
    /// versions lack it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub page: Option<String>,
    /// What comes along with each request, as its attachment.
    pub token: String,
    /// With the person's name what a session is opened with.
    pub password: String,
}

impl Credentials {
    /// The name of the file.
    pub const FILE: &str = "credentials.json";

    /// The files beside it: whom to trust, who one is, and the proof.
    pub const CERTIFICATES: [&str; 3] = ["ca.pem", "certificate.pem", "key.pem"];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_verb_requires_an_operator() {
        for verb in ["", "*", "**", "get", "Join", "join/now"] {
            assert_eq!(Role::least(verb), Role::Operator, "{verb:?}");
            assert!(!Role::Viewer.may(verb), "viewer, {verb:?}");
            assert!(!Role::Controller.may(verb), "controller, {verb:?}");
            assert!(Role::Operator.may(verb), "operator, {verb:?}");
        }
    }

    #[test]
    fn a_rejection_names_the_person_and_the_least_role() {
        for (person, verb, expected) in [
            (
                Some(("vera", Role::Viewer)),
                "join",
                "you are vera, a viewer, and join takes a controller",
            ),
            (
                Some(("cleo", Role::Controller)),
                "reset",
                "you are cleo, a controller, and reset takes an operator",
            ),
            (
                None,
                "create",
                "the request has no token of a known person, and create takes an operator",
            ),
        ] {
            let error = rejection(person, verb);
            assert_eq!(error.code, ErrorCode::PermissionDenied);
            assert!(error.message.starts_with(expected), "{}", error.message);
            assert_eq!(error.details["verb"], verb);
            assert_eq!(error.details["person"], json!(person.map(|(name, _)| name)));
        }
    }

    #[test]
    fn a_controller_is_named_after_its_person() {
        for own in ["anna", "anna-1", "anna-left-arm"] {
            assert!(is_controller_of("anna", own), "{own}");
        }
        for other in ["ann", "anna2", "anna_2", "ben", "ben-anna", ""] {
            assert!(!is_controller_of("anna", other), "{other}");
        }
        assert!(is_person("anna_2") && !is_person("anna-2") && !is_person(""));
    }
}
