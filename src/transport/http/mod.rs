//! HTTP: the page, what it watches and orders, and `/healthz` and `/metrics` for machines.
//!
//! Only this machine reaches it, unless people are known and it is served over TLS; and only its own
//! page: a name that an attacker's page resolves to 127.0.0.1 is refused by its `Host`, another page by
//! its `Origin`. Whoever changes something
//! shows the token that the daemon prints when it starts; where people are known, everybody who
//! sees more than the page itself and `/healthz` shows their own.

mod accept;
mod admit;
mod bus;
mod connections;
mod feed;
mod openmetrics;
mod page;
mod parameters;
mod pass;
mod secure;
mod socket;
mod token;

pub use bus::Bus;
pub use pass::Pass;
pub use secure::acceptor;
pub use token::Token;

use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Extension, Path, Query, RawQuery, State, WebSocketUpgrade};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{from_fn, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get, post};
use jostle_proto::{ErrorCode, Role, keys};
use serde::Deserialize;
use serde_json::json;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_rustls::TlsAcceptor;

use crate::health::Watch;
use crate::transport::http::accept::{WholeBody, accept, record_completion};
use crate::transport::http::admit::{Guests, MOST_BODY_BYTES, admit, harden};
use crate::transport::http::bus::{refuse, told_of};
use crate::transport::http::connections::{Connections, Slot, Sockets, max_connections};
use crate::transport::http::feed::Feeds;
use crate::transport::http::pass::PROTOCOL;

/// Why HTTP is not served.
#[derive(Debug, Error)]
pub enum GatewayError {
    /// It is no address.
    #[error(
        "--http {0:?} is no address: give 127.0.0.1:PORT, with an auth_dir https://ADDRESS:PORT, or \
         nothing to serve no HTTP"
    )]
    NoAddress(String),
    /// An address that others could reach is not offered in the clear.
    #[error(
        "--http {0} can be reached from other machines, and is not encrypted: serve on \
         https://ADDRESS:PORT, which takes an auth_dir (`jostled auth init` makes one), or on \
         127.0.0.1:PORT and let others in through a tunnel"
    )]
    NotLoopback(String),
    /// TLS without people.
    #[error(
        "--http {0} is for people who are known, and none are: name their folder as auth_dir \
         (`jostled auth init` makes one)"
    )]
    NobodyKnown(String),
    /// The daemon's certificate cannot be shown.
    #[error("cannot serve HTTP over TLS: {0}")]
    Certificate(std::io::Error),
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

/// Where HTTP is served, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The address.
    pub address: SocketAddr,
    /// Whether over TLS.
    pub is_secure: bool,
}

/// A server that answers.
pub struct Gateway {
    address: SocketAddr,
    is_secure: bool,
    serving: JoinHandle<()>,
}

/// Reads where to serve, and checks that only this machine can reach it, or only people who are
/// known, over TLS; nowhere if empty.
///
/// # Errors
///
/// [`GatewayError::NoAddress`], [`GatewayError::NotLoopback`] and [`GatewayError::NobodyKnown`].
pub fn check(http: &str, are_people_known: bool) -> Result<Option<Place>, GatewayError> {
    if http.is_empty() {
        return Ok(None);
    }
    let (bare, is_secure) = match http.strip_prefix("https://") {
        Some(bare) => (bare, true),
        None => (http.strip_prefix("http://").unwrap_or(http), false),
    };
    let named = bare.replacen("localhost:", "127.0.0.1:", 1);
    let address = named.parse::<SocketAddr>();
    let address = address.map_err(|_| GatewayError::NoAddress(http.to_owned()))?;
    match (is_secure, are_people_known) {
        (true, false) => Err(GatewayError::NobodyKnown(http.to_owned())),
        (false, _) if !address.ip().is_loopback() => {
            Err(GatewayError::NotLoopback(http.to_owned()))
        }
        _ => Ok(Some(Place { address, is_secure })),
    }
}

