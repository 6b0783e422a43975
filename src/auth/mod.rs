//! Authorization: the users of a daemon, their roles and their tokens.
//!
//! zenoh does not expose the session of a query, so each request carries a token. zenoh's own access
//! control, which knows the name and certificate of the session, is checked before.

pub mod address;
pub mod certificates;
mod error;
pub mod folder;
pub mod issue;
pub mod live;
pub mod secret;
mod user_folder;

use std::collections::BTreeMap;

use blake3::Hash;
use jostle_proto::Role;
use jostle_proto::role::{is_controller_of, is_person, rejection_message};
use thiserror::Error;

use crate::auth::certificates::{in_days, unix_secs};
pub use crate::auth::error::AuthError;
use crate::auth::folder::{Folder, UserEntry};

/// How many days before its expiry a certificate is reported.
pub const EXPIRY_WARNING_DAYS: i64 = 60;

/// The separator between the name of a user and the name of their client; user names cannot contain
/// it.
const BEFORE_CLAIM: char = ':';

/// A user of the daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct User {
    /// Their name.
    pub name: String,
    /// Their role.
    pub role: Role,
}

/// That the daemon's certificate expires on a day, and the remedy.
fn own_expiry(until: &str) -> String {
    format!(
        "the daemon's certificate {} {until}: run `jostled auth address --auth-dir FOLDER` with a \
         `--host NAME` for each of its names, then restart the daemon",
        expires(until)
    )
}

fn expires(until: &str) -> &'static str {
    match *until < *in_days(0) {
        true => "expired on",
        false => "expires on",
    }
}

/// Users by the hashes of their tokens.
pub type ByToken = BTreeMap<[u8; 32], User>;

/// Who is authorized.
#[derive(Clone, Default, PartialEq, Eq)]
pub enum Rights {
    /// Every client may send every request.
    #[default]
    Open,
    /// Clients with the token of a user may send what the user's role permits.
    Users {
        /// The folder with their secrets.
        folder: Folder,
        /// The users.
        users: ByToken,
        /// The last day of the daemon's certificate, if that is known.
        until: Option<String>,
    },
}

/// Why a request is not permitted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NotPermitted {
    /// The verb requires another role.
    #[error("{}", rejection_message(user.as_ref().map(|it| (it.name.as_str(), it.role)), verb))]
    Verb {
        /// The sender; `None` if the token is unknown.
        user: Option<User>,
        /// The verb.
        verb: String,
    },
    /// The controller belongs to another user.
    #[error(
        "you are {user}: a controller of yours is called {user}, or {user}- and more, and not \
         {controller}"
    )]
    Controller {
        /// The sender.
        user: String,
        /// The name of the controller.
        controller: String,
    },
}

impl Rights {
    /// Reads the folder that `jostled auth init` made.
    pub fn read(folder: Folder) -> Result<Self, AuthError> {
        folder.check()?;
        let _locked = folder.lock()?;
        // zenoh reads them as well, with less specific errors.
        folder.passwords()?;
        let known = folder.people()?;
        let users = by_token(&folder, known.people)?;
        if users.is_empty() {
            // Without passwords zenoh would not authenticate sessions.
            return Err(AuthError::Content {
                path: folder.people_file(),
                problem: "it has no users: `jostled auth add NAME=ROLE` adds one".into(),
            });
        }
        let until = known.until;
        Ok(Rights::Users {
            folder,
            users,
            until,
        })
    }

    /// The last day of the daemon's certificate, if that is known.
    fn until(&self) -> Option<&String> {
        match self {
            Rights::Users { until, .. } => until.as_ref(),
            Rights::Open => None,
        }
    }

    /// The last day of the daemon's certificate, if it has expired.
    pub fn ended(&self) -> Option<String> {
        self.until().filter(|it| **it < in_days(0)).cloned()
    }

    /// The begin of that day in seconds since 1970.
    pub fn end_unix_secs(&self) -> Option<i64> {
        unix_secs(self.until()?)
    }

    /// A warning with its remedy if the daemon's certificate expires soon.
    pub fn ends_soon(&self) -> Option<String> {
        let soon = in_days(0)..=in_days(EXPIRY_WARNING_DAYS);
        let until = self.until().filter(|it| soon.contains(*it));
        until.map(|it| own_expiry(it))
    }

