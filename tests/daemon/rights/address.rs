//! The addresses that `jostled auth init` and `auth address` write.

use std::fs::{self, File};
use std::net::SocketAddr;
use std::path::Path;
use std::process::Output;

use jostle_proto::{Credentials, keys};
use jostled::auth::folder::Folder;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::free_ports;
use crate::support::process::{Process, jostled};
use crate::support::tls::https_by;
use crate::support::{NODE, PREFIX, until};

/// Runs `jostled auth` without an address in the environment.
fn auth(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = jostled(&["auth"]);
    command
        .args(arguments)
        .arg("--auth-dir")
        .arg(folder)
        .env_remove("JOSTLED_HTTP");
    command
        .stderr(std::process::Stdio::piped())
        .output()
        .unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let ended = auth(folder, arguments);
    assert!(ended.status.success(), "{arguments:?}: {ended:?}");
    String::from_utf8(ended.stdout).unwrap()
}

struct AuthFolder {
    folder: Folder,
    base: TempDir,
}

impl AuthFolder {
    fn new() -> Self {
        let base = tempfile::tempdir().unwrap();
        AuthFolder {
            folder: Folder::new(base.path().join("auth")),
            base,
        }
    }

    /// Starts a daemon with the settings in the folder and nothing else.
    async fn serve(&self) -> Process {
        let out = self.base.path().join("out");
        let mut command = jostled(&["serve", "--node", NODE, "--config"]);
        command
            .arg(self.folder.settings_file())
            .env_remove("JOSTLED_HTTP")
            .arg("--data-dir")
            .arg(self.base.path().join("data"))
            .stdout(File::create(&out).unwrap());
        let process = Process::of(&mut command);
        until("it serves", async || {
            fs::read_to_string(&out).unwrap().contains("http on")
        })
        .await;
        process
    }

