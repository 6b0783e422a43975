//! The verifications that run or are queued, and their progress.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;

/// The verifications under way.
#[derive(Default)]
pub struct Verifications(Mutex<State>);

#[derive(Default)]
struct State {
    /// By their numbers: the swarm, and the share of its history that is replayed.
    entries: BTreeMap<u64, (Arc<str>, f64)>,
    /// The number of the next one.
    number: u64,
}

/// A verification under way; it ends when this is dropped.
pub struct Verification {
    all: Arc<Verifications>,
    number: u64,
}

impl Verifications {
    /// Begins the verification of a swarm.
    pub fn begin(self: &Arc<Self>, swarm: &Arc<str>) -> Verification {
        let mut state = self.0.lock();
        let number = state.number;
        state.number += 1;
        state.entries.insert(number, (swarm.clone(), 0.0));
        Verification {
            all: self.clone(),
            number,
        }
    }

    /// How far the verification of a swarm has come, from 0 to 1; the one that is furthest, if
    /// there are several.
    pub fn share(&self, swarm: &str) -> Option<f64> {
        let state = self.0.lock();
        let of_swarm = state.entries.values().filter(|(name, _)| &**name == swarm);
        of_swarm.map(|(_, share)| *share).max_by(f64::total_cmp)
    }
}

impl Verification {
    /// Records how far it has come.
    pub fn advance(&self, share: f64) {
        if let Some((_, before)) = self.all.0.lock().entries.get_mut(&self.number) {
            *before = share;
        }
    }
}

impl Drop for Verification {
    fn drop(&mut self) {
        self.all.0.lock().entries.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_a_swarm_is_of_the_verification_that_is_furthest() {
        let all = Arc::new(Verifications::default());
        let [one, other] = ["a", "a"].map(|swarm| all.begin(&swarm.into()));
        assert_eq!((all.share("a"), all.share("b")), (Some(0.0), None));
        one.advance(0.5);
        other.advance(0.25);
        assert_eq!(all.share("a"), Some(0.5));
        drop(one);
        assert_eq!(all.share("a"), Some(0.25));
        drop(other);
        assert_eq!(all.share("a"), None);
    }
}
