//! What whoever steers through the page shows: a secret that the daemon prints when it starts.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::rights::secret;

/// Its file in the data directory: a page that is open survives the daemon's restart.
const FILE: &str = "page-token";

const BYTES: usize = 16;

/// The secret, in hexadecimal digits. It is in no log: it has no `Debug`.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Where the token of a data directory is.
    pub fn file(data_dir: &Path) -> PathBuf {
        data_dir.join(FILE)
    }

    /// The token of a data directory; a new one if there is none, or none that is whole.
    ///
    /// # Errors
    ///
    /// When it can neither be read nor written.
    pub fn of(data_dir: &Path) -> io::Result<Self> {
        let path = Self::file(data_dir);
        match fs::read_to_string(&path) {
            Ok(text) if is_whole(text.trim()) => return Ok(Token(text.trim().to_owned())),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let text = secret::draw(BYTES)?;
        secret::write(&path, &format!("{text}\n"))?;
        Ok(Token(text))
    }

    /// What is printed for whoever started the daemon.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether it is this one. It takes as long whatever is wrong with it.
    pub fn is(&self, given: &str) -> bool {
        let (given, secret) = (given.as_bytes(), self.0.as_bytes());
        let differences = given.iter().zip(secret).map(|(a, b)| a ^ b);
        given.len() == secret.len() && differences.fold(0, |all, one| all | one) == 0
    }
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
    fn a_token_is_the_same_after_a_restart_and_nobody_elses_to_read() {
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
    fn only_the_whole_token_is_taken() {
        let token = Token("0123456789abcdef0123456789abcdef".into());
        assert!(token.is(token.text()));
        let nearly = &token.text()[1..];
        for wrong in ["", nearly, &format!("0{nearly}0"), &format!("1{nearly}")] {
            assert!(!token.is(wrong), "{wrong:?}");
        }
    }
}