/// The scheme of a URL.
pub fn scheme(is_secure: bool) -> &'static str {
    if is_secure { "https" } else { "http" }
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

    /// Serves the page, and what `watch` sees of the daemon; over TLS by an `acceptor`.
    ///
    /// # Errors
    ///
    /// When the listener does not know its address.
    pub fn serve(
        listener: TcpListener,
        acceptor: Option<TlsAcceptor>,
        bus: Bus,
        pass: Pass,
        watch: Arc<Watch>,
    ) -> std::io::Result<Self> {
        let address = listener.local_addr()?;
        let is_secure = acceptor.is_some();
        let max_connections = max_connections();
        let connections = Connections::new(max_connections);
        let served = Served {
            connections: connections.clone(),
            feeds: Feeds::start(bus.clone()),
            bus,
            watch,
            pass,
            sockets: Sockets::new(max_connections),
        };
        let router = Router::new()
            .route("/healthz", get(healthz))
            .route("/metrics", get(metrics))
            .route("/api/hello", get(hello))
            .route("/api/get/{*rest}", get(look))
            .route("/api/cmd/{swarm}/{verb}", post(command))
            .route("/api/node/{verb}", post(node_command))
            .route("/api/ws", any(tab))
            .fallback(get(page::file))
            .layer(DefaultBodyLimit::max(MOST_BODY_BYTES))
            .with_state(Arc::new(served))
            .layer(from_fn_with_state(Guests { is_secure }, admit))
            .layer(map_response(harden))
            .layer(from_fn(record_completion));
        // It ends only when it is stopped.
        let serving = tokio::spawn(accept(listener, acceptor, router, connections));
        Ok(Gateway {
            address,
            is_secure,
            serving,
        })
    }

    /// Where it serves.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where it serves, as a browser takes it.
    pub fn url(&self) -> String {
        format!("{}://{}", scheme(self.is_secure), self.address)
    }

    /// Answers no more.
    pub fn stop(&self) {
        self.serving.abort();
    }
}

struct Served {
    bus: Bus,
    feeds: Arc<Feeds>,
    watch: Arc<Watch>,
    pass: Pass,
    sockets: Arc<Sockets>,
    connections: Arc<Connections>,
}

type Seen = State<Arc<Served>>;

impl Served {
    /// What somebody is answered who shows nothing that opens.
    fn unknown(&self) -> Response {
        let mut refusal = refuse(&told_of(ErrorCode::PermissionDenied, self.pass.remedy()));
        *refusal.status_mut() = StatusCode::UNAUTHORIZED;
        refusal
    }
}

