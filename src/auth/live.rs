//! The rights of a running daemon. `people.json` is read again while the daemon runs, so that
//! `jostled auth add` and `remove` take effect without a restart.
//!
//! Only tokens are re-read. zenoh takes the passwords and its access rules when the session is
//! opened and has no call that changes them: an open session of a removed user still reads until
//! the daemon is restarted, and the session of a new user is rejected until then.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::watch;

use crate::auth::folder::Folder;
use crate::auth::{AuthError, ByToken, Rights, User, by_token};

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
    /// The users of the start whose token is no longer valid, or who have another role now.
    removed: Arc<[User]>,
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
    /// leaves the rights as they are, and [`LiveRights::problem`] has the reason.
    pub fn reload(&self) -> Result<Changes, AuthError> {
        let before = self.current();
        let (
            Rights::Users {
                folder,
                users: at_start,
                until,
            },
            Rights::Users { users: before, .. },
        ) = (&*self.at_start, &*before)
        else {
            return Ok(Changes::default());
        };
        let read = read_tokens(folder);
        let problem = read.as_ref().err().map(ToString::to_string);
        *self.problem.lock() = problem;
        let users = read?;
        let changes = Changes {
            added: names(difference(&users, before)),
            removed: names(difference(before, &users)),
        };
        if changes == Changes::default() {
            return Ok(changes);
        }
        let removed = difference(at_start, &users).cloned().collect();
        let rights = Rights::Users {
            folder: folder.clone(),
            users,
            // The daemon uses the certificate that it read at the start.
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
        self.problem.lock().clone()
    }

    /// Completes when `token` is no longer valid. Never completes if the daemon is open.
    pub async fn revoked(&self, token: &[u8]) {
        let mut current = self.current.subscribe();
        let is_revoked = |it: &Current| it.rights.sender(token, "").is_err();
        if current.wait_for(is_revoked).await.is_err() {
            // The daemon is stopping, and closes its connections.
            std::future::pending::<()>().await;
        }
    }

    /// Whether set-points for `controller` are accepted. If they carry a token, its role decides.
    /// If not, zenoh's access rules have permitted them, but as of the daemon's start: set-points
    /// that a removed user could have sent are rejected.
    pub fn permits_set_points(&self, controller: &str, token: Option<&[u8]>) -> bool {
        let current = self.current.borrow();
        let may_steer =
            |user: &User| user.role.may("advance") && user.permit_controller(controller).is_ok();
        match token.map(|token| current.rights.sender(token, "advance")) {
            Some(sender) => sender.is_ok_and(|user| user.is_none_or(may_steer)),
            None => !current.removed.iter().any(may_steer),
        }
    }
}

/// Reads the tokens. No lock is needed, since `people.json` is replaced as a whole. Unlike at the
/// start it may be empty: then no request is permitted.
fn read_tokens(folder: &Folder) -> Result<ByToken, AuthError> {
    folder.check_people()?;
    by_token(folder, folder.people()?.people)
}

/// The users of `these` who are not in `others` with the same token and role.
fn difference<'a>(these: &'a ByToken, others: &'a ByToken) -> impl Iterator<Item = &'a User> {
    let these = these.iter();
    these.filter_map(|(hash, user)| (others.get(hash) != Some(user)).then_some(user))
}

fn names<'a>(users: impl Iterator<Item = &'a User>) -> Vec<String> {
    users.map(|user| user.name.clone()).collect()
}
