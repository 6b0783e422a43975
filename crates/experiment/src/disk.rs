//! The disk space that an execution may use.

use std::fmt;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

/// Returns whether so many more bytes may be written, or why not.
type HasRoom = Box<dyn Fn(u64) -> Result<(), String> + Send + Sync>;

/// Counts the bytes that an execution writes, and stops it before the space that it may use ends.
pub struct DiskWatch {
    has_room: HasRoom,
    /// The bytes between two checks.
    interval: u64,
    grown: AtomicI64,
    unchecked: AtomicU64,
    /// Why nothing more may be written.
    full: OnceLock<String>,
}

impl DiskWatch {
    /// Returns a watch that asks `has_room` once in `interval` bytes, from the threads of the runs.
    pub fn new(
        interval: u64,
        has_room: impl Fn(u64) -> Result<(), String> + Send + Sync + 'static,
    ) -> Self {
        Self {
            has_room: Box::new(has_room),
            interval,
            grown: AtomicI64::new(0),
            unchecked: AtomicU64::new(0),
            full: OnceLock::new(),
        }
    }

    /// Returns the bytes that were written less those that were removed.
    #[must_use]
    pub fn grown(&self) -> i64 {
        self.grown.load(Ordering::Relaxed)
    }

    /// Returns why nothing more may be written, if so.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        self.full.get().map(String::as_str)
    }

    /// Counts bytes that were written. Returns whether more may be.
    pub(crate) fn add(&self, bytes: u64) -> bool {
        if bytes > 0 {
            self.grown.fetch_add(signed(bytes), Ordering::Relaxed);
            let unchecked = self.unchecked.fetch_add(bytes, Ordering::Relaxed) + bytes;
            if unchecked >= self.interval {
                return self.has_room(0);
            }
        }
        self.full.get().is_none()
    }

    /// Counts bytes that were removed.
    pub(crate) fn remove(&self, bytes: u64) {
        self.grown.fetch_sub(signed(bytes), Ordering::Relaxed);
    }

    /// Returns whether so many bytes may be written. Once this is false it remains so.
    pub(crate) fn has_room(&self, bytes: u64) -> bool {
        self.unchecked.store(0, Ordering::Relaxed);
        if self.full.get().is_none()
            && let Err(reason) = (self.has_room)(bytes)
        {
            let _ = self.full.set(reason);
        }
        self.full.get().is_none()
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

impl fmt::Debug for DiskWatch {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (grown, full) = (self.grown(), self.reason());
        write!(to, "DiskWatch {{ grown: {grown}, full: {full:?} }}")
    }
}
