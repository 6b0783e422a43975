//! The verifications under way: at most so many at once, and how far each has come.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Verifications at once. Each replays a history on one core.
const MAX_VERIFICATIONS: usize = 4;

/// The verifications under way.
#[derive(Default)]
pub struct Verifications(Mutex<Vec<Entry>>);

struct Entry {
    number: u64,
    swarm: Arc<str>,
    share: f64,
}

/// A verification under way; it ends when this is dropped.
pub struct Verification {
    all: Arc<Verifications>,
    number: u64,
}

impl Verifications {
    /// Begins one, unless too many are under way.
    pub fn begin(self: &Arc<Self>, swarm: &Arc<str>) -> Option<Verification> {
        let mut entries = self.lock();
        if entries.len() >= MAX_VERIFICATIONS {
            return None;
        }
        let number = entries.last().map_or(0, |entry| entry.number + 1);
        entries.push(Entry {
            number,
            swarm: swarm.clone(),
            share: 0.0,
        });
        Some(Verification {
            all: self.clone(),
            number,
        })
    }

    /// How far the verification of a swarm has come, from 0 to 1; the one that is furthest, if
    /// there are several.
    pub fn share(&self, swarm: &str) -> Option<f64> {
        let entries = self.lock();
        let of_swarm = entries.iter().filter(|entry| &*entry.swarm == swarm);
        of_swarm.map(|entry| entry.share).max_by(f64::total_cmp)
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Verification {
    /// Records how far it has come.
    pub fn advance(&self, share: f64) {
        let mut entries = self.all.lock();
        let mut own = entries.iter_mut();
        if let Some(entry) = own.find(|entry| entry.number == self.number) {
            entry.share = share;
        }
    }
}

impl Drop for Verification {
    fn drop(&mut self) {
        self.all.lock().retain(|entry| entry.number != self.number);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn each_swarm_has_its_share_until_its_verification_ends() {
        let all = Arc::new(Verifications::default());
        let (a, b): (Arc<str>, Arc<str>) = ("a".into(), "b".into());
        assert_eq!(all.share("a"), None);
        let first = all.begin(&a).unwrap();
        let second = all.begin(&a).unwrap();
        let other = all.begin(&b).unwrap();
        first.advance(0.5);
        other.advance(0.25);
        assert_eq!((all.share("a"), all.share("b")), (Some(0.5), Some(0.25)));
        drop(first);
        assert_eq!(all.share("a"), Some(0.0), "the second one is under way");
        let more: Vec<_> = std::iter::from_fn(|| all.begin(&b)).collect();
        assert_eq!(more.len(), MAX_VERIFICATIONS - 2);
        drop((second, other, more));
        assert_eq!((all.share("a"), all.share("b")), (None, None));
        assert!(all.begin(&a).is_some());
    }
}
