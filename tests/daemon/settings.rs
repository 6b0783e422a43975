//! Every setting of the daemon has an effect by its flag, its variable and the file.

mod effects;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;

use jostle_proto::Role;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::check;
use crate::support::process::Process;
use crate::support::programs::program;

/// Two values of a setting, and what [`effects::observe`] observes of a daemon with each. `{folder}`
/// is the daemon's own folder.
struct Row {
    name: &'static str,
    value: &'static str,
    effect: &'static str,
    /// The default, where the default does not depend on the machine and can be used by several
    /// daemons at once.
    other: &'static str,
    other_effect: &'static str,
    /// A value that is rejected with the place that it comes from.
    bad: Option<&'static str>,
}

const ROWS: [Row; 20] = [
    Row {
        name: "listen",
        value: "unixsock-stream/{folder}/bus",
        effect: "a session over the socket",
        other: "tcp/127.0.0.1:0",
        other_effect: "no socket",
        bad: Some(" , "),
    },
    Row {
        name: "http",
        value: "127.0.0.2:0",
        effect: "127.0.0.2 answers 200",
        other: "",
        other_effect: "no HTTP",
        bad: None,
    },
    Row {
        name: "node",
        value: "bridge",
        effect: "bridge",
        other: "test",
        other_effect: "test",
        bad: Some("no/name"),
    },
    Row {
        name: "prefix",
        value: "lab",
        effect: "lab",
        other: "jostle",
        other_effect: "jostle",
        bad: Some("a/b"),
    },
    Row {
        name: "log",
        value: "zenoh=debug",
        effect: "DEBUG of zenoh",
        other: "info,zenoh=error",
        other_effect: "INFO of jostled",
        bad: Some("=,="),
    },
    Row {
        name: "log_format",
        value: "json",
        effect: "json",
        other: "text",
        other_effect: "text",
        bad: Some("xml"),
    },
    Row {
        name: "max_individuals",
        value: "7",
        effect: "7: ok, 8: invalid_argument",
        other: "2000",
        other_effect: "7: ok, 8: ok",
        bad: Some("0"),
    },
    Row {
        name: "max_swarms",
        value: "2",
        effect: "ok, ok, resource_exhausted",
        other: "1024",
        other_effect: "ok, ok, ok",
        bad: Some("0"),
    },
    Row {
        name: "max_memory_mb",
        value: "4",
        effect: "resource_exhausted at 4 MiB",
        other: "2048",
        other_effect: "ok",
        bad: Some("0"),
    },
    Row {
        name: "max_clients",
        value: "2",
        effect: "ok, ok, resource_exhausted",
        other: "4000",
        other_effect: "ok, ok, ok",
        bad: Some("0"),
    },
    Row {
        name: "max_hz",
        value: "5",
        effect: "every 10th step",
        other: "50",
        other_effect: "every step",
        bad: Some("0"),
    },
    Row {
        name: "data_dir",
        value: "{folder}/data",
        effect: "data",
        other: "{folder}/other",
        other_effect: "other",
        bad: None,
    },
    Row {
        name: "auth_dir",
        value: "{folder}/auth",
        effect: "a stranger: no, a person: ok",
        other: "",
        other_effect: "a stranger: ok, a person: no",
        bad: None,
    },
    Row {
        name: "quota_mb",
        value: "1",
        effect: "history from a later step",
        other: "64",
        other_effect: "history from step 0",
        bad: Some("0"),
    },
    Row {
        name: "audit_mb",
        value: "1",
        effect: "the oldest lines are gone",
        other: "16",
        other_effect: "line 1 is there",
        bad: Some("0"),
    },
    Row {
        name: "audit_days",
        value: "3",
        effect: "lines of 1 days",
        other: "30",
        other_effect: "lines of 10 days",
        bad: Some("0"),
    },
    Row {
        name: "recordings_quota_mb",
        value: "1",
        effect: "ended within 1 MiB",
        other: "10240",
        other_effect: "goes on beyond 1 MiB",
        bad: Some("0"),
    },
    Row {
        name: "experiments_quota_mb",
        value: "1",
        effect: "paused within 1 MiB",
        other: "1024",
        other_effect: "goes on beyond 1 MiB",
        bad: Some("0"),
    },
    Row {
        name: "experiment_threads",
        value: "3",
        effect: "3",
        other: "1",
        other_effect: "1",
        bad: Some("0"),
    },
    Row {
        name: "wasm",
        value: "{folder}/jostle.wasm.gz",
        effect: check::SHA256,
        other: "{folder}/other.wasm.gz",
        other_effect: check::OTHER_SHA256,
        bad: None,
    },
];

