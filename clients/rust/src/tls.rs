//! Why a TLS connection failed, when the daemon's certificate is for other names.

use std::net::{IpAddr, TcpStream, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{CertificateError, ClientConfig, ClientConnection, RootCertStore};

/// How long connecting, and each part of the handshake, may take.
const TIMEOUT: Duration = Duration::from_secs(1);

/// A certificate of the right authority for other names.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct WrongName {
    /// The name or address that was connected to.
    pub host: String,
    /// The names and addresses that the certificate is for.
    pub names: Vec<String>,
}

/// Connects to `endpoint`, trusting the authority in the file `ca`, and returns the names of the
/// certificate if they are the reason why the connection fails.
pub(crate) fn wrong_name(endpoint: &str, ca: &Path) -> Option<WrongName> {
    let address = endpoint.strip_prefix("tls/")?;
    let address = address.split(['?', '#']).next()?;
    let (host, _) = address.rsplit_once(':')?;
    let host = host
        .trim_start_matches('[')
        .trim_end_matches(']')
        .to_owned();
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(ca).ok()?).ok()?;
    let config =
        ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .ok()?
            .with_root_certificates(roots)
            .with_no_client_auth();
    let name = ServerName::try_from(host.clone()).ok()?;
    let mut connection = ClientConnection::new(Arc::new(config), name).ok()?;
    let mut addresses = address.to_socket_addrs().ok()?;
    let mut stream =
        addresses.find_map(|address| TcpStream::connect_timeout(&address, TIMEOUT).ok())?;
    stream.set_read_timeout(Some(TIMEOUT)).ok()?;
    stream.set_write_timeout(Some(TIMEOUT)).ok()?;
    // The client checks the name before the daemon requests the client's own certificate.
    while connection.is_handshaking() {
        if let Err(error) = connection.complete_io(&mut stream) {
            let error = error.get_ref()?.downcast_ref::<rustls::Error>()?;
            return match error {
                rustls::Error::InvalidCertificate(CertificateError::NotValidForNameContext {
                    presented,
                    ..
                }) => Some(WrongName {
                    host,
                    names: presented.iter().map(|it| bare(it)).collect(),
                }),
                _ => None,
            };
        }
    }
    None
}

/// The name in `DnsName("lab.example")` or `IpAddress(10.0.0.1)`.
fn bare(presented: &str) -> String {
    let inner = presented
        .split_once('(')
        .map_or(presented, |(_, inner)| inner);
    let inner = inner.trim_end_matches(')').trim_matches('"');
    let address = inner.parse::<IpAddr>();
    address.map_or_else(|_| inner.to_owned(), |address| address.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_without_their_kind() {
        for (presented, name) in [
            ("DnsName(\"lab.example\")", "lab.example"),
            ("IpAddress(10.0.0.1)", "10.0.0.1"),
            ("IpAddress(0000:0000:0000:0000:0000:0000:0000:0001)", "::1"),
        ] {
            assert_eq!(bare(presented), name);
        }
    }
}
