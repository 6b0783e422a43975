//! Every generated file, by its path below `proto/`.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use jostle_proto::asyncapi::{self, Examples};
use jostle_proto::contract::{self, CHANNELS, ChannelKind, Visitor};
use jostle_proto::verbs::of_controllers;
use jostle_proto::{Arguments, Request};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

mod python;
mod typescript;

/// The folder `proto/`.
pub fn folder() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Every file that is made from the contract.
///
/// # Errors
/// A file below `proto/` cannot be read.
pub fn files() -> io::Result<BTreeMap<PathBuf, String>> {
    let mut files = BTreeMap::new();
    let documents = contract::documents().map_err(io::Error::other)?;
    let package = Path::new("../clients/python/src/jostle");
    for (name, text) in python::files(&documents)? {
        files.insert(package.join(name), text);
    }
    for (name, document) in documents {
        let (types, title) = match name {
            "sent.json" => (
                "messages.ts",
                "What a daemon sends. A newer one may send more, and fields with `?` may be missing.",
            ),
            _ => (
                "requests.ts",
                "What a daemon receives; it rejects unknown fields.",
            ),
        };
        let page = Path::new("../clients/web/src/wire");
        let mut text = typescript::types(&document, title);
        if types == "requests.ts" {
            let verbs: Vec<&str> = of_controllers().collect();
            let verbs = serde_json::to_string(&verbs)?.replace("\",\"", "\", \"");
            text += &format!(
                "\n/** The commands that a controller may send. */\nexport const OF_CONTROLLERS = {verbs};\n"
            );
        }
        files.insert(page.join(types), text);
        let text = serde_json::to_string_pretty(&document)? + "\n";
        files.insert(Path::new("schema").join(name), text);
    }
    let document = asyncapi::document(&examples()?);
    let text = serde_json::to_string_pretty(&document)? + "\n";
    files.insert("asyncapi.json".into(), text);
    let readme = fs::read_to_string(folder().join("README.md"))?;
    files.insert("README.md".into(), with_tables(&readme));
    Ok(files)
}

/// Reads a message into its type and writes it back, in the order of the type's fields. What a daemon
/// receives is read as a daemon does, what it sends as a client does.
///
/// # Errors
/// There is no such message, or `text` is none of it.
pub fn rewrite(message: &str, text: &str) -> Result<String, String> {
    let written = contract::visit(message, Rewriter(text));
    written.unwrap_or_else(|| Err(format!("there is no message {message}")))
}

struct Rewriter<'a>(&'a str);

impl Rewriter<'_> {
    fn request(&self) -> Result<Request, String> {
        Request::from_json(self.0.as_bytes()).map_err(|it| it.to_string())
    }

    fn write(message: &impl Serialize) -> Result<String, String> {
        serde_json::to_string_pretty(message).map_err(|it| it.to_string())
    }
}

impl Visitor for Rewriter<'_> {
    type Output = Result<String, String>;

    fn request(self) -> Self::Output {
        Self::write(&Rewriter::request(&self)?)
    }

    fn received<T: Arguments + Serialize>(self) -> Self::Output {
        let args: T = Rewriter::request(&self)?
            .args()
            .map_err(|it| it.to_string())?;
        Self::write(&args)
    }

    fn sent<T: JsonSchema + DeserializeOwned + Serialize>(self) -> Self::Output {
        let message: T = serde_json::from_str(self.0).map_err(|it| it.to_string())?;
        Self::write(&message)
    }
}

/// Every fixture in JSON: its message, its name below that message, its text.
///
/// # Errors
/// A fixture cannot be read, or its name is of no message.
pub fn fixtures() -> io::Result<Vec<(&'static str, String, String)>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder().join("fixtures"))?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<io::Result<_>>()?;
    paths.sort();
    let mut fixtures = Vec::new();
    for path in paths {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        if path.extension().is_none_or(|it| it != "json") {
            continue;
        }
        let (message, variant) = message(&stem)
            .ok_or_else(|| io::Error::other(format!("{stem}: there is no such message")))?;
        fixtures.push((message, variant, fs::read_to_string(path)?));
    }
    Ok(fixtures)
}

/// The message that a fixture is of, and what is left of its name.
pub fn message(stem: &str) -> Option<(&'static str, String)> {
    let named = contract::messages().into_iter().filter_map(|message| {
        let rest = stem.strip_prefix(message)?;
        match rest.strip_prefix('.') {
            Some(variant) => Some((message, variant.to_owned())),
            None => rest.is_empty().then(|| (message, message.to_owned())),
        }
    });
    named.max_by_key(|(message, _)| message.len())
}

fn examples() -> io::Result<Examples> {
    let mut examples = Examples::new();
    for (message, variant, text) in fixtures()? {
        let payload: Value = serde_json::from_str(&text)?;
        examples
            .entry(message)
            .or_default()
            .push((variant, payload));
    }
    Ok(examples)
}

/// The text between two marks, `<!-- keys -->` and `<!-- /keys -->`, made anew.
fn with_tables(readme: &str) -> String {
    let (begin, end) = ("<!-- keys -->\n", "<!-- /keys -->");
    let (Some(at), Some(until)) = (readme.find(begin), readme.find(end)) else {
        return readme.to_owned();
    };
    let table = keys();
    format!("{}{table}{}", &readme[..at + begin.len()], &readme[until..])
}

/// The table of keys.
fn keys() -> String {
    let mut table =
        "| key below the prefix | use | messages | meaning and parameters |\n|---|---|---|---|\n"
            .to_owned();
    for channel in CHANNELS.iter() {
        let (how, message) = match channel.kind {
            ChannelKind::Published(message) => ("published", format!("`{message}`")),
            ChannelKind::PublishedAndQueried(message) => {
                ("published; query", format!("`{message}`"))
            }
            ChannelKind::Token => ("liveliness token", String::new()),
            ChannelKind::Put(message) => ("put by a client", format!("`{message}`")),
            ChannelKind::ClientToken => ("a client's liveliness token", String::new()),
            ChannelKind::Get(reply) => ("query", format!("`{reply}`")),
            ChannelKind::Command(verb) => {
                let (args, reply) = (verb.args, verb.reply);
                ("command", format!("`{args}`, `{reply}`"))
            }
        };
        let parameters: Vec<String> = channel
            .parameters
            .iter()
            .map(|it| format!("`{}`: {}{}", it.name, it.range, it.doc))
            .collect();
        let what = match parameters.as_slice() {
            [] => channel.doc.to_owned(),
            parameters => format!("{} {}.", channel.doc, parameters.join("; ")),
        };
        table += &format!("| `{}` | {how} | {message} | {what} |\n", channel.key);
    }
    table
}
