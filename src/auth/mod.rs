//! Who may do what: the people of a daemon, their roles and their tokens.
//!
//! A query does not tell whose session it came over, so each request brings a token along; zenoh's
//! own access control, which knows the session's name and certificate, stands before that.

pub mod address;
pub mod certificates;
pub mod folder;
pub mod issue;
pub mod live;
pub mod secret;

use std::collections::BTreeMap;
use std::path::PathBuf;

use blake3::Hash;
use jostle_proto::Role;
use jostle_proto::role::{is_controller_of, is_person, refusal};
use thiserror::Error;

use crate::auth::certificates::in_days;
use crate::auth::folder::{Entry, Folder};

/// Between a person's name and what their client calls itself: no name has it.
const BEFORE_CLAIM: char = ':';

/// Why people's rights cannot be read or given.
#[derive(Debug, Error)]
pub enum RightsError {
    /// A file cannot be read or written.
    #[error("{path}: {error}")]
    File {
        /// Which.
        path: PathBuf,
        /// What the system says.
        error: std::io::Error,
    },
    /// There is nothing of the kind.
    #[error("{0} has no people.json: `jostled auth init --auth-dir {0}` makes it")]
    Nothing(PathBuf),
    /// A file says what it cannot say.
    #[error("{path}: {problem}")]
    Content {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Others can read a secret.
    #[error("{0} can be read by others: `chmod go= {0}`, and give new secrets if anybody did")]
    Open(PathBuf),
    /// Others can change what decides who may what.
    #[error("{0} can be changed by others: `chmod go-w {0}`, once you know that nobody did")]
    Changeable(PathBuf),
    /// What decides that is somebody else's.
    #[error("{0} belongs to somebody else: `chown` it to whom the daemon runs as")]
    Foreign(PathBuf),
    /// Something is missing that can be made again.
    #[error("{0} is missing: `jostled auth init` with the daemon's names makes it again")]
    Missing(PathBuf),
    /// The authority is elsewhere.
    #[error("{0} is not here, and nobody can be added without: put it back for as long")]
    NoAuthority(PathBuf),
    /// A person's name.
    #[error(
        "{0:?} is no person's name: 1 to 64 of a-z, 0-9 and _, the first a letter or digit; and \
         jostled is the daemon's own"
    )]
    Name(String),
    /// A machine's name or address.
    #[error("{0:?} is neither a name nor an address of a machine, such as lab.example or 10.0.0.1")]
    Host(String),
    /// Every address of a machine, and no name to reach it by.
    #[error(
        "{0} is every address of this machine: name one by which others reach it, \
         --host lab.example"
    )]
    NoHost(String),
    /// A port that differs at each start.
    #[error("{0} picks a new port at each start, but credentials contain a fixed one: give a port")]
    AnyPort(String),
    /// An endpoint without a port.
    #[error("{0:?} has no port: give tls/ADDRESS:PORT")]
    NoPort(String),
    /// Names that an earlier version did not record.
    #[error(
        "an earlier version made the certificate, and did not record its names: give all of them, \
         --host {0} and so on"
    )]
    HostsUnknown(String),
    /// The person is there already.
    #[error(
        "{0} is there already: `jostled auth remove {0}` first, to give new secrets or another role"
    )]
    There(String),
    /// The same name twice in one command.
    #[error("{0} is named twice: give each name once")]
    Twice(String),
    /// There is no such person.
    #[error("there is nobody called {0:?}: `jostled auth list` shows who there is")]
    Nobody(String),
    /// A name or an address that no certificate can be made for.
    #[error("no certificate can be made: {0}")]
    Certificate(#[from] rcgen::Error),
}

/// Somebody the daemon knows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Person {
    /// Their name.
    pub name: String,
    /// What they are.
    pub role: Role,
}

/// Who may do what.
#[derive(Clone, Default, PartialEq, Eq)]
pub enum Rights {
    /// Whoever reaches the daemon may do everything.
    #[default]
    Everybody,
    /// These people, by the hashes of their tokens.
    People {
        /// Where their secrets are.
        folder: Folder,
        /// Who they are.
        people: BTreeMap<[u8; 32], Person>,
        /// The last day of the daemon's certificate, if that is known.
        until: Option<String>,
    },
}

/// Why a request is not permitted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NotPermitted {
    /// It takes another role.
    #[error("{}", refusal(person.as_ref().map(|it| (it.name.as_str(), it.role)), verb))]
    Verb {
        /// Whose request it is; nobody's, if its token is no one's.
        person: Option<Person>,
        /// What was asked for.
        verb: String,
    },
    /// It speaks for somebody else's controller.
    #[error(
        "you are {person}: a controller of yours is called {person}, or {person}- and more, and \
         not {controller}"
    )]
    Controller {
        /// Whose request it is.
        person: String,
        /// Whom it speaks for.
        controller: String,
    },
}

