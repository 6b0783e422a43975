//! HTTP over TLS, for other machines: the daemon shows its certificate, people their tokens.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::serve::Listener;
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::server::TlsStream;

/// How long a connection may take to become a secure one.
const PATIENCE: Duration = Duration::from_secs(5);

/// Connections that may be becoming one at once.
const MOST: usize = 256;

/// How long to wait when the system has no room for another connection.
const REST: Duration = Duration::from_millis(100);

/// What the daemon shows: its certificate and key, as PEM files.
///
/// # Errors
///
/// When they cannot be read or do not belong together.
pub fn acceptor([certificate, key]: &[PathBuf; 2]) -> io::Result<TlsAcceptor> {
    let chain = CertificateDer::pem_file_iter(certificate).map_err(io::Error::other)?;
    let chain: Result<Vec<_>, _> = chain.collect();
    let key = PrivateKeyDer::from_pem_file(key).map_err(io::Error::other)?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(io::Error::other)?
        .with_no_client_auth()
        .with_single_cert(chain.map_err(io::Error::other)?, key)
        .map_err(io::Error::other)?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Connections that have become secure ones.
pub struct Secure {
    address: SocketAddr,
    ready: mpsc::Receiver<(TlsStream<TcpStream>, SocketAddr)>,
}

impl Secure {
    /// Takes connections, each becoming secure beside the others: a silent one holds up nobody.
    ///
    /// # Errors
    ///
    /// When the listener does not know its address.
    pub fn on(listener: TcpListener, acceptor: TlsAcceptor) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let (done, ready) = mpsc::channel(MOST);
        tokio::spawn(async move {
            let places = Arc::new(Semaphore::new(MOST));
            while let Ok(place) = places.clone().acquire_owned().await
                && !done.is_closed()
            {
                let Ok((stream, peer)) = listener.accept().await else {
                    sleep(REST).await;
                    continue;
                };
                let (acceptor, done) = (acceptor.clone(), done.clone());
                tokio::spawn(async move {
                    let secured = timeout(PATIENCE, acceptor.accept(stream)).await;
                    if let Ok(Ok(stream)) = secured {
                        // Nobody takes it any more when the daemon goes.
                        let _ = done.send((stream, peer)).await;
                    }
                    drop(place);
                });
            }
        });
        Ok(Secure { address, ready })
    }
}

impl Listener for Secure {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        match self.ready.recv().await {
            Some(connection) => connection,
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}
