//! A daemon that may open few files, and its HTTP connections.

use std::io::{BufRead, BufReader, ErrorKind};
use std::net::SocketAddr;
use std::process::{Command, Output, Stdio};

use jostle_proto::Role;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use tempfile::TempDir;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::process::Process;
use super::tls::connect_tls;
use super::{NODE, TIMEOUT};
use crate::support::programs::program;

/// The descriptor limit of the daemon: it keeps a quarter of them as HTTP connections.
pub const DESCRIPTORS: usize = 512;

/// A connection over TCP or TLS.
pub trait Duplex: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Duplex for T {}

pub type Connection = Box<dyn Duplex>;

/// A daemon process with few descriptors, which hosts the swarm `a`.
pub struct LimitedDaemon {
    pub process: Process,
    /// Where it listens for zenoh: over TLS, if it serves HTTP over TLS.
    pub endpoint: String,
    /// Where it serves HTTP.
    pub address: SocketAddr,
    /// The token of an operator, or of the page.
    pub token: String,
    /// The auth folder, if it serves HTTP over TLS.
    pub people: Option<Folder>,
    pub _auth: TempDir,
}

impl LimitedDaemon {
    pub fn serve(scheme: &str, failpoints: &str) -> Self {
        let (data, auth) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let is_secure = scheme == "https";
        let protocol = if is_secure { "tls" } else { "tcp" };
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                &format!("ulimit -n {DESCRIPTORS} && exec \"$0\" \"$@\""),
            ])
            .arg(program("jostled"))
            .args(["--listen", &format!("{protocol}/127.0.0.1:0")])
            .args(["--node", NODE, "--data-dir"])
            .arg(data.path())
            .args(["--http", &format!("{scheme}://127.0.0.1:0")]);
        let people = is_secure.then(|| {
            let folder = Folder::new(auth.path().join("auth"));
            let operator = [("olga".to_owned(), Role::Operator)];
            issue::init(&folder, &[], &operator).unwrap();
            command.arg("--auth-dir").arg(folder.path());
            folder
        });
        command
            .env("FAILPOINTS", failpoints)
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut after = |start: &str| {
            let mut found = lines.by_ref().map(Result::unwrap);
            found.find_map(|line| Some(line.strip_prefix(start)?.to_owned()))
        };
        let endpoint = after("listening on ").unwrap();
        let address = after(&format!("http on {scheme}://")).unwrap();
        let token = match &people {
            Some(folder) => folder.credentials("olga").unwrap().token,
            None => std::fs::read_to_string(data.path().join("page-token")).unwrap(),
        };
        let daemon = LimitedDaemon {
            process: Process(child, data),
            endpoint,
            address: address.parse().unwrap(),
            token: token.trim().to_owned(),
            people,
            _auth: auth,
        };
        let created = daemon.jostle(&["create", "a", "--n", "3"]);
        assert!(created.status.success(), "{created:?}");
        daemon
    }

    /// Runs the command line.
    pub fn jostle(&self, arguments: &[&str]) -> Output {
        let jostle = program("jostle");
        assert!(
            jostle.exists(),
            "missing: cargo build --release --workspace"
        );
        let mut command = Command::new(jostle);
        if let Some(folder) = &self.people {
            command
                .arg("--credentials")
                .arg(folder.person_folder("olga"));
        }
        let command = command.args(["-e", &self.endpoint]).args(arguments);
        command.stdin(Stdio::null()).output().unwrap()
    }

    pub async fn connect(&self) -> Connection {
        match &self.people {
            Some(folder) => Box::new(connect_tls(self.address, folder).await.unwrap()),
            None => Box::new(TcpStream::connect(self.address).await.unwrap()),
        }
    }

    /// The status and body of a `GET` of an operator.
    pub async fn get(&self, path: &str) -> (u16, String) {
        let (address, token) = (self.address, &self.token);
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\
             Connection: close\r\n\r\n"
        );
        let mut stream = self.connect().await;
        stream.write_all(request.as_bytes()).await.unwrap();
        let answer = read_to_close(&mut stream).await;
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        (status, body.to_owned())
    }

    /// The value of a metric.
    pub async fn metric(&self, name: &str) -> f64 {
        let (status, text) = self.get("/metrics").await;
        assert_eq!(status, 200, "{text}");
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        let line = line.unwrap_or_else(|| panic!("no {name}: {text}"));
        line.trim().parse().unwrap()
    }

    /// The connections that the daemon has closed for a reason.
    pub async fn closed(&self, reason: &str) -> f64 {
        let name = format!("jostle_http_closed_total{{reason=\"{reason}\"}}");
        self.metric(&name).await
    }

    /// A connection that sends half a header.
    pub async fn half_header(&self) -> Connection {
        let mut stream = self.connect().await;
        // An error if it is evicted already.
        let _ = stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: ").await;
        let _ = stream.flush().await;
        stream
    }
}

/// Reads until the daemon closes the connection.
pub async fn read_to_close(stream: &mut Connection) -> String {
    let mut answer = Vec::new();
    let reading = async {
        let mut piece = [0; 1024];
        loop {
            match stream.read(&mut piece).await {
                Ok(0) => break,
                Ok(length) => answer.extend_from_slice(&piece[..length]),
                // Over TLS the daemon closes without a close_notify alert.
                Err(error) => {
                    let expected = [ErrorKind::ConnectionReset, ErrorKind::UnexpectedEof];
                    assert!(expected.contains(&error.kind()), "{error}");
                    break;
                }
            }
        }
    };
    timeout(TIMEOUT, reading).await.expect("it is still open");
    String::from_utf8(answer).unwrap()
}
