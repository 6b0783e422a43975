//! Every exit code: each verb with each kind of error, for people and with `--json`.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::{Value, json};
use tokio::task::JoinSet;

use crate::requests::{bases, files, rows, surface, verb};
use crate::support::canned::{self, Canned};
use crate::support::{Ended, Running, TIMEOUT};

/// The exit code of each error code of the contract.
const OF_THE_DAEMON: [(&str, i32); 13] = [
    ("internal", 1),
    ("faulted", 1),
    ("invalid_argument", 2),
    ("not_found", 3),
    ("conflict", 4),
    ("contested", 4),
    ("incorrect_state", 4),
    ("already_exists", 4),
    ("permission_denied", 5),
    ("deadline_exceeded", 6),
    ("busy", 7),
    ("resource_exhausted", 7),
    ("storage_full", 8),
];

/// The exit code of each error code of the client.
const OF_THE_CLIENT: [(&str, i32); 4] = [
    ("different", 1),
    ("unreachable", 6),
    ("timeout", 6),
    ("mismatch", 9),
];

/// The verb that prints errors and exits with 0: a list of nodes, of which one fails.
const LISTS_ERRORS: &str = "nodes";

/// The verbs without requests, or without requests in the form of the table.
const LOCAL: [&str; 8] = [
    "auth link",
    "check",
    "claims",
    "completions",
    "experiment plan",
    "jostle",
    "man",
    "results merge",
];

/// Forms of verbs that send other requests than the first row of the verb.
const FORMS: [&str; 7] = [
    "delete <names>demo --node test",
    "delete <names>demo twin",
    "record --fetch school-1 -o {}/kept.mcap",
    "record <name>demo --at-daemon",
    "record <name>demo -o {}/short.mcap --for 0.1",
    "record <name>demo -o {}/published.mcap --published --for 0.2 --every 5",
    "watch <name>demo --count 1 --frames",
];

/// How many command lines run at once.
const AT_ONCE: usize = 6;

/// A command line with its expected error.
#[derive(Clone)]
struct Case {
    /// `{}` is a folder with files.
    line: String,
    /// The first `--timeout`, seconds.
    timeout: Option<f64>,
    replies: Replies,
    /// The exit code, and the word for it in JSON.
    code: i32,
    word: &'static str,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Replies {
    /// The error of the word.
    Error,
    /// None.
    Never,
    /// None, and Ctrl-C is pressed when the first query has come.
    Interrupted,
    /// There is nothing to reply.
    Nowhere,
}

/// Each verb that sends anything, as it is typed in `folder`.
fn lines() -> Vec<(String, String)> {
    let typed = std::path::Path::new("{}");
    let mut lines: Vec<(String, String)> = bases()
        .into_iter()
        .map(|(verb, row)| (verb, row.typed(typed)))
        .collect();
    for form in FORMS {
        let rows = rows();
        let row = rows.iter().find(|row| row.line == form).expect(form);
        lines.push((verb(row), row.typed(typed)));
    }
    let listed: BTreeSet<&str> = lines.iter().map(|(verb, _)| verb.as_str()).collect();
    let all = surface();
    let missing = all
        .keys()
        .map(String::as_str)
        .filter(|it| !listed.contains(it));
    assert_eq!(missing.collect::<Vec<_>>(), LOCAL, "these send nothing");
    lines
}

/// Checks cases with and without `--json`, some at once.
async fn check_all(cases: Vec<Case>) {
    assert!(cases.len() >= 40, "{}", cases.len());
    let (cases, next) = (Arc::new(cases), Arc::new(AtomicUsize::new(0)));
    let mut workers = JoinSet::new();
    for _ in 0..AT_ONCE {
        let (cases, next) = (cases.clone(), next.clone());
        workers.spawn(async move {
            let (canned, folder) = (Canned::start().await, files());
            let folder_name = folder.path().to_str().unwrap();
            while let Some(case) = cases.get(next.fetch_add(1, Ordering::SeqCst)) {
                for json in ["", " --json"] {
                    let line = case.line.replace("{}", folder_name);
                    let ended = case.end(&canned, &format!("{line}{json}")).await;
                    case.judge(&ended, !json.is_empty());
                }
            }
            canned.stop().await;
        });
    }
    while let Some(worker) = workers.join_next().await {
        worker.unwrap();
    }
}

