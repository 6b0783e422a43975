//! A daemon process with roles, whose list of people changes while it runs.

use std::fs::{self, File};
use std::time::Duration;

use jostle_proto::{Credentials, Role};
use jostled::auth::folder::Folder;
use serde_json::Value;
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{WebSocketStream, client_async};

use crate::rights::secrets::http;
use crate::rights::{SessionCredentials, UserSession};
use crate::support::process::{Process, jostled};
use crate::support::{NODE, until, until_within};

/// The time within which a change applies.
pub(super) const SHORT_TIMEOUT: Duration = Duration::from_secs(5);

/// A daemon process with roles, and a swarm `s`, which olga created.
pub(in crate::rights) struct AuthProcess {
    pub process: Process,
    pub folder: Folder,
    pub tls: String,
    pub http: String,
    pub base: TempDir,
}

impl AuthProcess {
    pub async fn start(people: &[(&str, Role)]) -> Self {
        Self::start_failing(people, "").await
    }

    /// Starts one that fails at these points.
    pub async fn start_failing(people: &[(&str, Role)], points: &str) -> Self {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::new(base.path().join("auth"));
        let people = people.iter().chain(&[("olga", Role::Operator)]);
        let people: Vec<_> = people
            .map(|(name, role)| format!("{name}={role}"))
            .collect();
        let mut init = jostled(&["auth", "init", "--auth-dir"]);
        let made = init.arg(folder.path()).args(people).output().unwrap();
        assert!(made.status.success(), "{made:?}");
        let daemon = Self::serve(base, folder, points).await;
        let spec = r#"{"name": "s", "spec": {"n": 3, "seed": 1}}"#;
        assert_eq!(daemon.http("POST /api/node/create", "olga", spec).0, 200);
        daemon
    }

    /// Kills it, and starts another on its folder and data.
    pub async fn killed(mut self) -> Self {
        self.process.signal("-KILL");
        self.process.end();
        Self::serve(self.base, self.folder, "").await
    }

    /// The log of the process.
    pub fn log(&self) -> String {
        fs::read_to_string(self.base.path().join("log")).unwrap()
    }

    async fn serve(base: TempDir, folder: Folder, points: &str) -> Self {
        let [out, log] = ["out", "log"].map(|name| base.path().join(name));
        let mut command = jostled(&["serve", "--node", NODE]);
        command
            .args([
                "--listen",
                "tls/127.0.0.1:0",
                "--http",
                "127.0.0.1:0",
                "--auth-dir",
            ])
            .arg(folder.path())
            .arg("--data-dir")
            .arg(base.path().join("data"))
            .env("FAILPOINTS", points)
            .stdout(File::create(&out).unwrap())
            .stderr(File::create(log).unwrap());
        let process = Process::of(&mut command);
        let printed_line = |what: &str| {
            let text = fs::read_to_string(&out).unwrap();
            let lines = text.lines().map(str::to_owned);
            let found = lines.filter(|line| text.ends_with('\n') && line.starts_with(what));
            found.map(|line| line[what.len()..].to_owned()).next()
        };
        until("it serves", async || printed_line("http on ").is_some()).await;
        let http = printed_line("http on http://").unwrap();
        let tls = printed_line("listening on ").unwrap();
        AuthProcess {
            process,
            folder,
            tls,
            http,
            base,
        }
    }

    /// Runs `jostled auth`, and returns what it prints.
    pub fn auth(&self, arguments: &[&str]) -> String {
        let mut command = jostled(&["auth"]);
        command
            .args(arguments)
            .arg("--auth-dir")
            .arg(self.folder.path());
        let ended = command.output().unwrap();
        assert!(ended.status.success(), "{arguments:?}: {ended:?}");
        String::from_utf8(ended.stdout).unwrap()
    }

    pub fn token(&self, name: &str) -> String {
        self.folder.credentials(name).unwrap().token
    }

    pub fn http(&self, request: &str, name: &str, body: &str) -> (u16, Value) {
        http(&self.http, request, Some(&self.token(name)), body)
    }

    /// The HTTP status of a command with this token.
    pub fn command(&self, token: &str) -> u16 {
        let request = "POST /api/cmd/s/set";
        http(&self.http, request, Some(token), r#"{"pi3": 1.1}"#).0
    }

    pub fn epoch(&self) -> Value {
        let (_, status) = self.http("GET /api/get/s/get/status", "olga", "");
        status["epoch"].clone()
    }

    /// Whether `/healthz` reports that the people cannot be read.
    pub fn is_reported(&self) -> bool {
        let (_, health) = http(&self.http, "GET /healthz", None, "");
        let mut reasons = health["reasons"].as_array().unwrap().iter();
        reasons.any(|it| it["code"] == "people_unreadable")
    }

    pub async fn open_session(&self, name: &str) -> UserSession {
        self.open_session_with(name, &self.token(name)).await
    }

    /// A session of `name`, which sends `token`.
    pub async fn open_session_with(&self, name: &str, token: &str) -> UserSession {
        UserSession {
            session: SessionCredentials::of(&self.folder, name)
                .open(&self.tls)
                .await
                .unwrap(),
            token: Some(token.to_owned()),
        }
    }

    /// A page's socket.
    pub async fn tab(&self, token: &str) -> WebSocketStream<TcpStream> {
        let request = format!("ws://{}/api/ws", self.http);
        let mut request = request.into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("origin", format!("http://{}", self.http).parse().unwrap());
        let protocols = format!("jostle, token.{token}").parse().unwrap();
        headers.insert("sec-websocket-protocol", protocols);
        let stream = TcpStream::connect(&self.http).await.unwrap();
        client_async(request, stream).await.unwrap().0
    }

    /// The credentials of a person, from a copy of their folder.
    pub fn copied_credentials(&self, name: &str) -> SessionCredentials {
        let copy = self.base.path().join("kept");
        fs::create_dir(&copy).unwrap();
        for entry in fs::read_dir(self.folder.person_folder(name)).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), copy.join(entry.file_name())).unwrap();
        }
        let [authority, certificate, key] = Credentials::CERTIFICATES.map(|it| copy.join(it));
        SessionCredentials {
            user: Some((
                name.to_owned(),
                self.folder.credentials(name).unwrap().password,
            )),
            authority,
            certificate: Some([certificate, key]),
        }
    }

    pub fn end(mut self) {
        self.process.signal("-TERM");
        assert_eq!(self.process.end().0, Some(0));
    }
}

/// Waits until a condition holds, at most [`SHORT_TIMEOUT`].
pub(super) async fn until_short(what: &str, holds: impl AsyncFnMut() -> bool) {
    until_within(SHORT_TIMEOUT, what, holds).await;
}
