//! A row of the table: a command line, what it sends, and what it prints and writes.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

use crate::support::canned::{Change, Sent};
use crate::support::{Canned, Ended, Running};

/// A command line with its expected requests and output.
#[derive(Clone)]
pub struct Row {
    /// The command line. A positional argument has its name before it, as in `<name>demo`; `{}` is
    /// a folder with files.
    pub line: String,
    /// The queries in order: a key without the prefix and, after a space, the arguments of a
    /// command. A query that is the same as the one before it is not repeated.
    pub sends: Vec<String>,
    /// Queries that contain one of these have another request id than the given one.
    unnamed: &'static [&'static str],
    says: Vec<&'static str>,
    says_not: Vec<&'static str>,
    writes: Vec<&'static str>,
    lists: Vec<&'static str>,
    changes: Vec<Change>,
    /// Text after which it is interrupted.
    interrupted_after: Option<&'static str>,
    apart: Duration,
    pub code: i32,
}

/// Additions to a row.
#[derive(Clone, Default)]
pub struct Added {
    /// More options.
    pub options: String,
    /// The prefix, if it is another.
    pub prefix: Option<&'static str>,
    /// The node, if it is another.
    pub node: Option<&'static str>,
    /// The attachment of each query.
    pub token: Option<&'static str>,
    /// Fields of the envelope of each command.
    pub envelope: Vec<(&'static str, Value)>,
}

/// A row that expects only queries.
pub fn row(line: impl Into<String>, sends: &[&str]) -> Row {
    Row {
        line: line.into(),
        sends: sends.iter().map(|it| (*it).to_owned()).collect(),
        unnamed: &[],
        says: Vec::new(),
        says_not: Vec::new(),
        writes: Vec::new(),
        lists: Vec::new(),
        changes: Vec::new(),
        interrupted_after: None,
        apart: Duration::ZERO,
        code: 0,
    }
}

impl Row {
    /// The given request id is not the one of queries that contain one of these.
    pub fn with_unnamed(mut self, queries: &'static [&'static str]) -> Self {
        self.unnamed = queries;
        self
    }

    /// It prints this.
    pub fn says(mut self, text: &'static str) -> Self {
        self.says.push(text);
        self
    }

    /// It does not print this.
    pub fn says_not(mut self, text: &'static str) -> Self {
        self.says_not.push(text);
        self
    }

    /// It writes this file into the folder.
    pub fn writes(mut self, file: &'static str) -> Self {
        self.writes.push(file);
        self
    }

    /// Changes a reply of the fixtures: the end of its key, a JSON pointer, the value.
    pub fn with(mut self, end: &'static str, pointer: &'static str, value: Value) -> Self {
        self.changes.push((end, pointer, value));
        self
    }

