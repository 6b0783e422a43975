//! HTTP for those who watch the daemon: `/healthz` and `/metrics`.
//!
//! Only this machine reaches it, and only pages of this machine: a name that an attacker's page
//! resolves to 127.0.0.1 is refused by its `Host`. Nothing can be changed here, no body is taken,
//! and no other origin is let read.

mod text;

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, HOST, TRANSFER_ENCODING, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde_json::json;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use crate::health::Watch;

/// Why HTTP is not served.
#[derive(Debug, Error)]
pub enum GatewayError {
    /// It is no address.
    #[error("--http {0:?} is no address: give 127.0.0.1:PORT, or nothing to serve no HTTP")]
    NoAddress(String),
    /// An address that others could reach is not offered without authentication.
    #[error(
        "--http {0} can be reached from other machines: serve on 127.0.0.1:PORT and let others in \
         through a tunnel"
    )]
    NotLoopback(String),
    /// Nothing can be listened on.
    #[error(
        "cannot serve HTTP on {address}: {source}; `--http 127.0.0.1:0` takes a free port, \
         `--http ''` serves none"
    )]
    Listen {
        /// Where.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
}

/// A server that answers.
pub struct Gateway {
    address: SocketAddr,
    serving: JoinHandle<()>,
}

/// Reads where to serve, and checks that only this machine can reach it; nowhere if empty.
///
/// # Errors
///
/// [`GatewayError::NoAddress`] and [`GatewayError::NotLoopback`].
pub fn check(http: &str) -> Result<Option<SocketAddr>, GatewayError> {
    if http.is_empty() {
        return Ok(None);
    }
    let named = http.replacen("localhost:", "127.0.0.1:", 1);
    match named.parse::<SocketAddr>() {
        Ok(address) if address.ip().is_loopback() => Ok(Some(address)),
        Ok(_) => Err(GatewayError::NotLoopback(http.to_owned())),
        Err(_) => Err(GatewayError::NoAddress(http.to_owned())),
    }
}

impl Gateway {
    /// Takes the port, before anybody is told that the daemon is there.
    ///
    /// # Errors
    ///
    /// [`GatewayError::Listen`].
    pub async fn bind(address: SocketAddr) -> Result<TcpListener, GatewayError> {
        let listener = TcpListener::bind(address).await;
        listener.map_err(|source| GatewayError::Listen { address, source })
    }

    /// Serves what `watch` sees of the daemon of this name.
    ///
    /// # Errors
    ///
    /// When the listener does not know its address.
    pub fn serve(listener: TcpListener, node: &str, watch: Arc<Watch>) -> std::io::Result<Self> {
        let address = listener.local_addr()?;
        let router = Router::new()
            .route("/healthz", get(healthz))
            .route("/metrics", get(metrics))
            .with_state(Arc::new((node.to_owned(), watch)))
            .layer(from_fn(admit))
            .layer(map_response(harden));
        let serving = tokio::spawn(async move {
            // It ends only when it is stopped.
            let _ = axum::serve(listener, router).await;
        });
        Ok(Gateway { address, serving })
    }

    /// Where it serves.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers no more.
    pub fn stop(&self) {
        self.serving.abort();
    }
}

type Seen = State<Arc<(String, Arc<Watch>)>>;

async fn healthz(State(seen): Seen) -> Response {
    let (node, watch) = &*seen;
    let reasons = watch.reasons();
    let status = match reasons.is_empty() {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let told: Vec<_> = reasons
        .iter()
        .map(|reason| json!({"code": reason.code(), "message": reason.to_string()}))
        .collect();
    let document = json!({
        "healthy": reasons.is_empty(),
        "node": node,
        "uptime_secs": watch.uptime().as_secs_f64(),
        "reasons": told,
    });
    let json = [(CONTENT_TYPE, "application/json")];
    (status, json, format!("{document}\n")).into_response()
}

async fn metrics(State(seen): Seen) -> Response {
    let (_, watch) = &*seen;
    match text::of(watch.figures()) {
        Ok(text) => ([(CONTENT_TYPE, text::CONTENT_TYPE)], text).into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

/// Lets in who asks this machine by one of its own names, and brings nothing along.
async fn admit(request: Request, next: Next) -> Response {
    let headers = request.headers();
    let mut hosts = headers.get_all(HOST).iter();
    let is_ours = matches!((hosts.next(), hosts.next()), (Some(host), None) if is_own(host))
        && request.uri().host().is_none_or(is_own_name);
    if !is_ours {
        let told = "ask 127.0.0.1 or localhost by that name: the Host of this request is another\n";
        return (StatusCode::MISDIRECTED_REQUEST, told).into_response();
    }
    let length = headers.get(CONTENT_LENGTH);
    if length.is_some_and(|length| length != "0") || headers.contains_key(TRANSFER_ENCODING) {
        return (StatusCode::PAYLOAD_TOO_LARGE, "no body is taken here\n").into_response();
    }
    next.run(request).await
}

/// What holds for every answer: it is as of now, and it is what it says it is.
async fn harden(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    let plain = HeaderValue::from_static("nosniff");
    headers.insert(X_CONTENT_TYPE_OPTIONS, plain);
    response
}

/// Whether a `Host` is this machine, whatever the port: a tunnel may have another one.
fn is_own(host: &HeaderValue) -> bool {
    let Ok(host) = host.to_str() else {
        return false;
    };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.parse::<u16>().is_ok() && !host.ends_with(']') => name,
        _ => host,
    };
    is_own_name(name)
}

fn is_own_name(name: &str) -> bool {
    let bare = name.strip_prefix('[').and_then(|it| it.strip_suffix(']'));
    let address = bare.unwrap_or(name).parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|it| it.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_that_nobody_can_rebind_are_its_own() {
        for own in [
            "localhost",
            "LocalHost:8080",
            "127.0.0.1",
            "127.0.0.1:1",
            "127.9.9.9:80",
            "[::1]",
            "[::1]:8080",
        ] {
            assert!(is_own(&HeaderValue::from_static(own)), "{own}");
        }
        for foreign in [
            "",
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "localhost.evil.example:8080",
            "localhost:8080:8080",
            "10.0.0.1:8080",
            "0.0.0.0:8080",
            "[::]:8080",
            "[::1",
        ] {
            assert!(!is_own(&HeaderValue::from_static(foreign)), "{foreign}");
        }
    }

    #[test]
    fn only_addresses_of_this_machine_are_served_on() {
        assert!(matches!(check(""), Ok(None)));
        for local in ["127.0.0.1:8080", "localhost:0", "[::1]:1"] {
            assert!(matches!(check(local), Ok(Some(_))), "{local}");
        }
        for open in ["0.0.0.0:8080", "[::]:1", "10.0.0.1:8080"] {
            let refused = check(open);
            assert!(
                matches!(refused, Err(GatewayError::NotLoopback(_))),
                "{open}"
            );
        }
        for nothing in ["8080", ":8080", "example.org:80", "127.0.0.1"] {
            let refused = check(nothing);
            assert!(
                matches!(refused, Err(GatewayError::NoAddress(_))),
                "{nothing}"
            );
        }
    }
}