impl Case {
    /// Runs it to its end, with its timeout if it has one. On a busy machine a command line may not reach
    /// the peer in time, or the reply may come too late, which the command line then says: it gets twice the
    /// time, until the peer's error is what ends it.
    async fn end(&self, canned: &Canned, line: &str) -> Ended {
        let Some(mut timeout) = self.timeout else {
            return self.run(canned, line).await;
        };
        loop {
            let ended = self
                .run(canned, &format!("{line} --timeout {timeout}"))
                .await;
            if !self.is_too_late(&ended) || timeout > TIMEOUT.as_secs_f64() / 2.0 {
                return ended;
            }
            timeout *= 2.0;
        }
    }

    /// Whether it ended before what it is to report could happen.
    fn is_too_late(&self, ended: &Ended) -> bool {
        match self.replies {
            Replies::Error => says(ended, "unreachable") || says(ended, "timeout"),
            Replies::Never => says(ended, "unreachable"),
            Replies::Interrupted | Replies::Nowhere => false,
        }
    }

    async fn run(&self, canned: &Canned, line: &str) -> Ended {
        let endpoint = match self.replies {
            Replies::Nowhere => "tcp/127.0.0.1:1",
            _ => &canned.endpoint,
        };
        match self.replies {
            Replies::Error => canned.refuse(canned::error(self.word)),
            Replies::Never | Replies::Interrupted | Replies::Nowhere => canned.hold(),
        }
        canned.take();
        let mut running = Running::begin(endpoint, line, "");
        if self.replies == Replies::Interrupted {
            canned.until_sent(1, &mut running).await;
            running.interrupt();
        }
        running.end().await
    }

    fn judge(&self, ended: &Ended, is_json: bool) {
        let line = format!("{} ({})", self.line, self.word);
        assert_eq!(ended.code, Some(self.code), "{line}: {ended:?}");
        let last = ended.stderr.lines().last().unwrap_or_default();
        if self.code == 0 && is_json {
            let listed: Value = serde_json::from_str(&ended.stdout).expect(&line);
            let error = &listed["nodes"][0]["error"];
            assert_eq!(error["code"], self.word, "{line}: {ended:?}");
        } else if self.code == 0 {
            // A row without values, and the error.
            assert!(ended.stdout.contains('-'), "{line}: {ended:?}");
            assert!(!ended.stderr.is_empty(), "{line}: {ended:?}");
        } else if is_json {
            let error: Value = serde_json::from_str(last).expect(&line);
            assert_eq!(error["code"], self.word, "{line}: {ended:?}");
            let fields = ["message", "details", "step"];
            let has = |field: &&str| error.get(field).is_some();
            assert!(fields.iter().all(has), "{line}: {error}");
        } else if self.word != "interrupted" {
            // Of an error of the command line, clap prints the usage too.
            let is_said = ["jostle: ", "error: "]
                .iter()
                .any(|it| ended.stderr.contains(it));
            assert!(is_said, "{line}: {ended:?}");
        }
    }
}

/// Whether a command line reports this error of the client, for people or in JSON.
fn says(ended: &Ended, word: &str) -> bool {
    let phrases: &[&str] = match word {
        "unreachable" => &[
            "but sent no reply within",
            "no daemon answers",
            "no daemon is reachable",
        ],
        _ => &["did not reply within"],
    };
    let is_quoted = |text: &str| text.contains(&format!("\"code\":\"{word}\""));
    let is_said = phrases.iter().any(|it| ended.stderr.contains(it));
    is_said || is_quoted(&ended.stderr) || is_quoted(&ended.stdout)
}

/// The words of the page with their exit codes.
fn page(help: &str) -> BTreeMap<String, i32> {
    let (_, table) = help
        .split_once("Exit codes:\n")
        .expect("the page has a table");
    let mut codes = BTreeMap::new();
    for line in table.lines() {
        let line = line.trim();
        let code = line.split(' ').next().and_then(|it| it.parse().ok());
        let words = line.strip_suffix(')').and_then(|it| it.rsplit_once('('));
        if let (Some(code), Some((_, words))) = (code, words) {
            codes.extend(words.split(", ").map(|word| (word.to_owned(), code)));
        }
    }
    codes
}

