//! The HTTP server: the page and its API, `/healthz`, `/livez` and `/metrics`.
//!
//! Without users it listens on loopback only. Requests with a foreign `Host` (DNS rebinding) or a
//! foreign `Origin` (another site) are rejected. Commands need the token that the daemon prints when
//! it starts; with users, everything but the page, `/healthz` and `/livez` needs the token of a user.

mod accept;
mod bus;
mod connections;
mod credentials;
mod evaluations;
mod feed;
mod openmetrics;
mod origin_guard;
mod page;
mod parameters;
mod socket;
mod tls;
mod token;

pub use bus::Bus;
pub use credentials::Credentials;
pub use tls::{TlsError, acceptor, check_certificate};
pub use token::Token;

use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{
    DefaultBodyLimit, Extension, Path, Query, RawQuery, Request, State, WebSocketUpgrade,
};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{from_fn, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{self, any, post};
use jostle_experiment::html::{Module, ModuleError};
use jostle_proto::{ErrorCode, Role, keys};
use serde::Deserialize;
use serde_json::json;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_rustls::TlsAcceptor;

use crate::health::{HealthMonitor, Reason};
use crate::lanes::Lanes;
use crate::transport::http::accept::{accept, read_body, record_completion};
use crate::transport::http::bus::{Reply, reject};
use crate::transport::http::connections::{Connections, Slot, max_connections};
use crate::transport::http::credentials::PROTOCOL;
use crate::transport::http::evaluations::Evaluations;
use crate::transport::http::feed::Feeds;
use crate::transport::http::origin_guard::{MAX_BODY_BYTES, check_origin, security_headers};

/// Why the server cannot start.
#[derive(Debug, Error)]
pub enum GatewayError {
    /// The address is invalid.
    #[error(
        "invalid --http {0:?}: use 127.0.0.1:PORT, https://ADDRESS:PORT with an auth_dir, or an empty \
         value for no server"
    )]
    NoAddress(String),
    /// An address that other machines can reach needs TLS.
    #[error(
        "--http {0} can be reached from other machines and is not encrypted: use \
         https://ADDRESS:PORT, which needs an auth_dir (`jostled auth init` makes one), or \
         127.0.0.1:PORT and a tunnel"
    )]
    NotLoopback(String),
    /// TLS needs users.
    #[error("--http {0} needs users: set auth_dir to their folder (`jostled auth init` makes one)")]
    NoUsers(String),
    /// The daemon's certificate cannot be used.
    #[error(transparent)]
    Certificate(#[from] TlsError),
    /// The module of the page cannot be used.
    #[error("wasm: {0}")]
    Module(#[from] ModuleError),
    /// The address cannot be bound.
    #[error("cannot serve HTTP on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The cause.
        source: std::io::Error,
    },
}

/// The address of the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListenAddress {
    /// The address.
    pub address: SocketAddr,
    /// Whether it uses TLS.
    pub is_secure: bool,
}

/// A running server.
pub struct Gateway {
    address: SocketAddr,
    is_secure: bool,
    serving: JoinHandle<()>,
}

/// Parses the setting `http`; empty is `None`. The address must be a loopback address, or use TLS and
/// have users.
///
/// # Errors
///
/// [`GatewayError::NoAddress`], [`GatewayError::NotLoopback`] and [`GatewayError::NoUsers`].
pub fn check(http: &str, has_users: bool) -> Result<Option<ListenAddress>, GatewayError> {
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
    match (is_secure, has_users) {
        (true, false) => Err(GatewayError::NoUsers(http.to_owned())),
        (false, _) if !address.ip().is_loopback() => {
            Err(GatewayError::NotLoopback(http.to_owned()))
        }
        _ => Ok(Some(ListenAddress { address, is_secure })),
    }
}

/// The scheme of a URL.
pub fn scheme(is_secure: bool) -> &'static str {
    if is_secure { "https" } else { "http" }
}

impl Gateway {
    /// Binds the port.
    ///
    /// # Errors
    ///
    /// [`GatewayError::Listen`].
    pub async fn bind(address: SocketAddr) -> Result<TcpListener, GatewayError> {
        let listener = TcpListener::bind(address).await;
        listener.map_err(|source| GatewayError::Listen { address, source })
    }