/// The ways to give a setting, the weakest first.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SettingSource {
    File,
    Variable,
    Flag,
}

const SETTING_SOURCES: [SettingSource; 3] = [
    SettingSource::File,
    SettingSource::Variable,
    SettingSource::Flag,
];

/// What each daemon is started with; a setting that is tested is left out.
const BASE: [(&str, &str); 4] = [
    ("listen", "tcp/127.0.0.1:0"),
    ("http", ""),
    ("node", "test"),
    ("data_dir", "{folder}/base"),
];

/// The setting `http` of a daemon whose `wasm` is tested.
const HTTP: &str = "127.0.0.1:0";

/// Daemons that are started at once.
const AT_ONCE: usize = 4;

fn flag(name: &str) -> String {
    format!("--{}", name.replace('_', "-"))
}

fn variable(name: &str) -> String {
    format!("JOSTLED_{}", name.to_uppercase())
}

/// A daemon without the settings in this process's environment.
fn jostled() -> Command {
    let mut command = Command::new(program("jostled"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("JOSTLED_") {
            command.env_remove(name);
        }
    }
    command.stdin(Stdio::null());
    command
}

/// `serve` with `name` given in each of these ways, and all else as [`BASE`] has it.
fn serve(name: &str, given: &[(SettingSource, &str)], folder: &Path) -> Command {
    let path = folder.to_str().unwrap();
    let mut command = jostled();
    command.arg("serve");
    for (base, value) in BASE.iter().filter(|(base, _)| *base != name) {
        let value = match (name, *base) {
            ("wasm", "http") => HTTP,
            _ => value,
        };
        command.arg(flag(base)).arg(value.replace("{folder}", path));
    }
    for (way, value) in given {
        let value = value.replace("{folder}", path);
        match way {
            SettingSource::Flag => command.arg(flag(name)).arg(value),
            SettingSource::Variable => command.env(variable(name), value),
            SettingSource::File => {
                let file = folder.join("jostled.toml");
                let value = match value.parse::<u64>() {
                    Ok(number) => number.to_string(),
                    Err(_) => format!("'{value}'"),
                };
                fs::write(&file, format!("{name} = {value}\n")).unwrap();
                command.arg("--config").arg(file)
            }
        };
    }
    command
}

/// A daemon that serves.
struct Running {
    _process: Process,
    folder: tempfile::TempDir,
    /// The first endpoint that it prints.
    endpoint: String,
}

impl Running {
    fn start(name: &str, given: &[(SettingSource, &str)]) -> Result<Self, String> {
        let folder = tempfile::tempdir().unwrap();
        if name == "auth_dir" {
            let people = [("olga".to_owned(), Role::Operator)];
            issue::init(&Folder::new(folder.path().join("auth")), &[], &people).unwrap();
        }
        if name == "wasm" {
            check::write_modules(folder.path());
        }
        if name.starts_with("audit_") {
            effects::write_audit_lines(&folder.path().join("base"));
        }
        let log = folder.path().join("log");
        let mut command = serve(name, given, folder.path());
        command
            .stdout(Stdio::piped())
            .stderr(File::create(&log).unwrap());
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let process = Process(child, tempfile::tempdir().unwrap());
        let line = output.lines().next().transpose().unwrap();
        let endpoint = line
            .as_deref()
            .and_then(|it| it.strip_prefix("listening on "));
        match endpoint {
            Some(endpoint) => Ok(Running {
                _process: process,
                folder,
                endpoint: endpoint.to_owned(),
            }),
            None => Err(format!(
                "does not serve: {}",
                fs::read_to_string(log).unwrap()
            )),
        }
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }
}

/// The names in the file that `jostled config default` writes.
fn all_settings() -> BTreeSet<String> {
    let output = jostled().args(["config", "default"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let file: toml::Table = String::from_utf8(output.stdout).unwrap().parse().unwrap();
    assert!(!file.is_empty());
    file.keys().cloned().collect()
}

/// What is observed of a daemon that `row`'s setting is given in these ways, if it is not `expected`.
async fn compare(row: &Row, given: &[(SettingSource, &str)], expected: &str) -> Result<(), String> {
    let observed = match Running::start(row.name, given) {
        Ok(daemon) => effects::observe(row.name, &daemon, expected).await,
        Err(problem) => problem,
    };
    match observed == expected {
        true => Ok(()),
        false => Err(format!(
            "{} given as {given:?}: observed {observed:?}, expected {expected:?}",
            row.name
        )),
    }
}

#[test]
fn every_setting_that_config_default_writes_has_a_row_and_each_row_is_such_a_setting() {
    let rows: BTreeSet<String> = ROWS.iter().map(|row| row.name.to_owned()).collect();
    assert_eq!(rows, all_settings());
    assert_eq!(rows.len(), ROWS.len(), "a setting has two rows");
    for row in &ROWS {
        assert_ne!(row.value, row.other, "{}", row.name);
        assert_ne!(row.effect, row.other_effect, "{}", row.name);
    }
}

/// In each way the value takes effect over the other value in all weaker ways, and the other value
/// as a flag takes effect over the value in all weaker ways.
#[tokio::test(flavor = "multi_thread")]
async fn every_setting_acts_by_its_flag_over_its_variable_over_the_file() {
    let permits = Arc::new(Semaphore::new(AT_ONCE));
    let mut tasks = JoinSet::new();
    let mut count = 0;
    for row in &ROWS {
        let by = |strongest: usize, value: &'static str, weaker: &'static str| {
            let weak = SETTING_SOURCES[..strongest]
                .iter()
                .map(|way| (*way, weaker));
            weak.chain([(SETTING_SOURCES[strongest], value)])
                .collect::<Vec<_>>()
        };
        for (given, expected) in [
            (by(0, row.value, row.other), row.effect),
            (by(1, row.value, row.other), row.effect),
            (by(2, row.value, row.other), row.effect),
            (by(2, row.other, row.value), row.other_effect),
        ] {
            let permits = permits.clone();
            count += 1;
            tasks.spawn(async move {
                let _permit = permits.acquire().await.unwrap();
                compare(row, &given, expected).await
            });
        }
    }
    let results = tasks.join_all().await;
    assert_eq!(results.len(), count);
    let problems: Vec<String> = results.into_iter().filter_map(Result::err).collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// The message of a daemon that rejects a setting.
fn error_of(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{command:?}: {message}");
    assert!(output.stdout.is_empty(), "{output:?}");
    message
}

#[test]
fn a_bad_value_is_rejected_with_the_flag_variable_or_file_that_it_comes_from() {
    let numbers = ROWS.iter().filter(|row| row.bad == Some("0")).count();
    assert!(numbers >= 8, "{numbers}");
    for row in &ROWS {
        let Some(bad) = row.bad else { continue };
        for way in SETTING_SOURCES {
            let folder = tempfile::tempdir().unwrap();
            let message = error_of(&mut serve(row.name, &[(way, bad)], folder.path()));
            let place = match way {
                SettingSource::Flag => format!("flag {}", flag(row.name)),
                SettingSource::Variable => variable(row.name),
                SettingSource::File => folder.path().join("jostled.toml").display().to_string(),
            };
            assert!(message.contains(&place), "{place}: {message}");
            assert!(message.contains(bad), "{bad}: {message}");
        }
    }
}

#[test]
fn a_module_that_cannot_be_read_is_an_error_of_the_start() {
    for (file, problem) in [
        ("{folder}/nothing.gz", "No such file"),
        ("{folder}/jostled.toml", "no module compressed by gzip"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let given = [(SettingSource::File, file)];
        let message = error_of(&mut serve("wasm", &given, folder.path()));
        let path = file.replace("{folder}", folder.path().to_str().unwrap());
        assert!(
            message.contains(&format!("wasm module {path}: ")),
            "{message}"
        );
        assert!(message.contains(problem), "{message}");
    }
}

#[test]
fn a_setting_that_does_not_exist_is_rejected_by_flag_variable_and_file() {
    for (name, remedy) in [("wings", None), ("max_swarm", Some("max_swarms"))] {
        for way in SETTING_SOURCES {
            let folder = tempfile::tempdir().unwrap();
            let message = error_of(&mut serve(name, &[(way, "3")], folder.path()));
            let place = match way {
                SettingSource::Flag => flag(name),
                SettingSource::Variable => variable(name),
                SettingSource::File => folder.path().join("jostled.toml").display().to_string(),
            };
            assert!(message.contains(&place), "{place}: {message}");
            let remedy = remedy.map(|remedy| match way {
                SettingSource::Flag => flag(remedy),
                SettingSource::Variable => variable(remedy),
                SettingSource::File => remedy.to_owned(),
            });
            assert!(message.contains(&remedy.unwrap_or_default()), "{message}");
        }
    }
}
