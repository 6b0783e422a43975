//! What a bench measures: processes of their own, and clients of them.

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use jostle_proto::keys;
use serde_json::{Value, json};
use zenoh::Session;

/// A process that ends when this does.
pub struct Process {
    pub child: Child,
    said: Lines<BufReader<ChildStdout>>,
}

impl Process {
    /// Starts it; it reads and prints here.
    pub fn start(mut command: Command) -> Self {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::null()).spawn().unwrap();
        let said = BufReader::new(child.stdout.take().unwrap()).lines();
        Process { child, said }
    }

    /// Waits for the next line that begins with `word`; what follows it there.
    pub fn find(&mut self, word: &str) -> String {
        let lines = &mut self.said;
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

/// A client's session with whatever listens there.
pub async fn open(endpoint: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (setting, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
    ] {
        config.insert_json5(setting, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// The answer to a request.
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

/// Has a daemon called `node` make a swarm of `spec` and take so many steps.
pub async fn settle(session: &Session, (node, swarm): (&str, &str), spec: Value, steps: u32) {
    let create = json!({"name": swarm, "spec": spec});
    ask(session, keys::node_cmd("jostle", node, "create"), &create).await;
    let settle = json!({"timeout_secs": 60, "args": {"steps": steps}});
    ask(session, keys::cmd("jostle", swarm, "step"), &settle).await;
}