impl Rights {
    /// Reads the folder that `jostled auth init` made.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when it is not there, not whole, or open to others.
    pub fn read(folder: Folder) -> Result<Self, RightsError> {
        folder.check()?;
        let _held = folder.hold()?;
        // zenoh reads them, and would say less of what is wrong.
        folder.passwords()?;
        let known = folder.people()?;
        let people = by_token(&folder, known.people)?;
        if people.is_empty() {
            // With no password to ask for, zenoh would ask for none.
            return Err(RightsError::Content {
                path: folder.people_file(),
                problem: "there is nobody: `jostled auth add NAME=ROLE`".into(),
            });
        }
        let until = known.until;
        Ok(Rights::People {
            folder,
            people,
            until,
        })
    }

    /// The last day of the daemon's certificate, if that is over.
    pub fn ended(&self) -> Option<String> {
        match self {
            Rights::People { until, .. } => until.clone().filter(|it| *it < in_days(0)),
            Rights::Everybody => None,
        }
    }

    /// What is to be put in order, and how, a line each: certificates that end within so many days,
    /// and passwords of nobody, which let in and nothing more.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when who there is cannot be read.
    pub fn notices(&self, days: i64) -> Result<Vec<String>, RightsError> {
        let Rights::People { folder, .. } = self else {
            return Ok(Vec::new());
        };
        let known = folder.people()?;
        let soon = in_days(days);
        let is_soon = |until: &Option<String>| until.as_ref().is_some_and(|it| *it <= soon);
        let mut lines = Vec::new();
        if let Some(until) = known.until.filter(|it| *it <= soon) {
            lines.push(format!(
                "the daemon's certificate holds until {until}: `jostled auth init --host NAME` with \
                 each of its names makes a new one"
            ));
        }
        for entry in known.people.iter().filter(|it| is_soon(&it.until)) {
            let Entry { person, role, .. } = entry;
            lines.push(format!(
                "the certificate of {person} holds until {}: `jostled auth remove {person}` and \
                 `jostled auth add {person}={role}` make a new folder",
                entry.until.as_deref().unwrap_or_default()
            ));
        }
        for (person, _) in folder.passwords()? {
            if !known.people.iter().any(|entry| entry.person == person) {
                lines.push(format!(
                    "{person} is nobody and has a password still: `jostled auth remove {person}` \
                     takes it away"
                ));
            }
        }
        Ok(lines)
    }

    /// Everybody the daemon knows; none where whoever reaches it may do everything.
    pub fn people(&self) -> Option<impl Iterator<Item = &Person>> {
        match self {
            Rights::Everybody => None,
            Rights::People { people, .. } => Some(people.values()),
        }
    }

    /// Who sends a request that bears this token; `None` where everybody may do everything.
    ///
    /// # Errors
    ///
    /// [`NotPermitted::Verb`] if no person has this token.
    pub fn sender(&self, token: &[u8], verb: &str) -> Result<Option<&Person>, NotPermitted> {
        match (self, self.owner(token)) {
            (Rights::Everybody, _) => Ok(None),
            (Rights::People { .. }, Some(person)) => Ok(Some(person)),
            (Rights::People { .. }, None) => Err(NotPermitted::Verb {
                person: None,
                verb: verb.to_owned(),
            }),
        }
    }

    /// Whose token this is. By its hash, so that how long it takes tells nothing of another.
    pub fn owner(&self, token: &[u8]) -> Option<&Person> {
        match self {
            Rights::Everybody => None,
            Rights::People { people, .. } => people.get(blake3::hash(token).as_bytes()),
        }
    }

    /// Who asks for `verb`, if they may: nobody in particular where everybody may.
    ///
    /// # Errors
    ///
    /// [`NotPermitted`].
    pub fn permit(&self, token: &[u8], verb: &str) -> Result<Option<&Person>, NotPermitted> {
        match self.sender(token, verb)? {
            Some(person) if !person.role.may(verb) => Err(NotPermitted::Verb {
                person: Some(person.clone()),
                verb: verb.to_owned(),
            }),
            sender => Ok(sender),
        }
    }
}

/// The people of `people.json`, by the hashes of their tokens.
fn by_token(
    folder: &Folder,
    entries: Vec<Entry>,
) -> Result<BTreeMap<[u8; 32], Person>, RightsError> {
    let mut people = BTreeMap::new();
    for entry in entries {
        let wrong = |problem: &str| RightsError::Content {
            path: folder.people_file(),
            problem: format!("{}: {problem}", entry.person),
        };
        if !is_person(&entry.person) {
            return Err(RightsError::Name(entry.person));
        }
        let hash = Hash::from_hex(&entry.token_hash)
            .map_err(|_| wrong("token_hash is no BLAKE3 hash in hexadecimal"))?;
        let person = Person {
            name: entry.person.clone(),
            role: entry.role,
        };
        if people.insert(*hash.as_bytes(), person).is_some() {
            return Err(wrong("has the token of somebody else"));
        }
    }
    Ok(people)
}

