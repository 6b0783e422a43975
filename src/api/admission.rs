//! The limits of requests that have no reply yet.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use parking_lot::Mutex;

/// Maximum unanswered requests to one queryable, of a user where there are users; further ones are rejected
/// with `busy`. This many get a reply within a few milliseconds. The delay of requests to other swarms is
/// twice as long with 256, and no shorter with 64 or 16. A hundred concurrent requests are served.
const MAX_UNANSWERED: usize = 128;

/// Maximum unanswered requests of a user to all queryables, for which requests of others wait.
const MAX_UNANSWERED_OF_USER: usize = 512;

/// Bytes of all unanswered requests; further ones are rejected with `busy`.
const MAX_UNANSWERED_BYTES: usize = 64 * 1024 * 1024;

/// Bytes of the unanswered requests of a user, beyond which further ones are rejected.
const MAX_UNANSWERED_BYTES_OF_USER: usize = MAX_UNANSWERED_BYTES / 4;

/// The name of a user, empty for unknown ones; `None` without users.
pub type User = Option<Arc<str>>;

/// Counts unanswered requests and their bytes by user; without users all are counted as those of one.
#[derive(Clone, Default)]
pub struct Unanswered(Arc<Mutex<HashMap<User, [usize; 2]>>>);

/// Counts all unanswered requests, and their bytes.
#[derive(Default)]
pub struct Admission {
    bytes: Arc<AtomicUsize>,
    requests: Unanswered,
}

/// Counts a request as unanswered until it is dropped.
pub struct Permit {
    bytes: usize,
    user: User,
    all_bytes: Arc<AtomicUsize>,
    requests: [Unanswered; 2],
}

impl Unanswered {
    /// Counts a request; returns the requests of its user before it, and their bytes.
    fn add(&self, user: &User, bytes: usize) -> [usize; 2] {
        let mut counts = self.0.lock();
        let count = counts.entry(user.clone()).or_default();
        let before = *count;
        *count = [before[0] + 1, before[1] + bytes];
        before
    }

    fn remove(&self, user: &User, bytes: usize) {
        let mut counts = self.0.lock();
        if let Some([requests, all_bytes]) = counts.get_mut(user) {
            *requests -= 1;
            *all_bytes -= bytes;
            if *requests == 0 {
                counts.remove(user);
            }
        }
    }
}

impl Admission {
    /// Admits a request of so many bytes, unless the limits are reached. `unanswered` counts the
    /// requests to its queryable.
    pub fn admit(&self, bytes: usize, user: User, unanswered: &Unanswered) -> Option<Permit> {
        let [to_queryable, _] = unanswered.add(&user, bytes);
        let [of_user, bytes_of_user] = self.requests.add(&user, bytes);
        let all_bytes = self.bytes.fetch_add(bytes, Ordering::Relaxed);
        let is_over_share = user.is_some()
            && (of_user >= MAX_UNANSWERED_OF_USER
                || (bytes > 0 && bytes_of_user >= MAX_UNANSWERED_BYTES_OF_USER));
        let is_full =
            to_queryable >= MAX_UNANSWERED || (bytes > 0 && all_bytes >= MAX_UNANSWERED_BYTES);
        // Dropping it restores the counts.
        let permit = Permit {
            bytes,
            user,
            all_bytes: self.bytes.clone(),
            requests: [unanswered.clone(), self.requests.clone()],
        };
        (!is_full && !is_over_share).then_some(permit)
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.all_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
        for requests in &self.requests {
            requests.remove(&self.user, self.bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Requests of a user to a queryable, until one is rejected.
    fn fill(
        admission: &Admission,
        (user, bytes): (Option<&str>, usize),
        unanswered: &Unanswered,
    ) -> Vec<Permit> {
        let admit = || admission.admit(bytes, user.map(Arc::from), unanswered);
        std::iter::from_fn(admit).take(10_000).collect()
    }

    #[test]
    fn a_user_takes_no_place_of_another() {
        let (admission, status) = (Admission::default(), Unanswered::default());
        let permits = fill(&admission, (Some("ada"), 0), &status);
        assert_eq!(permits.len(), 128);
        assert_eq!(fill(&admission, (Some("bob"), 0), &status).len(), 128);
        drop(permits);
        assert_eq!(fill(&admission, (Some("ada"), 0), &status).len(), 128);
        // All swarms together.
        let all: Vec<Permit> = (0..20)
            .flat_map(|_| fill(&admission, (Some("ada"), 0), &Unanswered::default()))
            .collect();
        assert_eq!(all.len(), 512);
        assert_eq!(fill(&admission, (Some("bob"), 0), &status).len(), 128);
    }

    #[test]
    fn a_user_takes_a_quarter_of_the_bytes_and_one_request_more() {
        let admission = Admission::default();
        let mebibytes = |count: usize| count << 20;
        let all = || Unanswered::default();
        let ada = fill(&admission, (Some("ada"), mebibytes(1)), &all());
        assert_eq!(ada.len(), 16);
        let bob = fill(&admission, (Some("bob"), mebibytes(100)), &all());
        assert_eq!(bob.len(), 1);
        // The daemon has no space for more, except for requests without a payload.
        assert_eq!(fill(&admission, (Some("eve"), 1), &all()).len(), 0);
        assert_eq!(fill(&admission, (Some("eve"), 0), &all()).len(), 128);
        drop((ada, bob));
        assert_eq!(
            fill(&admission, (Some("eve"), mebibytes(1)), &all()).len(),
            16
        );
    }

    #[test]
    fn without_users_all_are_one() {
        let (admission, status) = (Admission::default(), Unanswered::default());
        assert_eq!(fill(&admission, (None, 0), &status).len(), 128);
        let all: Vec<Permit> = (0..20)
            .flat_map(|_| fill(&admission, (None, 0), &Unanswered::default()))
            .collect();
        assert_eq!(all.len(), 20 * 128);
    }
}
