//! TLS for clients on other machines; they authenticate with tokens.

use std::path::PathBuf;
use std::sync::Arc;

use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use thiserror::Error;
use time::OffsetDateTime;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::client::WebPkiServerVerifier;
use tokio_rustls::rustls::client::danger::ServerCertVerifier as _;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::{CertificateError, Error, RootCertStore, ServerConfig};

use crate::auth::address::OWN_NAMES;
use crate::auth::folder::Folder;

/// Why the daemon's certificate cannot be used.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot serve over TLS: {}: {problem}: {}", path.display(), remedy(folder))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
        /// The folder of the users.
        folder: Folder,
    },
    /// The key is that of another certificate, or of an unknown kind.
    #[error(
        "cannot serve over TLS with {} and {}: {problem}: {}",
        .folder.daemon()[0].display(), .folder.daemon()[1].display(), remedy(folder)
    )]
    Pair {
        /// The error of TLS.
        problem: Error,
        /// The folder of the users.
        folder: Folder,
    },
    /// The authority of the users' folders has not signed it.
    #[error(
        "clients would reject {}, which {} has not signed ({problem}): {}",
        .folder.daemon()[0].display(), .folder.authority()[0].display(), remedy(folder)
    )]
    OtherAuthority {
        /// The error of the verification.
        problem: CertificateError,
        /// The folder of the users.
        folder: Folder,
    },
}

fn remedy(folder: &Folder) -> String {
    format!(
        "`jostled auth address --auth-dir {} --host NAME` with each name of the daemon issues a new \
         certificate",
        folder.path().display()
    )
}

/// An acceptor with the daemon's certificate and key.
pub fn acceptor(folder: &Folder) -> Result<TlsAcceptor, TlsError> {
    let [_, key] = folder.daemon();
    let key = PrivateKeyDer::from_pem_file(&key).map_err(|error| TlsError::Unreadable {
        path: key,
        problem: error.to_string(),
        folder: folder.clone(),
    })?;
    let chain = certificates(folder, folder.daemon()[0].clone())?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|it| it.with_no_client_auth().with_single_cert(chain, key));
    let config = config.map_err(|problem| TlsError::Pair {
        problem,
        folder: folder.clone(),
    })?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Checks the daemon's certificate as its clients do. Returns a warning if it is valid at another time.
pub fn check_certificate(folder: &Folder) -> Result<Option<String>, TlsError> {
    acceptor(folder)?;
    let [authority, _] = folder.authority();
    let rejected = |problem| TlsError::OtherAuthority {
        problem,
        folder: folder.clone(),
    };
    let mut roots = RootCertStore::empty();
    for certificate in certificates(folder, authority)? {
        let added = roots.add(certificate);
        added.map_err(|_| rejected(CertificateError::BadEncoding))?;
    }
    let chain = certificates(folder, folder.daemon()[0].clone())?;
    let provider = Arc::new(ring::default_provider());
    let verifier = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build();
    let verifier = verifier.map_err(|_| rejected(CertificateError::UnknownIssuer))?;
    let name = ServerName::try_from(OWN_NAMES[0]);
    let name = name.map_err(|_| rejected(CertificateError::NotValidForName))?;
    let verify = |now| match verifier.verify_server_cert(&chain[0], &chain[1..], &name, &[], now) {
        Err(Error::InvalidCertificate(problem)) => Err(problem),
        _ => Ok(()),
    };
    let (when, valid_at) = match verify(UnixTime::now()) {
        Err(CertificateError::NotValidYetContext { not_before, .. }) => {
            ("is not valid before", not_before)
        }
        Err(CertificateError::ExpiredContext { not_after, .. }) => ("expired on", not_after),
        result => return result.map(|()| None).map_err(rejected),
    };
    verify(valid_at).map_err(rejected)?;
    let day = OffsetDateTime::from_unix_timestamp(valid_at.as_secs().cast_signed());
    let day = day.map(|it| it.date().to_string()).unwrap_or_default();
    Ok(Some(format!(
        "{} {when} {day} by the clock of this machine, and clients reject it: check the clock; {}",
        folder.daemon()[0].display(),
        remedy(folder)
    )))
}

/// The certificates in a file, at least one.
fn certificates(folder: &Folder, path: PathBuf) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let read = CertificateDer::pem_file_iter(&path);
    let problem = match read.and_then(Iterator::collect::<Result<Vec<_>, _>>) {
        Ok(chain) if !chain.is_empty() => return Ok(chain),
        Ok(_) => "it contains no certificate".to_owned(),
        Err(error) => error.to_string(),
    };
    Err(TlsError::Unreadable {
        path,
        problem,
        folder: folder.clone(),
    })
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::fs;

    use jostle_proto::Role;
    use rcgen::{CertificateParams, Issuer, KeyPair};
    use time::Duration;

    use super::*;
    use crate::auth::issue;

    fn folder() -> (tempfile::TempDir, Folder) {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::new(base.path().join("auth"));
        issue::init(&folder, &[], &[("olga".into(), Role::Operator)]).unwrap();
        (base, folder)
    }

    #[test]
    fn a_certificate_that_clients_would_reject_is_reported_with_its_file_and_the_remedy() {
        let (_base, own) = folder();
        let (_other_base, other) = folder();
        assert_eq!(check_certificate(&own).unwrap(), None);
        let reported = |what: &str, path: &PathBuf| {
            let error = check_certificate(&own).unwrap_err().to_string();
            for text in [
                what,
                path.to_str().unwrap(),
                "jostled auth address --auth-dir",
            ] {
                assert!(error.contains(text), "{text}: {error}");
            }
        };
        let [certificate, key] = own.daemon();
        let [other_certificate, other_key] = other.daemon();
        fs::copy(other_certificate, &certificate).unwrap();
        reported("KeyMismatch", &key);
        fs::copy(other_key, &key).unwrap();
        reported("has not signed", &certificate);
        fs::write(&certificate, "nonsense").unwrap();
        reported("it contains no certificate", &certificate);
        fs::write(&key, "nonsense").unwrap();
        reported("cannot serve over TLS", &key);
    }

    #[test]
    fn a_certificate_of_another_time_is_a_warning_with_its_file() {
        let (_base, folder) = folder();
        let [_, authority_key] = folder.authority();
        let authority_key = KeyPair::from_pem(&fs::read_to_string(authority_key).unwrap()).unwrap();
        let mut authority = CertificateParams::new(Vec::new()).unwrap();
        let name = (rcgen::DnType::CommonName, "jostle");
        authority.distinguished_name.push(name.0, name.1);
        let issuer = Issuer::new(authority, authority_key);
        let now = OffsetDateTime::now_utc();
        for (from, to, when) in [(10, 20, "is not valid before"), (-20, -10, "expired on")] {
            let mut params = CertificateParams::new([OWN_NAMES[0].to_owned()]).unwrap();
            params.not_before = now + Duration::days(from);
            params.not_after = now + Duration::days(to);
            let key = KeyPair::generate().unwrap();
            let [certificate, key_file] = folder.daemon();
            fs::write(&certificate, params.signed_by(&key, &issuer).unwrap().pem()).unwrap();
            fs::write(key_file, key.serialize_pem()).unwrap();
            let warning = check_certificate(&folder).unwrap().unwrap();
            let named = format!("{} {when}", certificate.display());
            assert!(warning.starts_with(&named), "{warning}");
            assert!(warning.contains("check the clock"), "{warning}");
        }
    }
}