    /// Warnings with their remedies: about certificates that expire within so many days, and about
    /// passwords without a user, which open a session without rights.
    pub fn expiry_warnings(&self, days: i64) -> Result<Vec<String>, AuthError> {
        let Rights::Users { folder, .. } = self else {
            return Ok(Vec::new());
        };
        let known = folder.people()?;
        let soon = in_days(days);
        let is_soon = |until: &Option<String>| until.as_ref().is_some_and(|it| *it <= soon);
        let mut lines = Vec::new();
        let own = known.until.filter(|it| *it <= soon);
        lines.extend(own.map(|it| own_expiry(&it)));
        for entry in known.people.iter().filter(|it| is_soon(&it.until)) {
            let UserEntry { person, role, .. } = entry;
            let until = entry.until.as_deref().unwrap_or_default();
            lines.push(format!(
                "the certificate of {person} {} {until}: `jostled auth remove {person}` and \
                 `jostled auth add {person}={role}` make a new folder",
                expires(until)
            ));
        }
        for (person, _) in folder.passwords()? {
            if !known.people.iter().any(|entry| entry.person == person) {
                lines.push(format!(
                    "{person} is no user but has a password: `jostled auth remove {person}` removes it"
                ));
            }
        }
        Ok(lines)
    }

    /// The users; `None` if the daemon is open.
    pub fn users(&self) -> Option<impl Iterator<Item = &User>> {
        match self {
            Rights::Open => None,
            Rights::Users { users, .. } => Some(users.values()),
        }
    }

    /// The sender of a request with this token; `None` if the daemon is open.
    ///
    /// # Errors
    ///
    /// [`NotPermitted::Verb`] if no user has this token.
    pub fn sender(&self, token: &[u8], verb: &str) -> Result<Option<&User>, NotPermitted> {
        match (self, self.owner(token)) {
            (Rights::Open, _) => Ok(None),
            (Rights::Users { .. }, Some(user)) => Ok(Some(user)),
            (Rights::Users { .. }, None) => Err(NotPermitted::Verb {
                user: None,
                verb: verb.to_owned(),
            }),
        }
    }

    /// The user with this token. The lookup is by hash, so that its duration reveals nothing about
    /// other tokens.
    pub fn owner(&self, token: &[u8]) -> Option<&User> {
        match self {
            Rights::Open => None,
            Rights::Users { users, .. } => users.get(blake3::hash(token).as_bytes()),
        }
    }

    /// The sender of a request for `verb`, if it is permitted; `None` if the daemon is open.
    pub fn permit(&self, token: &[u8], verb: &str) -> Result<Option<&User>, NotPermitted> {
        match self.sender(token, verb)? {
            Some(user) if !user.role.may(verb) => Err(NotPermitted::Verb {
                user: Some(user.clone()),
                verb: verb.to_owned(),
            }),
            sender => Ok(sender),
        }
    }
}

/// The users of `people.json`, by the hashes of their tokens.
fn by_token(folder: &Folder, entries: Vec<UserEntry>) -> Result<ByToken, AuthError> {
    let mut users = BTreeMap::new();
    for entry in entries {
        let wrong = |problem: &str| AuthError::Content {
            path: folder.people_file(),
            problem: format!("{}: {problem}", entry.person),
        };
        if !is_person(&entry.person) {
            return Err(AuthError::Name(entry.person));
        }
        let hash = Hash::from_hex(&entry.token_hash)
            .map_err(|_| wrong("token_hash is not a BLAKE3 hash in hexadecimal"))?;
        let user = User {
            name: entry.person.clone(),
            role: entry.role,
        };
        if users.insert(*hash.as_bytes(), user).is_some() {
            return Err(wrong("has the token of another user"));
        }
    }
    Ok(users)
}

/// The user and the name of their client in the name under which a request is stored.
pub fn split_signed(client: &str) -> (Option<&str>, Option<&str>) {
    match client.split_once(BEFORE_CLAIM) {
        Some((user, claim)) => (Some(user), Some(claim)),
        None => (Some(client), None),
    }
}

impl User {
    /// The name under which a request is stored: the user, and the name of their client.
    pub fn signed(&self, claim: Option<&str>) -> String {
        match claim {
            Some(claim) => format!("{}{BEFORE_CLAIM}{claim}", self.name),
            None => self.name.clone(),
        }
    }

    /// Whether they may send every command.
    pub fn is_operator(&self) -> bool {
        self.role == Role::Operator
    }

    /// Whether a controller of this name is theirs.
    pub fn owns(&self, controller: &str) -> bool {
        is_controller_of(&self.name, controller)
    }

    /// Whether a request is stored under their name.
    pub fn sent(&self, client: Option<&str>) -> bool {
        client.is_some_and(|client| split_signed(client).0 == Some(&self.name))
    }