    /// Its last lines begin with these words, in this order.
    pub fn lists(mut self, words: &[&'static str]) -> Self {
        self.lists = words.to_vec();
        self
    }

    /// The reply is that of a scheduled command, so nothing else is printed.
    pub fn scheduled(mut self) -> Self {
        self.says = vec!["will be applied at step 71"];
        self.says_not.clear();
        self
    }

    /// It ends with this exit code.
    pub fn ends_with(mut self, code: i32) -> Self {
        self.code = code;
        self
    }

    /// The last query comes at least `secs` after the first.
    pub fn lasts(mut self, secs: f64) -> Self {
        self.apart = Duration::from_secs_f64(secs);
        self
    }

    /// It runs on after it has printed this, until it is interrupted.
    pub fn goes_on_after(mut self, text: &'static str) -> Self {
        self.interrupted_after = Some(text);
        self.code = 130;
        self
    }

    /// The arguments that it has, as `surface.txt` names them.
    pub fn arguments(&self) -> BTreeSet<String> {
        let name = |word: &str| match word.split_once('>') {
            Some((name, _)) if word.starts_with('<') => Some(format!("{name}>")),
            _ if word.starts_with("--") => Some(word.split('=').next()?.to_owned()),
            _ if is_short(word) => Some(word.to_owned()),
            _ => None,
        };
        self.line.split(' ').filter_map(name).collect()
    }

    /// The command line as it is typed.
    pub fn typed(&self, folder: &Path) -> String {
        let bare = |word: &str| match word.split_once('>') {
            Some((_, value)) if word.starts_with('<') => value.to_owned(),
            _ => word.to_owned(),
        };
        let words: Vec<String> = self.line.split(' ').map(bare).collect();
        words.join(" ").replace("{}", folder.to_str().unwrap())
    }

    /// Whether it ends by itself, without an error.
    pub fn ends(&self) -> bool {
        self.code == 0
    }

    /// Whether it has the credentials of anna.
    pub fn is_of_anna(&self) -> bool {
        self.arguments().contains("--credentials")
    }

    /// Prepares the replies.
    pub fn prepare(&self, canned: &Canned) {
        canned.reply_with(&self.changes);
    }

    /// Runs the command line and compares requests and output.
    pub async fn check(&self, canned: &Canned, folder: &Path, added: &Added) {
        canned.reply_with(&self.changes);
        canned.take();
        let line = format!("{}{}", self.typed(folder), added.options);
        let line = line.replace("{}", folder.to_str().unwrap());
        let mut running = Running::begin(&canned.endpoint, &line, "");
        let mut printed = String::new();
        if let Some(text) = self.interrupted_after {
            while !printed.contains(text) {
                printed.push_str(&running.lines(1)[0]);
                printed.push('\n');
            }
            running.interrupt();
        }
        let ended = running.end().await;
        let sent = canned.take();
        self.judge(&line, folder, &printed, &ended, &sent);
        let expected: Vec<_> = self
            .sends
            .iter()
            .map(|it| self.expected(it, folder, added))
            .collect();
        let sent: Vec<_> = sent.iter().map(seen).collect();
        let mut sent_once = sent.clone();
        sent_once.dedup();
        // A client asks for the daemon that it is to use, which has no token here.
        let asks = |query: &Query| query.0.ends_with("/get/hello");
        if added.node.is_some()
            && sent_once.first().is_some_and(asks)
            && !expected.first().is_some_and(asks)
        {
            sent_once.remove(0);
        }
        // It asks for the data of the daemon before it sends a command for the first time.
        let first = sent_once.iter().position(|it| it.0.contains("/cmd/"));
        if let Some(before) = first.and_then(|first| first.checked_sub(1))
            && asks(&sent_once[before])
            && !expected.get(before).is_some_and(asks)
        {
            sent_once.remove(before);
        }
        assert_eq!(sent_once, expected, "{line}: {ended:?}");
    }

    /// A query as the table has it.
    fn expected(&self, send: &str, folder: &Path, added: &Added) -> Query {
        // The name of a run in a key may contain a space.
        let at = send.find(" {").unwrap_or(send.len());
        let (key, args) = (&send[..at], send[at..].trim_start());
        let prefix = added.prefix.unwrap_or("jostle");
        let key = match added.node {
            Some(node) => key.replace("@node/test/", &format!("@node/{node}/")),
            None => key.to_owned(),
        };
        // The timeout of a verification is in its selector.
        let of_timeout = |(field, _): &&(&str, Value)| *field == "timeout_secs";
        let key = match (
            key.split_once("verify?timeout_secs="),
            added.envelope.iter().find(of_timeout),
        ) {
            (Some((start, _)), Some((_, secs))) => format!("{start}verify?timeout_secs={secs}"),
            _ => key,
        };
        let payload = match args {
            "" => Value::Null,
            args => {
                let args = args.replace("<snapshot>", &snapshot(folder));
                let mut payload = json!({
                    "request_id": "<new>", "client": "tester@<host>", "timeout_secs": 5.0,
                });
                payload["args"] = serde_json::from_str(&args).unwrap();
                let is_named = !self.unnamed.iter().any(|it| send.contains(it));
                for (field, value) in &added.envelope {
                    if is_named || *field != "request_id" {
                        payload[*field] = value.clone();
                    }
                }
                payload
            }
        };
        let token = added.token.map(str::to_owned);
        (format!("{prefix}/{key}"), payload, token)
    }

    fn judge(&self, line: &str, folder: &Path, printed: &str, ended: &Ended, sent: &[Sent]) {
        assert_eq!(ended.code, Some(self.code), "{line}: {ended:?}");
        let said = format!("{printed}{}\n{}", ended.stdout, ended.stderr);
        for text in &self.says {
            let text = text.replace("{}", folder.to_str().unwrap());
            assert!(said.contains(&text), "{line} does not say {text}: {said}");
        }
        for text in &self.says_not {
            assert!(!said.contains(text), "{line} says {text}: {said}");
        }
        let lines = ended.stdout.lines();
        let firsts: Vec<_> = lines
            .filter_map(|it| it.split_whitespace().next())
            .collect();
        let listed = &firsts[firsts.len().saturating_sub(self.lists.len())..];
        assert!(
            self.lists.is_empty() || listed == self.lists,
            "{line}: {said}"
        );
        for file in &self.writes {
            let length = folder.join(file).metadata().map_or(0, |it| it.len());
            assert!(length > 0, "{line} does not write {file}");
        }
        if let (Some(first), Some(last)) = (sent.first(), sent.last()) {
            let apart = last.at - first.at;
            assert!(
                apart >= self.apart,
                "{line}: {apart:?} from first to last query"
            );
        }
    }
}

fn is_short(word: &str) -> bool {
    word.len() == 2 && word.starts_with('-') && word.as_bytes()[1].is_ascii_alphabetic()
}

/// A query: its selector, its payload and its attachment.
type Query = (String, Value, Option<String>);

/// A received query, without what differs from run to run.
fn seen(sent: &Sent) -> Query {
    let mut payload = sent.payload.clone().unwrap_or_default();
    if let Some(id) = payload["request_id"].as_str() {
        // A new one is the session's id and a number.
        let is_new = id
            .rsplit_once('-')
            .is_some_and(|(session, number)| session.len() > 16 && number.parse::<u64>().is_ok());
        if is_new {
            payload["request_id"] = "<new>".into();
        }
    }
    if let Some(client) = payload["client"].as_str()
        && client.starts_with("tester@")
        && client.len() > "tester@".len()
    {
        payload["client"] = "tester@<host>".into();
    }
    if let Some(left) = payload["timeout_secs"].as_f64() {
        // The client has used some of it before.
        payload["timeout_secs"] = json!((2.0 * left).ceil() / 2.0);
    }
    (sent.selector.clone(), payload, sent.token.clone())
}

fn snapshot(folder: &Path) -> String {
    use base64::Engine as _;
    let bytes = std::fs::read(folder.join("demo.snapshot")).unwrap_or_default();
    base64::engine::general_purpose::STANDARD.encode(bytes)
}
