//! The limits of requests that have no reply yet.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use parking_lot::Mutex;

/// Maximum unanswered requests to one queryable, of a user where there are users; further ones are rejected
/// with `busy`. This many get a reply within a few milliseconds. The delay of requests to other swarms is
/// twice as long with 256, and no shorter with 64 or 16. A hundred concurrent requests are served.
const MAX_UNANSWERED: usize = 128;

/// Maximum unanswered requests of a user to all queryables: requests of others wait for no more of them.
const MAX_UNANSWERED_OF_USER: usize = 512;

/// Bytes of all unanswered requests; further ones are rejected with `busy`.
const MAX_UNANSWERED_BYTES: usize = 64 * 1024 * 1024;

/// Bytes of the unanswered requests of a user, beyond which further ones are rejected.
const MAX_UNANSWERED_BYTES_OF_USER: usize = MAX_UNANSWERED_BYTES / 4;

/// The longest request that is admitted beyond these bytes: the limits of the number of requests bound
/// what such requests take, so that an operator can still pause or cancel.
const SHORT_BYTES: usize = 1024;

/// The user as whose a request is counted: the name, empty for unknown ones; `None` without users.
pub type CountedAs = Option<Arc<str>>;

/// Counts by user; without users all are counted as those of one.
#[derive(Clone, Default)]
pub struct Unanswered(Arc<Mutex<HashMap<CountedAs, usize>>>);

/// Counts all unanswered requests, and their bytes.
#[derive(Default)]
pub struct Admission {
    all_bytes: Arc<AtomicUsize>,
    bytes: Unanswered,
    requests: Unanswered,
}

/// Counts a request as unanswered until it is dropped.
pub struct Permit {
    /// Its place among the requests to its queryable, and among those of its user.
    pub places: Places,
    /// Its bytes.
    pub bytes: HeldBytes,
}

/// Counts a request until it is dropped.
pub struct Places(#[expect(dead_code, reason = "counts until it is dropped")] [Counted; 2]);

/// Counts the bytes of a request until it is dropped.
pub struct HeldBytes {
    of_user: Counted,
    all: Arc<AtomicUsize>,
}

struct Counted {
    counts: Unanswered,
    user: CountedAs,
    amount: usize,
}

impl Unanswered {
    /// Counts for a user; returns the sum before, too.
    fn add(&self, user: &CountedAs, amount: usize) -> (Counted, usize) {
        let mut counts = self.0.lock();
        let count = counts.entry(user.clone()).or_default();
        let before = *count;
        *count += amount;
        let counted = Counted {
            counts: self.clone(),
            user: user.clone(),
            amount,
        };
        (counted, before)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        let mut counts = self.counts.0.lock();
        if let Some(count) = counts.get_mut(&self.user) {
            *count -= self.amount;
            if *count == 0 {
                counts.remove(&self.user);
            }
        }
    }
}

impl Drop for HeldBytes {
    fn drop(&mut self) {
        self.all.fetch_sub(self.of_user.amount, Ordering::Relaxed);
    }
}

impl Admission {
    /// Admits a request of so many bytes, unless the limits are reached. `unanswered` counts the
    /// requests to its queryable.
    pub fn admit(&self, bytes: usize, user: &CountedAs, unanswered: &Unanswered) -> Option<Permit> {
        let (to_queryable, requests_to_queryable) = unanswered.add(user, 1);
        let (to_all, requests_to_all) = self.requests.add(user, 1);
        let (of_user, bytes_of_user) = self.bytes.add(user, bytes);
        let all_bytes = self.all_bytes.fetch_add(bytes, Ordering::Relaxed);
        let is_short = bytes <= SHORT_BYTES;
        let is_over_share = user.is_some()
            && (requests_to_all >= MAX_UNANSWERED_OF_USER
                || (!is_short && bytes_of_user >= MAX_UNANSWERED_BYTES_OF_USER));
        let is_full = requests_to_queryable >= MAX_UNANSWERED
            || (!is_short && all_bytes >= MAX_UNANSWERED_BYTES);
        // Dropping it restores the counts.
        let permit = Permit {
            places: Places([to_queryable, to_all]),
            bytes: HeldBytes {
                of_user,
                all: self.all_bytes.clone(),
            },
        };
        (!is_full && !is_over_share).then_some(permit)
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
        let user = user.map(Arc::from);
        let admit = || admission.admit(bytes, &user, unanswered);
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
        // The daemon has no space for more, except for short requests.
        assert_eq!(fill(&admission, (Some("eve"), 1025), &all()).len(), 0);
        assert_eq!(fill(&admission, (Some("eve"), 1024), &all()).len(), 128);
        drop((ada, bob));
        assert_eq!(
            fill(&admission, (Some("eve"), mebibytes(1)), &all()).len(),
            16
        );
    }

    #[test]
    fn a_request_that_waits_takes_no_place_and_its_bytes_stay_counted() {
        let (admission, all) = (Admission::default(), Unanswered::default);
        let permits = fill(&admission, (Some("ada"), 1 << 20), &all());
        let waiting: Vec<HeldBytes> = permits.into_iter().map(|it| it.bytes).collect();
        assert_eq!(waiting.len(), 16);
        assert_eq!(fill(&admission, (Some("ada"), 1 << 20), &all()).len(), 0);
        assert_eq!(admission.requests.0.lock().len(), 0);
        drop(waiting);
        assert_eq!(fill(&admission, (Some("ada"), 1 << 20), &all()).len(), 16);
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
