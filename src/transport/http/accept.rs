//! The accept loop: one task per connection, over TLS if there is an acceptor.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::header::CONNECTION;
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use fail::fail_point;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;

use crate::transport::http::connections::{CloseReason, Connections, Slot};

/// The time for a TLS handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// The time for the whole header of a request, from the end of the response before it.
const HEADER_TIMEOUT: Duration = Duration::from_secs(5);

/// The time for the whole body of a request.
const BODY_TIMEOUT: Duration = Duration::from_secs(10);

/// The pause after a failed accept, for example without a free descriptor.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// The shortest interval between two log lines about failed accepts.
const LOG_INTERVAL: Duration = Duration::from_secs(60);

/// Accepts connections and serves `router` on each, until the future is dropped. Then each open
/// connection is closed after the request that is in progress.
pub async fn accept(
    listener: TcpListener,
    acceptor: Option<TlsAcceptor>,
    router: Router,
    connections: Arc<Connections>,
) {
    let (_running, stopped) = watch::channel(());
    let mut logged = None;
    loop {
        fail_point!("http-accept", |_| ());
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                record_failure(&error, &connections, &mut logged);
                sleep(ACCEPT_RETRY).await;
                continue;
            }
        };
        let Some(slot) = connections.register(peer.ip()) else {
            // Only WebSockets are open: the connection is closed.
            continue;
        };
        let (acceptor, router, stopped) = (acceptor.clone(), router.clone(), stopped.clone());
        tokio::spawn(async move {
            tokio::select! {
                () = serve(stream, acceptor, router, slot.clone(), stopped) => {}
                () = slot.evicted() => {}
            }
        });
    }
}

async fn serve(
    stream: TcpStream,
    acceptor: Option<TlsAcceptor>,
    router: Router,
    slot: Arc<Slot>,
    stopped: watch::Receiver<()>,
) {
    let Some(acceptor) = acceptor else {
        return serve_http(stream, router, slot, stopped).await;
    };
    match timeout(HANDSHAKE_TIMEOUT, acceptor.accept(stream)).await {
        Ok(Ok(stream)) => serve_http(stream, router, slot, stopped).await,
        // The client has gone, or does not speak TLS.
        Ok(Err(_)) => {}
        Err(_) => slot.connections.count_closed(CloseReason::HandshakeTimeout),
    }
}

/// Serves HTTP until the connection is closed or upgraded.
async fn serve_http<Stream>(
    stream: Stream,
    router: Router,
    slot: Arc<Slot>,
    mut stopped: watch::Receiver<()>,
) where
    Stream: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let router = TowerToHyperService::new(router);
    let served = slot.clone();
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(served.clone());
        router.call(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    tokio::select! {
        // An error is the client's: it has gone, timed out, or does not speak HTTP.
        ended = connection.as_mut() => {
            if ended.is_err_and(|error| error.is_timeout()) {
                slot.connections.count_closed(CloseReason::HeaderTimeout);
            }
            return;
        }
        // The sender is dropped with the accept loop.
        _ = stopped.changed() => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = connection.await;
}

/// Middleware that records each request and its response in the registry of connections.
pub async fn record_completion(request: Request, next: Next) -> Response {
    let slot = request.extensions().get::<Arc<Slot>>().cloned();
    if let Some(slot) = &slot {
        slot.begin();
    }
    let response = next.run(request).await;
    if let Some(slot) = slot {
        slot.complete();
    }
    response
}

/// The body of a request, which is read within [`BODY_TIMEOUT`], or the response if it is not.
pub async fn read_body(request: Request) -> Result<Bytes, Response> {
    let slot = request.extensions().get::<Arc<Slot>>().cloned();
    match timeout(BODY_TIMEOUT, Bytes::from_request(request, &())).await {
        Ok(body) => body.map_err(IntoResponse::into_response),
        Err(_) => {
            if let Some(slot) = slot {
                slot.connections.count_closed(CloseReason::BodyTimeout);
            }
            let message = format!("the body did not arrive within {BODY_TIMEOUT:?}\n");
            let close = [(CONNECTION, HeaderValue::from_static("close"))];
            Err((StatusCode::REQUEST_TIMEOUT, close, message).into_response())
        }
    }
}

/// Counts an accept that failed, and logs it unless another was logged lately.
fn record_failure(error: &std::io::Error, connections: &Connections, logged: &mut Option<Instant>) {
    let failures = connections.count_accept_failure();
    if logged.is_none_or(|at| at.elapsed() >= LOG_INTERVAL) {
        *logged = Some(Instant::now());
        tracing::warn!(%error, failures, "cannot accept HTTP connections");
    }
}
