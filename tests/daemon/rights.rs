//! People and roles: what each may do, over TLS and within the machine.

mod address;
mod audit;
mod blocked;
mod forgery;
mod live;
mod matrix;
mod notes;
mod owners;
mod places;
mod requests;
pub mod secrets;
mod shares;
mod start;
mod table;
mod tls;
mod turns;

use std::path::PathBuf;

use jostle_proto::{Credentials, Role, keys};
use jostled::app::{self, Server};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use jostled::cli::settings;
use jostled::config::Config;
use serde_json::{Value, json};
use tempfile::TempDir;
use zenoh::Session;
use zenoh::bytes::Encoding;

use crate::support::{NODE, PREFIX, QueryResult, TIMEOUT, hold_token, result_of};

/// Two viewers, two controllers, an operator.
const PEOPLE: [(&str, Role); 5] = [
    ("vera", Role::Viewer),
    ("victor", Role::Viewer),
    ("cleo", Role::Controller),
    ("carl", Role::Controller),
    ("olga", Role::Operator),
];

/// A daemon with roles.
struct AuthDaemon {
    server: Server,
    folder: Folder,
    base: TempDir,
}

impl AuthDaemon {
    async fn start() -> Self {
        Self::start_with_http("127.0.0.1:0").await
    }

    /// A daemon that serves HTTP there.
    async fn start_with_http(http: &str) -> Self {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::new(base.path().join("auth"));
        let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
        issue::init(&folder, &[], &people).unwrap();
        Self::start_in(base, folder, http).await
    }

    /// A daemon with these users.
    async fn start_in(base: TempDir, folder: Folder, http: &str) -> Self {
        let data = base.path().join("data");
        let flags = [
            ("listen", "tls/127.0.0.1:0,tcp/127.0.0.1:0"),
            ("node", NODE),
            ("http", http),
            ("data_dir", data.to_str().unwrap()),
            ("auth_dir", folder.path().to_str().unwrap()),
        ];
        let resolved = settings::from_flags(flags).unwrap();
        let server = app::start(&Config::new(&resolved).unwrap()).await.unwrap();
        AuthDaemon {
            server,
            folder,
            base,
        }
    }

    fn endpoint(&self, protocol: &str) -> &str {
        let endpoints = self.server.endpoints.iter();
        let mut endpoints = endpoints.filter(|it| it.starts_with(protocol));
        endpoints.next().unwrap()
    }

    fn credentials(&self, name: &str) -> Credentials {
        self.folder.credentials(name).unwrap()
    }

    /// A session of `name`'s over TLS, which sends their token.
    async fn open_session(&self, name: &str) -> UserSession {
        self.open_session_with(name, Some(&self.credentials(name).token))
            .await
    }

    /// A session of `name`'s over TLS, which sends `token`.
    async fn open_session_with(&self, name: &str, token: Option<&str>) -> UserSession {
        let credentials = SessionCredentials::of(&self.folder, name);
        UserSession {
            session: credentials.open(self.endpoint("tls")).await.unwrap(),
            token: token.map(str::to_owned),
        }
    }

    async fn close(self, users: Vec<UserSession>) {
        for user in users {
            user.session.close().await.unwrap();
        }
        self.server.stop().await;
    }
}

/// The credentials of a session.
struct SessionCredentials {
    user: Option<(String, String)>,
    authority: PathBuf,
    certificate: Option<[PathBuf; 2]>,
}

impl SessionCredentials {
    fn of(folder: &Folder, name: &str) -> Self {
        let password = folder.credentials(name).unwrap().password;
        let [authority, certificate, key] =
            Credentials::CERTIFICATES.map(|file| folder.person_folder(name).join(file));
        SessionCredentials {
            user: Some((name.to_owned(), password)),
            authority,
            certificate: Some([certificate, key]),
        }
    }

    async fn open(&self, endpoint: &str) -> zenoh::Result<Session> {
        self.open_as("client", endpoint).await
    }

    async fn open_as(&self, mode: &str, endpoint: &str) -> zenoh::Result<Session> {
        let mut tls = json!({"root_ca_certificate": self.authority});
        if let Some([certificate, key]) = &self.certificate {
            tls["enable_mtls"] = json!(true);
            tls["connect_certificate"] = json!(certificate);
            tls["connect_private_key"] = json!(key);
        }
        let mut settings = vec![
            ("mode", json!(mode)),
            ("listen/endpoints", json!([])),
            ("connect/endpoints", json!([endpoint])),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
            ("adminspace/enabled", json!(false)),
            ("transport/link/tls", tls),
        ];
        if let Some((user, password)) = &self.user {
            let credentials = json!({"user": user, "password": password});
            settings.push(("transport/auth/usrpwd", credentials));
        }
        let mut config = zenoh::Config::default();
        for (key, value) in settings {
            config.insert_json5(key, &value.to_string()).unwrap();
        }
        zenoh::open(config).await
    }
}

/// A session, with a token to send or without.
struct UserSession {
    session: Session,
    token: Option<String>,
}

impl UserSession {
    /// Every reply; none if the request is dropped.
    async fn query_all(&self, selector: &str, payload: Option<&Value>) -> Vec<QueryResult> {
        let mut query = self.session.get(selector).timeout(2 * TIMEOUT);
        if let Some(payload) = payload {
            let payload = payload.to_string();
            hold_token(&self.session, selector, payload.as_bytes()).await;
            query = query.payload(payload).encoding(Encoding::APPLICATION_JSON);
        }
        if let Some(token) = &self.token {
            query = query.attachment(token);
        }
        let replies = query.await.unwrap();
        let mut answers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            answers.push(result_of(reply));
        }
        answers
    }

    /// The reply to a request that succeeds.
    async fn ok(&self, key: &str, payload: Option<&Value>) -> Value {
        let mut answers = self.query_all(key, payload).await;
        assert_eq!(answers.len(), 1, "{key} {payload:?}: {answers:?}");
        let answer = answers.remove(0);
        answer.unwrap_or_else(|error| panic!("{key} {payload:?}: {error:?}"))
    }

    async fn cmd(&self, swarm: &str, verb: &str, args: Value) -> Value {
        self.ok(&keys::cmd(PREFIX, swarm, verb), Some(&args)).await
    }

    async fn node_cmd(&self, verb: &str, args: Value) -> Value {
        self.ok(&keys::node_cmd(PREFIX, NODE, verb), Some(&args))
            .await
    }

    async fn create(&self, swarm: &str) {
        let spec = json!({"n": 5, "seed": 1, "publish_every": 1, "rate": null});
        self.node_cmd("create", json!({"name": swarm, "spec": spec}))
            .await;
    }
}
