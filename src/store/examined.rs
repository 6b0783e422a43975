//! A store that is only read, and whose folder is not changed: neither a lock nor a file of the WAL is
//! written, and the daemon that uses it does not wait.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use parking_lot::Mutex;

use super::error::{StoreError, StoreFault};
use super::{Inner, MAX_CHECKED_BYTES, RESTORING, Shared, Store, schema};

impl Store {
    /// Opens the store in `folder` to read it, and changes nothing there; the daemon that uses it may run. Commits
    /// to it fail.
    ///
    /// # Errors
    ///
    /// Those of [`Store::open`], with which it would not start; but for [`StoreError::InUse`].
    pub fn examine(folder: &Path) -> Result<Store, StoreError> {
        if folder.join(RESTORING).exists() {
            return Err(StoreError::Unrestored(folder.to_path_buf()));
        }
        let file = folder.join(schema::FILE);
        let reader = schema::open_unchanged(&file)?;
        schema::check_origin(&file, &reader)?;
        if fs::metadata(&file).is_ok_and(|file| file.len() <= MAX_CHECKED_BYTES) {
            schema::check_pages(&file, &reader)?;
        }
        let shared = Arc::<Shared>::default();
        shared.queue.end(StoreFault::Stopped);
        Ok(Store(Arc::new(Inner {
            file,
            data_id: None,
            shared,
            reader: Mutex::new(Some(reader)),
            thread: None,
        })))
    }
}