    /// Serves in a new task, over TLS with an `acceptor`. `lanes` evaluate the measures in
    /// `/metrics`; with the `module` the page verifies swarms.
    pub fn serve(
        listener: TcpListener,
        (acceptor, module): (Option<TlsAcceptor>, Option<Module>),
        bus: Bus,
        credentials: Credentials,
        watch: Arc<HealthMonitor>,
        lanes: Lanes,
    ) -> std::io::Result<Self> {
        let address = listener.local_addr()?;
        let is_secure = acceptor.is_some();
        let connections = Connections::new(max_connections());
        let server = Server {
            connections: connections.clone(),
            feeds: Feeds::start(bus.clone()),
            bus,
            watch,
            evaluations: Evaluations::new(lanes),
            credentials,
        };
        let router = Router::new()
            .route("/healthz", routing::get(healthz))
            .route("/livez", routing::get(livez))
            .route("/metrics", routing::get(metrics))
            .route("/api/hello", routing::get(hello))
            .route("/api/get/{*rest}", routing::get(get))
            .route("/api/cmd/{swarm}/{verb}", post(command))
            .route("/api/node/{verb}", post(node_command))
            .route("/api/ws", any(websocket))
            .route("/jostle.wasm", page::serve_module(module))
            .fallback(page::serve())
            .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
            .with_state(Arc::new(server))
            .layer(from_fn(move |request, next| {
                check_origin(is_secure, request, next)
            }))
            .layer(map_response(security_headers))
            .layer(from_fn(record_completion));
        let serving = tokio::spawn(accept(listener, acceptor, router, connections));
        Ok(Gateway {
            address,
            is_secure,
            serving,
        })
    }

    /// Its address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its URL.
    pub fn url(&self) -> String {
        format!("{}://{}", scheme(self.is_secure), self.address)
    }

    /// Stops accepting connections.
    pub fn stop(&self) {
        self.serving.abort();
    }
}

struct Server {
    bus: Bus,
    feeds: Arc<Feeds>,
    watch: Arc<HealthMonitor>,
    evaluations: Evaluations,
    credentials: Credentials,
    connections: Arc<Connections>,
}

type SharedServer = State<Arc<Server>>;

impl Server {
    /// Rejects a request without a valid token.
    #[expect(clippy::result_large_err, reason = "handlers return it as it is")]
    fn authorize(&self, is_valid: bool) -> Result<(), Response> {
        if is_valid {
            return Ok(());
        }
        let mut response = reject(ErrorCode::PermissionDenied, self.credentials.remedy());
        *response.status_mut() = StatusCode::UNAUTHORIZED;
        Err(response)
    }
}

/// Readiness: 503 also while it recovers its swarms.
async fn healthz(State(server): SharedServer) -> Response {
    health(&server, &server.watch.reasons())
}

/// Liveness: 503 only for what a restart would end.
async fn livez(State(server): SharedServer) -> Response {
    let mut reasons = server.watch.reasons();
    reasons.retain(Reason::needs_restart);
    health(&server, &reasons)
}