    /// Whether a client with nothing but `zenoh.json5` reaches the daemon, and a browser the page.
    async fn reachable_by(&self, person: &str, host: &'static str) -> [bool; 2] {
        let config = self.folder.person_folder(person).join("zenoh.json5");
        let config = zenoh::Config::from_file(config).unwrap();
        let is_reached = match zenoh::open(config).await {
            Ok(session) => {
                let hello = session
                    .get(keys::node_get(PREFIX, NODE, "hello"))
                    .await
                    .unwrap();
                let is_answered = hello.recv_async().await.is_ok_and(|it| it.result().is_ok());
                session.close().await.unwrap();
                is_answered
            }
            Err(_) => false,
        };
        let page = self.credentials(person).page.unwrap();
        let address: SocketAddr = page.strip_prefix("https://").unwrap().parse().unwrap();
        let request = format!("GET /healthz HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        let answer = https_by(host, address, &self.folder, &request).await;
        [
            is_reached,
            answer.is_some_and(|it| it.starts_with("HTTP/1.1 ")),
        ]
    }

    fn credentials(&self, person: &str) -> Credentials {
        self.folder.credentials(person).unwrap()
    }

    fn addresses(&self) -> Value {
        let output = done(self.folder.path(), &["address", "--json"]);
        serde_json::from_str(&output).unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn addresses_that_init_is_given_are_those_of_the_daemon_and_of_people() {
    let daemon = AuthFolder::new();
    let path = daemon.folder.path();
    let [first, second] = ["127.0.0.2", "127.0.0.3"];
    let ports = [free_ports::<2>(first), free_ports(second)].concat();
    let listen = format!("tls/{first}:{}", ports[0]);
    let http = format!("https://{first}:{}", ports[1]);
    let people = ["vera=viewer", "olga=operator"];
    done(
        path,
        &[&["init", "--listen", &listen, "--http", &http], &people[..]].concat(),
    );
    let before = daemon.credentials("olga");
    assert_eq!(
        (&before.endpoint, before.page.as_ref()),
        (&listen, Some(&http))
    );
    assert_eq!(
        daemon.addresses(),
        json!({"endpoint": listen, "page": http, "hosts": []})
    );
    let mut process = daemon.serve().await;
    assert_eq!(daemon.reachable_by("olga", first).await, [true, true]);
    process.signal("-TERM");
    process.end();

    // Edits of the settings are kept.
    let settings = daemon.folder.settings_file();
    let written = fs::read_to_string(&settings).unwrap() + "# As agreed.\nmax_swarms = 7\n";
    fs::write(&settings, written).unwrap();
    fs::remove_dir_all(daemon.folder.person_folder("vera")).unwrap();
    let moved = format!("tls/{second}:{}", ports[2]);
    let page = format!("https://{second}:{}", ports[3]);
    let output = done(path, &["address", "--listen", &moved, "--http", &page]);
    for expected in [
        "restart the daemon",
        &moved,
        &page,
        daemon.folder.person_folder("olga").to_str().unwrap(),
        "the folders of vera",
        "JOSTLE_ENDPOINT",
    ] {
        assert!(output.contains(expected), "{expected}: {output}");
    }
    let after = daemon.credentials("olga");
    assert_eq!(
        (&after.endpoint, after.page.as_ref()),
        (&moved, Some(&page))
    );
    assert_eq!(
        (&after.token, &after.password),
        (&before.token, &before.password)
    );
    let written = fs::read_to_string(&settings).unwrap();
    assert!(
        written.contains("# As agreed.\nmax_swarms = 7\n"),
        "{written}"
    );
    let mut process = daemon.serve().await;
    assert_eq!(daemon.reachable_by("olga", second).await, [true, true]);
    // A person added later gets the same address.
    done(path, &["add", "nora=viewer"]);
    assert_eq!(daemon.credentials("nora").endpoint, moved);
    process.signal("-TERM");
    process.end();
    // `init` of an existing folder changes the address, too, and prints the change.
    let output = done(
        path,
        &[
            "init",
            "--listen",
            &listen,
            "vera=viewer",
            "carl=controller",
        ],
    );
    let carl = daemon.folder.person_folder("carl");
    for expected in [
        "restart the daemon",
        &listen,
        "hand each folder",
        carl.to_str().unwrap(),
    ] {
        assert!(output.contains(expected), "{expected}: {output}");
    }
    assert_eq!(daemon.credentials("olga").endpoint, listen);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_address_changes_and_the_others_stay() {
    let daemon = AuthFolder::new();
    let path = daemon.folder.path();
    let init = [
        "init",
        "--host",
        "lab.example",
        "--listen",
        "tls/0.0.0.0:7448",
        "olga=operator",
    ];
    done(path, &init);
    let people = |daemon: &AuthFolder| {
        let credentials = daemon.credentials("olga");
        (credentials.endpoint, credentials.page.unwrap_or_default())
    };
    let local = "http://127.0.0.1:8080".to_owned();
    assert_eq!(
        people(&daemon),
        ("tls/lab.example:7448".into(), local.clone())
    );
    // HTTP alone.
    done(path, &["address", "--http", "https://0.0.0.0:8444"]);
    let page = "https://lab.example:8444".to_owned();
    assert_eq!(
        people(&daemon),
        ("tls/lab.example:7448".into(), page.clone())
    );
    // Names alone: people use the first one.
    let output = done(
        path,
        &["address", "--host", "10.0.0.5", "--host", "lab.example"],
    );
    assert!(
        output.contains("certificate: localhost, 127.0.0.1, ::1, 10.0.0.5, lab.example"),
        "{output}"
    );
    assert_eq!(
        people(&daemon),
        ("tls/10.0.0.5:7448".into(), "https://10.0.0.5:8444".into())
    );
    // Endpoints alone: people do not use one within the machine.
    done(
        path,
        &["address", "--listen", "tcp/127.0.0.1:7447,tls/[::]:7449"],
    );
    assert_eq!(
        people(&daemon),
        ("tls/10.0.0.5:7449".into(), "https://10.0.0.5:8444".into())
    );
    let settings = fs::read_to_string(daemon.folder.settings_file()).unwrap();
    let settings: toml::Table = settings.parse().unwrap();
    assert_eq!(settings["listen"].as_array().unwrap().len(), 2);
    assert_eq!(settings["http"].as_str(), Some("https://0.0.0.0:8444"));
    // No HTTP.
    done(path, &["address", "--http", ""]);
    assert_eq!(people(&daemon).1, "");
    // Names, while the daemon listens within its own machine alone.
    done(path, &["address", "--listen", "tls/127.0.0.1:7447"]);
    let output = done(path, &["address", "--host", "lab.example"]);
    assert!(output.contains("--listen tls/0.0.0.0:7447"), "{output}");
}

#[test]
fn an_address_that_people_could_not_use_is_rejected_and_changes_nothing() {
    let daemon = AuthFolder::new();
    let path = daemon.folder.path();
    let everywhere = ["--listen", "tls/0.0.0.0:7447"];
    let ended = auth(
        path,
        &[&["init"], &everywhere[..], &["olga=operator"]].concat(),
    );
    assert_eq!(ended.status.code(), Some(2), "{ended:?}");
    assert!(!path.exists());
    done(path, &["init", "olga=operator"]);
    let files = [
        "people.json",
        "jostled.toml",
        "daemon.pem",
        "people/olga/credentials.json",
    ];
    let read = || files.map(|file| fs::read_to_string(path.join(file)).unwrap());
    let before = read();
    for (arguments, expected) in [
        (&everywhere[..], "--host lab.example"),
        (&["--http", "https://[::]:8443"], "--host lab.example"),
        (&["--listen", "tls/127.0.0.1:0"], "give a port"),
        (&["--http", "127.0.0.1:0"], "give a port"),
        (&["--listen", "tls/10.0.0.1"], "has no port"),
        (&["--listen", "tcp/0.0.0.0:7447"], "is not encrypted"),
        (&["--http", "0.0.0.0:8080"], "is not encrypted"),
        (&["--http", "lab"], "invalid --http"),
        (&["--listen", " , "], "at least one endpoint"),
        (
            &["--host", "no such host"],
            "is neither a name nor an address",
        ),
    ] {
        let ended = auth(path, &[&["address"], arguments].concat());
        let text = String::from_utf8(ended.stderr).unwrap();
        assert!(
            matches!(ended.status.code(), Some(1 | 2)),
            "{arguments:?}: {text}"
        );
        assert!(text.contains(expected), "{arguments:?}: {text}");
        assert!(read() == before, "{arguments:?}");
    }
    // The authority's key may be elsewhere.
    let [_, key] = daemon.folder.authority();
    let aside = daemon.base.path().join("key");
    fs::rename(&key, &aside).unwrap();
    let ended = auth(path, &["address", "--listen", "tls/127.0.0.1:7448"]);
    let text = String::from_utf8(ended.stderr).unwrap();
    assert!(text.contains("put it back"), "{text}");
    fs::rename(aside, key).unwrap();
    assert!(read() == before);

    // A folder of an earlier version, which did not record names.
    let forget = |endpoint: &str| {
        let mut people: Value = serde_json::from_str(&before[0]).unwrap();
        let fields = people.as_object_mut().unwrap();
        fields.remove("hosts");
        fields.remove("page");
        fields.insert("endpoint".into(), json!(endpoint));
        fs::write(daemon.folder.people_file(), people.to_string()).unwrap();
    };
    forget("tls/lab.example:7447");
    let ended = auth(path, &["address", "--listen", "tls/0.0.0.0:7448"]);
    let text = String::from_utf8(ended.stderr).unwrap();
    assert!(
        text.contains("give all of them, --host lab.example"),
        "{text}"
    );
    assert_eq!(daemon.addresses()["hosts"], Value::Null);
    let both = [
        "address",
        "--host",
        "lab.example",
        "--listen",
        "tls/0.0.0.0:7448",
    ];
    done(path, &both);
    assert_eq!(daemon.credentials("olga").endpoint, "tls/lab.example:7448");
    forget("tls/127.0.0.1:7447");
    done(path, &["address", "--listen", "tls/127.0.0.1:7450"]);
    assert_eq!(daemon.credentials("olga").endpoint, "tls/127.0.0.1:7450");
}
