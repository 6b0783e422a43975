//! Requests over HTTPS.

use std::net::SocketAddr;

use jostled::auth::folder::Folder;
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, ServerName};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::{self, RootCertStore};

/// A TLS connection to the name `localhost`; `None` if the certificate is not trusted.
pub async fn connect_tls(address: SocketAddr, trusted: &Folder) -> Option<TlsStream<TcpStream>> {
    connect_tls_by("localhost", address, trusted).await
}

/// A TLS connection to this name; `None` if the certificate is not trusted.
async fn connect_tls_by(
    name: &'static str,
    address: SocketAddr,
    trusted: &Folder,
) -> Option<TlsStream<TcpStream>> {
    let mut roots = RootCertStore::empty();
    let [authority, _] = trusted.authority();
    roots
        .add(CertificateDer::from_pem_file(authority).unwrap())
        .unwrap();
    let provider = std::sync::Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connector = TlsConnector::from(std::sync::Arc::new(config));
    let stream = TcpStream::connect(address).await.unwrap();
    let name = ServerName::try_from(name).unwrap();
    connector.connect(name, stream).await.ok()
}

/// Sends a request over TLS to the name `localhost`; `None` if the certificate is not trusted.
pub async fn https(address: SocketAddr, trusted: &Folder, request: &str) -> Option<String> {
    https_by("localhost", address, trusted, request).await
}

/// Sends a request over TLS to this name; `None` if the certificate is not trusted.
pub async fn https_by(
    name: &'static str,
    address: SocketAddr,
    trusted: &Folder,
    request: &str,
) -> Option<String> {
    let mut stream = connect_tls_by(name, address, trusted).await?;
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    // The server may close without a close_notify alert.
    let _ = stream.read_to_string(&mut answer).await;
    Some(answer)
}
