//! What an operator reads when a setting, a file or an address is wrong.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use jostle_proto::Role;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::{Value, json};

use crate::support::Client;
use crate::support::http::health;
use crate::support::process::{Process, jostled};

/// The exit code and the standard error of a command that ends by itself.
fn ended(command: &mut Command) -> (Option<i32>, String) {
    let output = command.stderr(Stdio::piped()).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), text)
}

fn serve(data: &Path, flags: &[&str]) -> Command {
    let mut command = jostled(&["serve", "--data-dir"]);
    command.arg(data).args(flags);
    command
}

/// A daemon with HTTP on `data`: the process, and the address of its HTTP server.
fn serving(data: &Path, node: &str) -> (Process, String) {
    let flags = ["--listen", "tcp/127.0.0.1:0", "--http", "127.0.0.1:0"];
    let mut command = serve(data, &flags);
    let log = File::create(data.with_extension("log")).unwrap();
    command.args(["--node", node]).stderr(log);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut lines = lines.map_while(Result::ok);
    let process = Process(child, tempfile::tempdir().unwrap());
    let http = lines.find_map(|line| Some(line.strip_prefix("http on http://")?.to_owned()));
    (process, http.unwrap())
}

fn auth_folder(base: &Path, name: &str) -> Folder {
    let folder = Folder::new(base.join(name));
    issue::init(&folder, &[], &[("olga".into(), Role::Operator)]).unwrap();
    folder
}

#[test]
fn a_new_data_folder_beside_that_of_another_node_is_a_warning_at_the_first_start() {
    let base = tempfile::tempdir().unwrap();
    let start = |node: &str| serving(&base.path().join(node), node);
    let warnings = |http: &str| health(http).1["warnings"].clone();
    let (first, http) = start("lab1");
    assert_eq!(warnings(&http), json!([]));
    drop(first);
    let (renamed, http) = start("lab2");
    let (status, report) = health(&http);
    assert_eq!(status, 200, "{report}");
    assert_eq!(report["warnings"][0]["code"], "other_data", "{report}");
    let message = report["warnings"][0]["message"].as_str().unwrap();
    let named = format!("{} also has the data of node lab1", base.path().display());
    assert!(message.starts_with(&named), "{message}");
    assert!(message.contains("node = \"lab1\""), "{message}");
    let log = fs::read_to_string(base.path().join("lab2.log")).unwrap();
    assert!(log.contains(&named), "{log}");
    drop(renamed);
    // Several nodes may have their data side by side.
    for node in ["lab1", "lab2"] {
        let (_again, http) = start(node);
        assert_eq!(warnings(&http), json!([]), "{node}");
    }
}

#[test]
fn recordings_or_experiments_without_a_database_are_rejected() {
    let flags = ["--listen", "tcp/127.0.0.1:0", "--node", "test"];
    for (file, is_empty) in [
        ("recordings/a/part", false),
        ("experiments/a/runs.jsonl", false),
        ("experiments/a/runs.jsonl", true),
        ("jostle.sqlite-wal", true),
    ] {
        let base = tempfile::tempdir().unwrap();
        let file = base.path().join(file);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, "x").unwrap();
        if is_empty {
            fs::write(base.path().join("jostle.sqlite"), "").unwrap();
        }
        let (code, text) = ended(&mut serve(base.path(), &flags));
        assert_eq!(code, Some(2), "{}: {text}", file.display());
        let folder = base.path().display();
        let expected = format!("{folder} has recordings or experiments but no database: restore");
        assert!(text.contains(&expected), "{text}");
    }
    // As a crash at the first start leaves it.
    let base = tempfile::tempdir().unwrap();
    for name in ["lock", "reserve", "jostle.sqlite"] {
        fs::write(base.path().join(name), "").unwrap();
    }
    for name in ["recordings", "experiments"] {
        fs::create_dir(base.path().join(name)).unwrap();
    }
    Process::start(&mut jostled(&["serve", flags[0], flags[1]]), base);
}

#[test]
fn config_explain_prints_the_values_that_depend_on_the_machine() {
    let mut command = jostled(&["config", "explain", "--json", "--node", "lab"]);
    command
        .env_remove("STATE_DIRECTORY")
        .env("XDG_STATE_HOME", "/state");
    let output = command.output().unwrap();
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();
    let settings = read["settings"].as_array().unwrap();
    let value = |name| &settings.iter().find(|it| it["name"] == name).unwrap()["value"];
    assert_eq!(value("data_dir"), "/state/jostle/lab");
    let threads = value("experiment_threads")
        .as_str()
        .unwrap()
        .parse::<usize>();
    assert!(threads.is_ok_and(|threads| threads > 0), "{read}");
}

