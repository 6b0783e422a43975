//! The id of the data in a data folder: by it clients know that a daemon that was restarted still has the
//! replies to their commands.

use std::fs;
use std::io;
use std::path::Path;

use tracing::warn;

use crate::auth::secret;

/// Its file in the data folder. It is outside the database, and no backup has it: a restored backup may
/// lack replies that were sent, and gets an id of its own.
pub(super) const FILE: &str = "data-id";

const BYTES: usize = 16;

/// The id of the data in `folder`; draws one if it has none, it is damaged or the database is new. `None`
/// if it cannot be read or written, such as on a full disk: nothing but the retries of clients needs it.
pub(super) fn of(folder: &Path, is_new: bool) -> Option<String> {
    let of = || {
        let file = folder.join(FILE);
        if !is_new {
            match fs::read_to_string(&file) {
                Ok(text) if is_whole(text.trim()) => return Ok(text.trim().to_owned()),
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        let drawn = secret::random_hex(BYTES)?;
        secret::write(&file, &format!("{drawn}\n"))?;
        Ok(drawn)
    };
    match of() {
        Ok(id) => Some(id),
        Err(error) => {
            warn!(%error, file = FILE, "no id of the data: clients do not repeat commands after a restart");
            None
        }
    }
}

fn is_whole(text: &str) -> bool {
    text.len() == 2 * BYTES && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn an_id_stays_until_the_database_is_new_or_it_is_damaged() {
        let folder = tempfile::tempdir().unwrap();
        let first = of(folder.path(), true).unwrap();
        assert!(is_whole(&first));
        assert_eq!(of(folder.path(), false).as_ref(), Some(&first));
        let second = of(folder.path(), true).unwrap();
        assert_ne!(second, first, "a new database");
        fs::write(folder.path().join(FILE), &second[..20]).unwrap();
        let third = of(folder.path(), false).unwrap();
        assert!(is_whole(&third));
        assert_ne!(third, second, "a damaged file");
    }

    #[test]
    fn a_folder_that_cannot_be_written_has_no_id() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(FILE)).unwrap();
        assert_eq!(of(folder.path(), false), None);
    }
}