async fn healthz(State(seen): Seen) -> Response {
    let (node, watch) = (&seen.bus.node, &seen.watch);
    let reasons = watch.reasons();
    let status = match reasons.is_empty() {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let told: Vec<_> = reasons
        .iter()
        .map(|reason| json!({"code": reason.code(), "message": reason.to_string()}))
        .collect();
    let warnings = watch.warnings();
    let warnings: Vec<_> = warnings
        .iter()
        .map(|warning| json!({"code": warning.code(), "message": warning.to_string()}))
        .collect();
    let document = json!({
        "healthy": reasons.is_empty(),
        "node": node,
        "uptime_secs": watch.uptime().as_secs_f64(),
        "reasons": told,
        "warnings": warnings,
    });
    let json = [(CONTENT_TYPE, "application/json")];
    (status, json, format!("{document}\n")).into_response()
}

async fn metrics(State(seen): Seen, headers: HeaderMap) -> Response {
    if !seen.pass.may_watch(&headers) {
        return seen.unknown();
    }
    let text = openmetrics::encode(seen.watch.figures(), seen.connections.figures());
    ([(CONTENT_TYPE, openmetrics::CONTENT_TYPE)], text).into_response()
}

async fn hello(State(seen): Seen, headers: HeaderMap) -> Response {
    let person = seen.pass.person(&headers);
    let role = person.as_ref().map(|person| person.role);
    let token = seen.pass.page_token();
    let document = json!({
        "node": seen.bus.node,
        "prefix": seen.bus.prefix,
        "version": env!("CARGO_PKG_VERSION"),
        "may_watch": seen.pass.may_watch(&headers),
        "may_command": seen.pass.may_command(&headers) && role.is_none_or(|it| it == Role::Operator),
        "person": person.map(|person| person.name),
        "role": role,
        "token_file": token.map(|token| token.file().display().to_string()),
        "token_needs_root": token.map(Token::needs_root),
    });
    let json = [(CONTENT_TYPE, jostle_proto::JSON)];
    (json, document.to_string()).into_response()
}

/// What changes nothing: a key with `get` in it, and a swarm's state.
async fn look(
    State(seen): Seen,
    Path(rest): Path<String>,
    RawQuery(parameters): RawQuery,
    headers: HeaderMap,
) -> Response {
    if !seen.pass.may_watch(&headers) {
        return seen.unknown();
    }
    let chunks: Vec<&str> = rest.split('/').collect();
    // The one get that operators alone may send.
    if chunks[..] == ["@node", "get", "recording"] && !seen.pass.may_command(&headers) {
        return seen.unknown();
    }
    let is_look = match chunks[..] {
        ["@node", "get", _] | [_, "get", _] | [_, "state"] => true,
        ["@node", "experiment", ..] => chunks.len() > 2,
        _ => false,
    };
    if !is_look {
        let told = format!("{rest:?} is nothing to look at: SWARM/get/… or @node/get/…");
        return refuse(&told_of(ErrorCode::NotFound, told));
    }
    let parameters = match parameters::selector(&parameters.unwrap_or_default()) {
        Ok(parameters) => parameters,
        Err(message) => return refuse(&told_of(ErrorCode::InvalidArgument, message)),
    };
    let token = seen.pass.token(&headers);
    match seen.bus.ask(&rest, &parameters, None, token).await {
        Ok(answer) => answer.into_response(),
        Err(error) => refuse(&error),
    }
}

async fn command(
    seen: Seen,
    Path((swarm, verb)): Path<(String, String)>,
    headers: HeaderMap,
    body: Result<WholeBody, Response>,
) -> Response {
    order(seen, &format!("{swarm}/cmd/{verb}"), &headers, body).await
}

async fn node_command(
    seen: Seen,
    Path(verb): Path<String>,
    headers: HeaderMap,
    body: Result<WholeBody, Response>,
) -> Response {
    order(seen, &format!("@node/cmd/{verb}"), &headers, body).await
}

/// What changes something: only with the token.
async fn order(
    State(seen): Seen,
    rest: &str,
    headers: &HeaderMap,
    body: Result<WholeBody, Response>,
) -> Response {
    if !seen.pass.may_command(headers) {
        return seen.unknown();
    }
    let body = match body {
        Ok(WholeBody(body)) => body,
        Err(rejection) => return rejection,
    };
    // What is under way goes on, whether or not the tab waits for it.
    let asked = tokio::spawn({
        let (seen, rest) = (seen.clone(), rest.to_owned());
        let token = seen.pass.token(headers).map(str::to_owned);
        async move { seen.bus.ask(&rest, "", Some(body), token.as_deref()).await }
    });
    match asked.await {
        Ok(Ok(answer)) => answer.into_response(),
        Ok(Err(error)) => refuse(&error),
        Err(_) => refuse(&told_of(ErrorCode::Internal, "the daemon is going")),
    }
}

/// Which swarm a tab watches beside the list.
#[derive(Deserialize)]
struct Tab {
    swarm: Option<String>,
}

async fn tab(
    State(seen): Seen,
    Query(tab): Query<Tab>,
    Extension(slot): Extension<Arc<Slot>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !seen.pass.may_watch(&headers) {
        return seen.unknown();
    }
    if let Some(swarm) = &tab.swarm
        && !keys::is_name(swarm)
    {
        let told = format!("{swarm:?} is no name of a swarm");
        return refuse(&told_of(ErrorCode::InvalidArgument, told));
    }
    let person = seen.pass.person(&headers);
    let name = person.as_ref().map(|person| person.name.as_str());
    let place = match seen.sockets.open(name) {
        Ok(place) => place,
        Err(message) => return refuse(&told_of(ErrorCode::ResourceExhausted, message)),
    };
    let feeds = seen.feeds.clone();
    let upgrade = upgrade.protocols([PROTOCOL]);
    let upgrade = upgrade.max_message_size(4096).max_frame_size(4096);
    upgrade.on_upgrade(async move |socket| {
        slot.upgrade();
        let revoked = seen.pass.revoked(&headers);
        socket::serve(socket, feeds, tab.swarm, place, revoked).await;
        drop(slot);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_this_machine_are_served_on() {
        assert!(matches!(check("", false), Ok(None)));
        for local in ["127.0.0.1:8080", "localhost:0", "[::1]:1", "http://[::1]:1"] {
            assert!(
                matches!(check(local, false), Ok(Some(place)) if !place.is_secure),
                "{local}"
            );
        }
        for secure in ["https://0.0.0.0:8443", "https://localhost:0"] {
            assert!(
                matches!(check(secure, true), Ok(Some(place)) if place.is_secure),
                "{secure}"
            );
            let refused = check(secure, false);
            assert!(
                matches!(refused, Err(GatewayError::NobodyKnown(_))),
                "{secure}"
            );
        }
        for open in [
            "0.0.0.0:8080",
            "[::]:1",
            "10.0.0.1:8080",
            "http://10.0.0.1:8080",
        ] {
            let refused = check(open, true);
            assert!(
                matches!(refused, Err(GatewayError::NotLoopback(_))),
                "{open}"
            );
        }
        for nothing in [
            "8080",
            ":8080",
            "example.org:80",
            "127.0.0.1",
            "https://",
            "ftp://127.0.0.1:1",
        ] {
            let refused = check(nothing, true);
            assert!(
                matches!(refused, Err(GatewayError::NoAddress(_))),
                "{nothing}"
            );
        }
    }
}