fn health(server: &Server, reasons: &[Reason]) -> Response {
    let (node, watch) = (&server.bus.node, &server.watch);
    let status = match reasons.is_empty() {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let listed = |code: &str, message: String| json!({"code": code, "message": message});
    let reason_list = reasons.iter().map(|it| {
        let mut listed = listed(it.code(), it.to_string());
        if let Reason::Recovering { swarms_left } = it {
            listed["swarms_left"] = json!(swarms_left);
        }
        listed
    });
    let warnings = watch.warnings().into_iter();
    let warnings = warnings.map(|(code, message)| listed(code, message));
    let document = json!({
        "healthy": reasons.is_empty(),
        "node": node,
        "uptime_secs": watch.uptime().as_secs_f64(),
        "reasons": reason_list.collect::<Vec<_>>(),
        "warnings": warnings.collect::<Vec<_>>(),
    });
    let json = [(CONTENT_TYPE, "application/json")];
    (status, json, format!("{document}\n")).into_response()
}

async fn metrics(
    State(server): SharedServer,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Response> {
    server.authorize(server.credentials.may_watch(&headers))?;
    let metrics = server.watch.metrics();
    server.evaluations.evaluate(&metrics).await;
    let text = openmetrics::encode(metrics, server.connections.metrics());
    Ok(([(CONTENT_TYPE, openmetrics::CONTENT_TYPE)], text))
}

async fn hello(State(server): SharedServer, headers: HeaderMap) -> impl IntoResponse {
    let person = server.credentials.person(&headers);
    let role = person.as_ref().map(|person| person.role);
    let token = server.credentials.page_token();
    let document = json!({
        "node": server.bus.node,
        "prefix": server.bus.prefix,
        "version": env!("CARGO_PKG_VERSION"),
        "may_watch": server.credentials.may_watch(&headers),
        "may_command": server.credentials.may_command(&headers) && role.is_none_or(|it| it == Role::Operator),
        "person": person.map(|person| person.name),
        "role": role,
        "token_file": token.map(|token| token.file.display().to_string()),
        "token_needs_root": token.map(|token| token.needs_root),
    });
    ([(CONTENT_TYPE, jostle_proto::JSON)], document.to_string())
}

/// Queries a key that changes nothing: one with `get` in it, or the state of a swarm.
async fn get(
    State(server): SharedServer,
    Path(rest): Path<String>,
    RawQuery(parameters): RawQuery,
    headers: HeaderMap,
) -> Result<Reply, Response> {
    server.authorize(server.credentials.may_watch(&headers))?;
    let chunks: Vec<&str> = rest.split('/').collect();
    // Only operators may send these queries.
    if let ["@node", "get", "recording" | "audit"] = chunks[..] {
        server.authorize(server.credentials.may_command(&headers))?;
    }
    let is_query = match chunks[..] {
        ["@node", "get", _] | [_, "get", _] | [_, "state"] => true,
        ["@node", "experiment", ..] => chunks.len() > 2,
        _ => false,
    };
    if !is_query {
        let message = format!("unknown query {rest:?}: use SWARM/get/… or @node/get/…");
        return Err(reject(ErrorCode::NotFound, message));
    }
    let parameters = parameters::selector(&parameters.unwrap_or_default())
        .map_err(|message| reject(ErrorCode::InvalidArgument, message))?;
    let token = server.credentials.token(&headers);
    server.bus.query(&rest, &parameters, None, token).await
}

async fn command(
    State(server): SharedServer,
    Path((swarm, verb)): Path<(String, String)>,
    request: Request,
) -> Result<Reply, Response> {
    send(server, format!("{swarm}/cmd/{verb}"), request).await
}

async fn node_command(
    State(server): SharedServer,
    Path(verb): Path<String>,
    request: Request,
) -> Result<Reply, Response> {
    send(server, format!("@node/cmd/{verb}"), request).await
}

/// Sends a command, which needs a token.
async fn send(server: Arc<Server>, rest: String, request: Request) -> Result<Reply, Response> {
    let headers = request.headers().clone();
    let body = read_body(request).await;
    server.authorize(server.credentials.may_command(&headers))?;
    let body = body?;
    let token = server.credentials.token(&headers);
    server.bus.query(&rest, "", Some(body), token).await
}

/// The swarm that a tab watches, in addition to the list.
#[derive(Deserialize)]
struct WatchQuery {
    swarm: Option<String>,
}

async fn websocket(
    State(server): SharedServer,
    Query(query): Query<WatchQuery>,
    Extension(slot): Extension<Arc<Slot>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Result<Response, Response> {
    server.authorize(server.credentials.may_watch(&headers))?;
    if let Some(swarm) = &query.swarm
        && !keys::is_name(swarm)
    {
        let message = format!("invalid swarm name {swarm:?}");
        return Err(reject(ErrorCode::InvalidArgument, message));
    }
    // The page connects again. Otherwise it would be told that a stored swarm is gone.
    if let Some(busy) = server.bus.recovering() {
        return Err(busy);
    }
    let person = server.credentials.person(&headers);
    let name = person.as_ref().map(|person| person.name.as_str());
    slot.upgrade(name)
        .map_err(|message| reject(ErrorCode::ResourceExhausted, message))?;
    let feeds = server.feeds.clone();
    let upgrade = upgrade.protocols([PROTOCOL]);
    let upgrade = upgrade.max_message_size(4096).max_frame_size(4096);
    Ok(upgrade.on_upgrade(async move |socket| {
        let revoked = server.credentials.revoked(&headers);
        socket::serve(socket, feeds, query.swarm, revoked).await;
        drop(slot);
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_or_tls_addresses_are_accepted() {
        assert!(matches!(check("", false), Ok(None)));
        let local = "127.0.0.1:8080 localhost:0 [::1]:1 http://[::1]:1";
        let secure = "https://0.0.0.0:8443 https://localhost:0";
        let open = "0.0.0.0:8080 [::]:1 10.0.0.1:8080 http://10.0.0.1:8080";
        let invalid = "8080 :8080 example.org:80 127.0.0.1 https:// ftp://127.0.0.1:1";
        for (addresses, has_users, expected) in [
            (local, false, "plain"),
            (secure, true, "TLS"),
            (secure, false, "no users"),
            (open, true, "not loopback"),
            (invalid, true, "no address"),
        ] {
            for address in addresses.split(' ') {
                let checked = match check(address, has_users) {
                    Ok(Some(ListenAddress { is_secure, .. })) => {
                        ["plain", "TLS"][usize::from(is_secure)]
                    }
                    Err(GatewayError::NoUsers(_)) => "no users",
                    Err(GatewayError::NotLoopback(_)) => "not loopback",
                    Err(GatewayError::NoAddress(_)) => "no address",
                    other => panic!("{address}: {other:?}"),
                };
                assert_eq!(checked, expected, "{address}");
            }
        }
    }
}
