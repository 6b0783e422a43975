//! The rights of a running daemon. `people.json` is read again while the daemon runs, so that
//! `jostled auth add` and `remove` take effect without a restart.
//!
//! Only tokens are re-read. zenoh takes the passwords and its access rules when the session is
//! opened and has no call that changes them: an open session of a removed person still reads until
//! the daemon is restarted, and a new person's session is rejected until then.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;

use crate::auth::folder::Folder;
use crate::auth::{Person, Rights, RightsError, by_token};

/// The rights in force.
pub struct LiveRights {
    /// Those that zenoh's access rules were made from.
    at_start: Arc<Rights>,
    current: watch::Sender<Current>,
    problem: Mutex<Option<String>>,
}

#[derive(Clone)]
struct Current {
    rights: Arc<Rights>,
    /// The people of the start whose token is no longer valid, or who have another role now.
    removed: Arc<[Person]>,
}

/// What a reload changed.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// The names whose tokens are valid from now on.
    pub added: Vec<String>,
    /// The names of which a token is no longer valid.
    pub removed: Vec<String>,
}

impl LiveRights {
    /// The rights that the daemon starts with.
    pub fn new(rights: Rights) -> Self {
        let at_start = Arc::new(rights);
        let current = Current {
            rights: at_start.clone(),
            removed: Arc::new([]),
        };
        LiveRights {
            at_start,
            current: watch::Sender::new(current),
            problem: Mutex::default(),
        }
    }

    /// The rights as they are now.
    pub fn current(&self) -> Arc<Rights> {
        self.current.borrow().rights.clone()
    }

    /// Reads `people.json` again. A file that cannot be read, or that others could have changed,
    /// leaves the rights as they are, and [`LiveRights::problem`] says why.
    ///
    /// # Errors
    ///
    /// [`RightsError`] when the rights are left as they are.
    pub fn reload(&self) -> Result<Changes, RightsError> {
        let Rights::People { folder, until, .. } = &*self.at_start else {
            return Ok(Changes::default());
        };
        let read = read_tokens(folder);
        let problem = read.as_ref().err().map(ToString::to_string);
        *self.problem.lock().unwrap_or_else(PoisonError::into_inner) = problem;
        let people = read?;
        let before = self.current();
        let changes = Changes {
            added: names_beyond(&people, &before),
            removed: gone(&before, &people)
                .map(|person| person.name.clone())
                .collect(),
        };
        if changes == Changes::default() {
            return Ok(changes);
        }
        let removed = gone(&self.at_start, &people).cloned().collect();
        let rights = Rights::People {
            folder: folder.clone(),
            people,
            // The certificate that the daemon shows is that of its start.
            until: until.clone(),
        };
        self.current.send_replace(Current {
            rights: Arc::new(rights),
            removed,
        });
        Ok(changes)
    }

    /// Why the last reload left the rights as they were; `None` if it succeeded.
    pub fn problem(&self) -> Option<String> {
        let problem = self.problem.lock().unwrap_or_else(PoisonError::into_inner);
        problem.clone()
    }

    /// Completes when `token` is no longer valid. Never completes where no people are known.
    pub async fn revoked(&self, token: &[u8]) {
        let mut current = self.current.subscribe();
        let is_revoked = |it: &Current| it.rights.sender(token, "").is_err();
        if current.wait_for(is_revoked).await.is_err() {
            // The daemon stops, and ends what is open.
            std::future::pending::<()>().await;
        }
    }

    /// Whether set-points for `controller` are accepted. If they carry a token, its role decides.
    /// If not, zenoh's access rules have permitted them, but as of the daemon's start: set-points
    /// that a removed person could have sent are rejected.
    pub fn permits_set_points(&self, controller: &str, token: Option<&[u8]>) -> bool {
        let current = self.current.borrow();
        let may_steer = |person: &Person| {
            person.role.may("advance") && person.permit_controller(controller).is_ok()
        };
        match token.map(|token| current.rights.sender(token, "advance")) {
            Some(sender) => sender.is_ok_and(|person| person.is_none_or(may_steer)),
            None => !current.removed.iter().any(may_steer),
        }
    }
}

/// Reads the tokens. No lock is needed, since `people.json` is replaced as a whole. Unlike at the
/// start it may be empty: nobody has rights then.
fn read_tokens(folder: &Folder) -> Result<BTreeMap<[u8; 32], Person>, RightsError> {
    folder.check_people()?;
    by_token(folder, folder.people()?.people)
}

/// The people of `rights` who are not in `people` with the same token and role.
fn gone<'a>(
    rights: &'a Rights,
    people: &'a BTreeMap<[u8; 32], Person>,
) -> impl Iterator<Item = &'a Person> {
    let known = match rights {
        Rights::Everybody => None,
        Rights::People { people, .. } => Some(people),
    };
    let known = known.into_iter().flatten();
    known.filter_map(|(hash, person)| (people.get(hash) != Some(person)).then_some(person))
}

/// The names of the people who are not in `rights` with the same token and role.
fn names_beyond(people: &BTreeMap<[u8; 32], Person>, rights: &Rights) -> Vec<String> {
    let is_known = |hash: &[u8; 32], person: &Person| match rights {
        Rights::Everybody => true,
        Rights::People { people, .. } => people.get(hash) == Some(person),
    };
    let new = people
        .iter()
        .filter(|(hash, person)| !is_known(hash, person));
    new.map(|(_, person)| person.name.clone()).collect()
}
