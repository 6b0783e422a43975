//! What whoever steers through the page shows: a secret that the daemon prints when it starts.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;

/// Its file in the data directory: a page that is open survives the daemon's restart.
const FILE: &str = "page-token";

const BYTES: usize = 16;

/// The secret, in hexadecimal digits. It is in no log: it has no `Debug`.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// The token of a data directory; a new one if there is none, or none that is whole.
    ///
    /// # Errors
    ///
    /// When it can neither be read nor written.
    pub fn of(data_dir: &Path) -> io::Result<Self> {
        let path = data_dir.join(FILE);
        match fs::read_to_string(&path) {
            Ok(text) if is_whole(text.trim()) => return Ok(Token(text.trim().to_owned())),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let mut secret = [0; BYTES];
        fill(&mut secret)?;
        let text: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        // Written aside, so that what is cut off is never taken for a token.
        let aside = data_dir.join(format!("{FILE}.new"));
        match fs::remove_file(&aside) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let options = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&aside);
        let mut file = options?;
        writeln!(file, "{text}")?;
        file.sync_all()?;
        fs::rename(&aside, &path)?;
        Ok(Token(text))
    }

    /// What is printed for whoever started the daemon.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether a request brings it along, as `Authorization: Bearer`. It takes as long whatever is
    /// wrong with it.
    pub fn is_in(&self, headers: &HeaderMap) -> bool {
        let mut given = headers.get_all(AUTHORIZATION).iter();
        let (Some(given), None) = (given.next(), given.next()) else {
            return false;
        };
        let Some(given) = given.as_bytes().strip_prefix(b"Bearer ") else {
            return false;
        };
        let secret = self.0.as_bytes();
        let differences = given.iter().zip(secret).map(|(a, b)| a ^ b);
        given.len() == secret.len() && differences.fold(0, |all, one| all | one) == 0
    }
}

fn is_whole(text: &str) -> bool {
    text.len() == 2 * BYTES && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Fills `secret` with what nobody can guess.
fn fill(secret: &mut [u8]) -> io::Result<()> {
    io::Read::read_exact(&mut fs::File::open("/dev/urandom")?, secret)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::os::unix::fs::PermissionsExt;

    use axum::http::HeaderValue;

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
        let headers = |values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(AUTHORIZATION, HeaderValue::from_str(value).unwrap());
            }
            headers
        };
        let right = format!("Bearer {}", token.text());
        assert!(token.is_in(&headers(&[&right])));
        for wrong in [
            &headers(&[]),
            &headers(&["Bearer "]),
            &headers(&[token.text()]),
            &headers(&[&right[..right.len() - 1]]),
            &headers(&[&format!("{right}0")]),
            &headers(&[&right.replace('f', "e")]),
            &headers(&[&right, &right]),
        ] {
            assert!(!token.is_in(wrong), "{wrong:?}");
        }
    }
}
