//! Where each swarm's history begins, so that asking costs no look into the file.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::catalog::{Catalog, Entry};
use super::record::Mark;

/// A swarm's number in the file and that of its oldest checkpoint.
pub(super) type Place = (i64, u64);

/// Where a history begins, and what is there if somebody has looked.
type Beginning = (Place, Option<Option<Mark>>);

/// The oldest checkpoints: which they are, and what is on them where somebody has looked.
#[derive(Default)]
pub(super) struct Beginnings(Mutex<BTreeMap<String, Beginning>>);

impl Beginnings {
    /// Notes where every history begins.
    pub(super) fn fill(&self, catalog: &Catalog) {
        for (swarm, entry) in &catalog.swarms {
            self.moved(swarm, Some(entry));
        }
    }

    /// Notes what a commit made of a swarm.
    pub(super) fn moved(&self, swarm: &str, entry: Option<&Entry>) {
        let mut known = self.lock();
        let place = entry.map(|entry| (entry.id, entry.extent.first));
        // The only one may have been replaced by a later one of its number.
        let is_only = entry.is_some_and(|entry| entry.extent.newest == entry.extent.first);
        match (place, known.get_mut(swarm)) {
            (Some(place), Some(old)) if old.0 == place && !is_only => {}
            (Some(place), Some(old)) => *old = (place, None),
            (Some(place), None) => _ = known.insert(swarm.to_owned(), (place, None)),
            (None, _) => _ = known.remove(swarm),
        }
    }

    /// The oldest checkpoint, or where it stands if nobody has looked at it.
    pub(super) fn find(&self, swarm: &str) -> Result<Option<Mark>, Option<Place>> {
        match self.lock().get(swarm) {
            Some((_, Some(mark))) => Ok(*mark),
            Some((place, None)) => Err(Some(*place)),
            None => Err(None),
        }
    }

    /// Notes what stands at `place`, unless the beginning has moved since.
    pub(super) fn learn(&self, swarm: &str, place: Place, mark: Option<Mark>) {
        if let Some(known) = self.lock().get_mut(swarm)
            && known.0 == place
        {
            known.1 = Some(mark);
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Beginning>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