/// The words for kinds of errors in the contract.
fn contract() -> BTreeSet<String> {
    fn words(value: &Value, found: &mut BTreeSet<String>) {
        match value {
            Value::Object(fields) => {
                for (name, value) in fields {
                    match value {
                        Value::String(word) if name == "const" => {
                            found.insert(word.clone());
                        }
                        Value::Array(all) if name == "enum" => {
                            found.extend(all.iter().filter_map(Value::as_str).map(str::to_owned));
                        }
                        value => words(value, found),
                    }
                }
            }
            Value::Array(values) => values.iter().for_each(|it| words(it, found)),
            _ => {}
        }
    }
    let schema = json!(jostle_proto::contract::schemas()["error"]);
    let mut found = BTreeSet::new();
    words(&schema, &mut found);
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_and_the_contract_have_the_kinds_of_errors_of_this_table() {
    let words = OF_THE_DAEMON.map(|(word, _)| word.to_owned());
    assert_eq!(contract(), words.into(), "each kind of the contract");
    let all = OF_THE_DAEMON.into_iter().chain(OF_THE_CLIENT);
    let all: BTreeMap<String, i32> = all.map(|(word, code)| (word.to_owned(), code)).collect();
    let help = Running::begin("tcp/127.0.0.1:1", "--help", "").end().await;
    assert_eq!(page(&help.stdout), all, "{}", help.stdout);
    for line in ["    0  done", "  130  interrupted"] {
        assert!(help.stdout.contains(line), "{}", help.stdout);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_ends_with_the_code_of_each_kind_of_error() {
    let mut cases = Vec::new();
    for (verb, line) in lines() {
        for (word, code) in OF_THE_DAEMON {
            cases.push(Case {
                line: line.clone(),
                timeout: Some(0.3),
                replies: Replies::Error,
                code: if verb == LISTS_ERRORS { 0 } else { code },
                word,
            });
        }
    }
    check_all(cases).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_reports_an_unreachable_daemon() {
    let case = |(_, line)| Case {
        line,
        timeout: Some(0.2),
        replies: Replies::Nowhere,
        code: 6,
        word: "unreachable",
    };
    check_all(lines().into_iter().map(case).collect()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_ends_when_the_daemon_does_not_reply_in_time() {
    let case = |(verb, line): (String, String)| Case {
        line,
        timeout: Some(0.3),
        replies: Replies::Never,
        code: if verb == LISTS_ERRORS { 0 } else { 6 },
        word: "timeout",
    };
    check_all(lines().into_iter().map(case).collect()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_ends_at_ctrl_c_while_it_waits() {
    let case = |(_, line)| Case {
        line,
        timeout: Some(TIMEOUT.as_secs_f64()),
        replies: Replies::Interrupted,
        code: 130,
        word: "interrupted",
    };
    check_all(lines().into_iter().map(case).collect()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_refuses_an_option_that_it_does_not_have() {
    let case = |verb: String| Case {
        line: match verb.as_str() {
            "jostle" => "--no-such-option".to_owned(),
            verb => format!("{verb} --no-such-option"),
        },
        timeout: None,
        replies: Replies::Nowhere,
        code: 2,
        word: "invalid_argument",
    };
    check_all(surface().into_keys().map(case).collect()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn verbs_without_a_daemon_have_exit_codes_too() {
    let canned = Canned::start().await;
    let folder = files();
    for (line, code, word) in [
        ("auth link", 2, "invalid_argument"),
        ("claims {}/nothing", 2, "invalid_argument"),
        ("completions tcsh", 2, "invalid_argument"),
        ("figure 2 {}/nothing -o {}/a.svg", 2, "invalid_argument"),
        ("man -o {}/present", 1, "internal"),
        ("record --recover {}/nothing.mcap", 1, "internal"),
        ("record demo -o {}/nowhere/take.mcap", 1, "internal"),
    ] {
        let typed = line.replace("{}", folder.path().to_str().unwrap());
        let case = Case {
            line: line.to_owned(),
            timeout: None,
            replies: Replies::Never,
            code,
            word,
        };
        for json in ["", " --json"] {
            let line = match line {
                // It has no `--json`.
                "auth link" if !json.is_empty() => continue,
                _ => format!("{typed}{json}"),
            };
            let ended = case.run(&canned, &line).await;
            case.judge(&ended, !json.is_empty());
        }
    }
    canned.reply_with(&[
        ("get/verify", "/result/differs_at", json!(800)),
        ("get/verify", "/result/differs_in_epoch", json!(2)),
    ]);
    let ended = Running::begin(&canned.endpoint, "verify demo --json", "")
        .end()
        .await;
    ended.assert_stderr(9, "\"mismatch\"");
    let mut unread = Running::begin(&canned.endpoint, "top --interval 0.05 --json", "");
    unread.lines(1);
    unread.stop_reading();
    assert_eq!(unread.end().await.code, Some(0), "its stdout is closed");
    canned.stop().await;
}
