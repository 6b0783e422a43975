//! The page token: a secret that the daemon prints when it starts, and that commands need.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{self, Path, PathBuf};

use crate::auth::secret;

/// Its file in the data directory, so that open pages stay valid after a restart of the daemon.
const FILE: &str = "page-token";

const BYTES: usize = 16;

/// The secret, in hexadecimal digits, and its file. Has no `Debug`, so that it is never logged.
#[derive(Clone)]
pub struct Token {
    secret: String,
    /// The absolute path of its file.
    pub(super) file: PathBuf,
    /// Whether reading its file takes root, since it belongs to a service account.
    pub(super) needs_root: bool,
}

impl Token {
    /// The absolute path of the token of a data directory.
    pub fn file_in(data_dir: &Path) -> PathBuf {
        let file = data_dir.join(FILE);
        path::absolute(&file).unwrap_or(file)
    }

    /// The token of a data directory. Creates one if there is none or it is damaged.
    pub fn of(data_dir: &Path) -> io::Result<Self> {
        let file = Self::file_in(data_dir);
        let stored = match fs::read_to_string(&file) {
            Ok(text) => Some(text.trim().to_owned()).filter(|text| is_whole(text)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let secret = match stored {
            Some(secret) => secret,
            None => {
                let drawn = secret::random_hex(BYTES)?;
                secret::write(&file, &format!("{drawn}\n"))?;
                drawn
            }
        };
        let needs_root = !is_login_account(fs::metadata(&file)?.uid());
        Ok(Token {
            secret,
            file,
            needs_root,
        })
    }

    /// The secret.
    pub fn text(&self) -> &str {
        &self.secret
    }

    /// Compares in constant time, as hashes do.
    pub fn is(&self, given: &str) -> bool {
        blake3::hash(given.as_bytes()) == blake3::hash(self.secret.as_bytes())
    }
}

/// Whether a uid is that of a login account: not root, a system user or a systemd dynamic user.
fn is_login_account(uid: u32) -> bool {
    const MIN_LOGIN: u32 = 1000;
    const DYNAMIC_AND_NOBODY: std::ops::RangeInclusive<u32> = 61_184..=65_535;
    uid >= MIN_LOGIN && !DYNAMIC_AND_NOBODY.contains(&uid)
}

fn is_whole(text: &str) -> bool {
    text.len() == 2 * BYTES && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_token_survives_a_restart_and_only_its_owner_can_read_it() {
        let folder = tempfile::tempdir().unwrap();
        let first = Token::of(folder.path()).unwrap();
        assert_eq!(Token::of(folder.path()).unwrap().text(), first.text());
        let path = folder.path().join(FILE);
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        fs::write(&path, &first.text()[..7]).unwrap();
        let second = Token::of(folder.path()).unwrap();
        assert!(is_whole(second.text()) && second.text() != first.text());
    }

    #[test]
    fn root_system_users_and_dynamic_users_are_no_login_accounts() {
        for service in [0, 104, 999, 61_184, 65_534] {
            assert!(!is_login_account(service), "{service}");
        }
        for login in [1000, 1001, 60_001, 100_000, 1_500_000_000] {
            assert!(is_login_account(login), "{login}");
        }
    }

    #[test]
    fn only_the_whole_token_is_accepted() {
        let token = Token {
            secret: "0123456789abcdef0123456789abcdef".into(),
            file: PathBuf::new(),
            needs_root: false,
        };
        assert!(token.is(token.text()));
        let nearly = &token.text()[1..];
        for wrong in ["", nearly, &format!("0{nearly}0"), &format!("1{nearly}")] {
            assert!(!token.is(wrong), "{wrong:?}");
        }
    }
}
