//! The processes that a bench measures, and their clients.

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use jostle_client::{Client, ConnectOptions};
use jostle_proto::keys;
use serde_json::{Value, json};
use zenoh::Session;

/// A process that ends when this does.
pub struct Process {
    pub child: Child,
    stdout: Lines<BufReader<ChildStdout>>,
}

impl Process {
    /// Starts it with pipes for its standard input and output.
    pub fn start(mut command: Command) -> Self {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::null()).spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap()).lines();
        Process { child, stdout }
    }

    /// Waits for the next line that begins with `word`. Returns the rest of it.
    pub fn find(&mut self, word: &str) -> String {
        let lines = &mut self.stdout;
        let mut found =
            lines.filter_map(|line| line.unwrap().strip_prefix(word).map(str::to_owned));
        found.next().unwrap()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// The session of a client of the daemon, or of the process that answers without one.
pub async fn open(endpoint: &str) -> Session {
    let client = Client::connect(ConnectOptions::to(endpoint)).await;
    client.unwrap().session().clone()
}

/// The reply to a request.
pub async fn ask(session: &Session, key: String, request: &Value) -> Value {
    let query = session.get(key).payload(request.to_string());
    let answers = query
        .encoding("application/json")
        .timeout(Duration::from_secs(60));
    let answer = answers.await.unwrap().recv_async().await.unwrap();
    match answer.into_result() {
        Ok(sample) => serde_json::from_slice(&sample.payload().to_bytes()).unwrap(),
        Err(error) => panic!("{}", String::from_utf8_lossy(&error.payload().to_bytes())),
    }
}

/// Creates a swarm of `spec` on the daemon `node`, and takes so many steps.
pub async fn create_and_step(
    session: &Session,
    (node, swarm): (&str, &str),
    spec: Value,
    steps: u32,
) {
    let create = json!({"name": swarm, "spec": spec});
    ask(session, keys::node_cmd("jostle", node, "create"), &create).await;
    let step = json!({"timeout_secs": 60, "args": {"steps": steps}});
    ask(session, keys::cmd("jostle", swarm, "step"), &step).await;
}