impl Person {
    /// Who a request is from: its person, and what their client calls itself.
    pub fn signed(&self, claim: Option<&str>) -> String {
        match claim {
            Some(claim) => format!("{}{BEFORE_CLAIM}{claim}", self.name),
            None => self.name.clone(),
        }
    }

    /// Lets them speak for a controller of this name.
    ///
    /// # Errors
    ///
    /// [`NotPermitted::Controller`] for one that is not theirs.
    pub fn permit_controller(&self, controller: &str) -> Result<(), NotPermitted> {
        match self.role == Role::Operator || is_controller_of(&self.name, controller) {
            true => Ok(()),
            false => Err(NotPermitted::Controller {
                person: self.name.clone(),
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

    #[test]
    fn certificates_that_end_soon_are_told_of_with_the_remedy() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        issue::init(&folder, &[], &[("vera".into(), Role::Viewer)]).unwrap();
        let rights = Rights::read(folder.clone()).unwrap();
        assert_eq!(rights.notices(60).unwrap(), [""; 0]);
        let told = rights.notices(DAYS).unwrap().join("\n");
        let day = in_days(DAYS);
        assert!(
            told.contains(&format!("the daemon's certificate holds until {day}")),
            "{told}"
        );
        assert!(
            told.contains(&format!("of vera holds until {day}")),
            "{told}"
        );
        assert!(told.contains("`jostled auth add vera=viewer`"), "{told}");
        // What was made by an older program says of no day.
        let mut known = folder.people().unwrap();
        known.until = None;
        known.people[0].until = None;
        folder.write_people(&known).unwrap();
        assert_eq!(rights.notices(DAYS).unwrap(), [""; 0]);
        assert!(matches!(Rights::Everybody.notices(DAYS), Ok(none) if none.is_empty()));
    }

    #[test]
    fn a_certificate_that_has_ended_or_is_missing_is_told() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        issue::init(&folder, &[], &[("vera".into(), Role::Viewer)]).unwrap();
        assert_eq!(Rights::read(folder.clone()).unwrap().ended(), None);
        let mut known = folder.people().unwrap();
        for (until, is_over) in [(in_days(-1), true), (in_days(0), false)] {
            known.until = Some(until.clone());
            folder.write_people(&known).unwrap();
            let ended = Rights::read(folder.clone()).unwrap().ended();
            assert_eq!(ended, is_over.then_some(until));
        }
        assert_eq!(Rights::Everybody.ended(), None);
        let [certificate, _] = folder.daemon();
        std::fs::remove_file(&certificate).unwrap();
        let refused = Rights::read(folder).err().unwrap().to_string();
        assert!(refused.contains("`jostled auth init`"), "{refused}");
    }

    #[test]
    fn each_may_what_their_role_may_by_their_token_alone() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        let people = Role::ALL.map(|role| (format!("a_{role}"), role));
        issue::init(&folder, &[], &people).unwrap();
        let rights = Rights::read(folder.clone()).unwrap();
        assert_eq!(rights.people().unwrap().count(), 3);
        for (name, role) in &people {
            let token = folder.credentials(name).unwrap().token;
            let person = Person {
                name: name.clone(),
                role: *role,
            };
            assert_eq!(rights.owner(token.as_bytes()), Some(&person));
            let [join, pause] = match role {
                Role::Viewer => [false, false],
                Role::Controller => [true, false],
                Role::Operator => [true, true],
            };
            for (verb, is_permitted) in
                [("join", join), ("pause", pause), ("*", pause), ("", pause)]
            {
                let permitted = rights.permit(token.as_bytes(), verb);
                match is_permitted {
                    true => assert_eq!(permitted, Ok(Some(&person)), "{name} {verb}"),
                    false => {
                        let told = permitted.unwrap_err().to_string();
                        assert!(
                            told.contains(&format!("you are {name}, a {role}")),
                            "{told}"
                        );
                    }
                }
            }
            let nearly = &token.as_bytes()[..token.len() - 1];
            assert_eq!(rights.owner(nearly), None);
        }
        for nobodys in [&b""[..], b"a_operator"] {
            let refused = rights.permit(nobodys, "pause").unwrap_err().to_string();
            assert!(refused.contains("pause takes an operator"), "{refused}");
        }
        assert_eq!(Rights::Everybody.permit(b"", "delete"), Ok(None));
    }

    #[test]
    fn a_claim_stands_behind_the_name_and_a_controller_bears_it() {
        let mut person = Person {
            name: "anna".into(),
            role: Role::Controller,
        };
        assert_eq!(person.signed(None), "anna");
        assert_eq!(person.signed(Some("ben")), "anna:ben");
        // Also where the client calls itself as the person, or begins with that name.
        assert_eq!(person.signed(Some("anna")), "anna:anna");
        assert_eq!(person.signed(Some("anna2")), "anna:anna2");
        assert_eq!(person.permit_controller("anna-2"), Ok(()));
        assert!(person.permit_controller("ben").is_err());
        person.role = Role::Operator;
        assert_eq!(person.permit_controller("ben"), Ok(()));
    }
}