    /// Checks that they may send for a controller of this name.
    ///
    /// # Errors
    ///
    /// [`NotPermitted::Controller`] if it belongs to another user.
    pub fn permit_controller(&self, controller: &str) -> Result<(), NotPermitted> {
        match self.is_operator() || self.owns(controller) {
            true => Ok(()),
            false => Err(NotPermitted::Controller {
                user: self.name.clone(),
                controller: controller.to_owned(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::auth::certificates::DAYS;
    use crate::auth::issue;

    /// A folder with these users.
    pub(super) fn new_folder(users: &[(String, Role)]) -> (tempfile::TempDir, Folder) {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::new(base.path().join("auth"));
        issue::init(&folder, &[], users).unwrap();
        (base, folder)
    }

    #[test]
    fn warnings_about_expiring_certificates_name_the_remedy() {
        let (_base, folder) = new_folder(&[("vera".into(), Role::Viewer)]);
        let rights = Rights::read(folder.clone()).unwrap();
        assert_eq!(rights.expiry_warnings(60).unwrap(), [""; 0]);
        let text = rights.expiry_warnings(DAYS).unwrap().join("\n");
        let day = in_days(DAYS);
        for expected in [
            &format!("the daemon's certificate expires on {day}"),
            &format!("of vera expires on {day}"),
            "`jostled auth add vera=viewer`",
        ] {
            assert!(text.contains(expected), "{text}");
        }
        let mut known = folder.people().unwrap();
        known.until = Some(in_days(-1));
        folder.write_people(&known).unwrap();
        let text = rights.expiry_warnings(DAYS).unwrap().join("\n");
        let expired = format!(
            "the daemon's certificate expired on {}: run `jostled auth address",
            in_days(-1)
        );
        assert!(text.contains(&expired), "{text}");
        // Earlier versions recorded no day.
        known.until = None;
        known.people[0].until = None;
        folder.write_people(&known).unwrap();
        assert_eq!(rights.expiry_warnings(DAYS).unwrap(), [""; 0]);
        assert!(matches!(Rights::Open.expiry_warnings(DAYS), Ok(none) if none.is_empty()));
    }

    #[test]
    fn an_expired_or_missing_certificate_is_reported() {
        let (_base, folder) = new_folder(&[("vera".into(), Role::Viewer)]);
        assert_eq!(Rights::read(folder.clone()).unwrap().ended(), None);
        let mut known = folder.people().unwrap();
        for (until, is_over) in [(in_days(-1), true), (in_days(0), false)] {
            known.until = Some(until.clone());
            folder.write_people(&known).unwrap();
            let ended = Rights::read(folder.clone()).unwrap().ended();
            assert_eq!(ended, is_over.then_some(until));
        }
        assert_eq!(Rights::Open.ended(), None);
        let [certificate, _] = folder.daemon();
        std::fs::remove_file(&certificate).unwrap();
        let rejected = Rights::read(folder).err().unwrap().to_string();
        assert!(rejected.contains("`jostled auth init`"), "{rejected}");
    }

    #[test]
    fn the_token_alone_gives_the_rights_of_a_role() {
        let people = Role::ALL.map(|role| (format!("a_{role}"), role));
        let (_base, folder) = new_folder(&people);
        let rights = Rights::read(folder.clone()).unwrap();
        assert_eq!(rights.users().unwrap().count(), 3);
        for (name, role) in &people {
            let token = folder.credentials(name).unwrap().token;
            let person = User {
                name: name.clone(),
                role: *role,
            };
            assert_eq!(rights.owner(token.as_bytes()), Some(&person));
            let [join, pause] = match role {
                Role::Viewer => [false, false],
                Role::Controller => [true, false],
                Role::Operator => [true, true],
            };
            let text = format!("you are {name}, a {role}");
            let cases = [("join", join), ("pause", pause), ("*", pause), ("", pause)];
            for (verb, is_permitted) in cases {
                match rights.permit(token.as_bytes(), verb) {
                    Ok(permitted) => assert!(is_permitted && permitted == Some(&person)),
                    Err(rejected) => {
                        assert!(
                            !is_permitted && rejected.to_string().contains(&text),
                            "{verb}"
                        );
                    }
                }
            }
            let nearly = &token.as_bytes()[..token.len() - 1];
            assert_eq!(rights.owner(nearly), None);
        }
        for nobodys in [&b""[..], b"a_operator"] {
            let rejected = rights.permit(nobodys, "pause").unwrap_err().to_string();
            assert!(rejected.contains("pause takes an operator"), "{rejected}");
        }
        assert_eq!(Rights::Open.permit(b"", "delete"), Ok(None));
    }

    #[test]
    fn the_client_name_follows_the_user_name_and_a_controller_begins_with_it() {
        let mut person = User {
            name: "anna".into(),
            role: Role::Controller,
        };
        assert_eq!(person.signed(None), "anna");
        assert_eq!(person.signed(Some("ben")), "anna:ben");
        // Also if the client has the name of the user, or one that begins with it.
        assert_eq!(person.signed(Some("anna")), "anna:anna");
        assert_eq!(person.signed(Some("anna2")), "anna:anna2");
        assert_eq!(person.permit_controller("anna-2"), Ok(()));
        assert!(person.permit_controller("ben").is_err());
        person.role = Role::Operator;
        assert_eq!(person.permit_controller("ben"), Ok(()));
    }
}