#[test]
fn auth_address_changes_the_settings_file_that_is_given() {
    let base = tempfile::tempdir().unwrap();
    let folder = auth_folder(base.path(), "auth");
    let own = fs::read_to_string(folder.settings_file()).unwrap();
    let file = base.path().join("daemon.toml");
    let auth_dir = format!("auth_dir = {:?}\n", folder.path());
    fs::write(&file, format!("# of this machine\nhttp = \"\"\n{auth_dir}")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
    let mut command = jostled(&[
        "auth",
        "address",
        "--http",
        "https://127.0.0.1:8443",
        "--config",
    ]);
    let output = command
        .arg(&file)
        .env_remove("JOSTLED_HTTP")
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    assert!(
        text.contains(&format!("settings: {}", file.display())),
        "{text}"
    );
    let changed = fs::read_to_string(&file).unwrap();
    let expected = format!("# of this machine\nhttp = \"https://127.0.0.1:8443\"\n{auth_dir}");
    assert_eq!(changed, expected);
    let mode = fs::metadata(&file).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o644);
    assert_eq!(fs::read_to_string(folder.settings_file()).unwrap(), own);
}

#[test]
fn a_certificate_that_clients_would_reject_prevents_the_start() {
    let base = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| auth_folder(base.path(), name));
    let [certificate, key] = own.daemon();
    let [other_certificate, other_key] = other.daemon();
    let auth = own.path().to_str().unwrap();
    let data = base.path().join("data");
    let flags = ["--listen", "tls/127.0.0.1:0", "--auth-dir", auth];
    let rejected = |file: &Path, what: &str| {
        let (code, text) = ended(&mut serve(&data, &flags));
        assert_eq!(code, Some(2), "{text}");
        for part in [file.to_str().unwrap(), what, "jostled auth address"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    };
    fs::copy(other_certificate, &certificate).unwrap();
    rejected(&key, "KeyMismatch");
    fs::copy(other_key, &key).unwrap();
    rejected(&certificate, "has not signed");
    fs::write(&certificate, "").unwrap();
    rejected(&certificate, "it contains no certificate");
}

#[test]
fn an_address_in_use_is_named_with_its_setting() {
    let base = tempfile::tempdir().unwrap();
    let used = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = used.local_addr().unwrap().to_string();
    let data = base.path().join("data");
    let settings = base.path().join("jostled.toml");
    let in_file = |text: &str| {
        fs::write(&settings, text).unwrap();
        let flags = ["--config", settings.to_str().unwrap()];
        ended(serve(&data, &flags).env_remove("JOSTLED_HTTP"))
    };
    let free = "listen = 'tcp/127.0.0.1:0'";
    let (code, text) = in_file(&format!("http = '{address}'\n{free}\n"));
    assert_eq!(code, Some(1), "{text}");
    let set = format!("http = {address:?} ({})", settings.display());
    for part in [&*set, "--http 127.0.0.1:0"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let (code, text) = in_file(&format!("http = ''\nlisten = 'tcp/{address}'\n"));
    assert_eq!(code, Some(1), "{text}");
    let set = format!("listen = \"tcp/{address}\" ({})", settings.display());
    for part in [&*set, "--listen tcp/127.0.0.1:0", "another daemon"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let folder = auth_folder(base.path(), "auth");
    let auth = format!("auth_dir = {:?}", folder.path());
    for over_tls in [
        format!("http = ''\nlisten = 'tls/{address}'\n{auth}\n"),
        format!("http = 'https://{address}'\n{free}\n{auth}\n"),
    ] {
        let (code, text) = in_file(&over_tls);
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains("set another address"), "{text}");
        assert!(!text.contains("127.0.0.1:0`"), "{text}");
    }

    for flags in [
        ["--listen", "tcp/127.0.0.1:0", "--http", &*address],
        ["--listen", &*format!("tcp/{address}"), "--http", ""],
    ] {
        let (code, text) = ended(jostled(&["demo"]).args(flags));
        assert_eq!(code, Some(1), "{text}");
        let first = text.lines().next().unwrap();
        for part in [
            "another jostled may already run here",
            &*address,
            "--listen",
            "--http",
        ] {
            assert!(first.contains(part), "{part}: {text}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_says_how_to_repeat_it_and_that_it_is_paused() {
    let mut command = jostled(&["demo", "--for", "6s", "--listen", "tcp/127.0.0.1:0"]);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut lines = lines.map_while(Result::ok);
    let _process = Process(child, tempfile::tempdir().unwrap());
    let endpoint = lines.find_map(|line| Some(line.strip_prefix("listening on ")?.to_owned()));
    let endpoint = endpoint.unwrap();
    let repeat = format!(
        "repeat it: jostle -e {endpoint} spec demo | jostle -e {endpoint} create mine --spec -"
    );
    assert!(lines.any(|line| line == repeat), "no {repeat:?}");
    let client = Client::open(&endpoint).await;
    assert!(lines.any(|line| line.contains(" of 20 ")), "it runs");
    client.ok("demo", "pause", json!({})).await;
    let paused = lines.find(|line| line.contains("paused"));
    assert!(paused.is_some(), "no line says that it is paused");
}
