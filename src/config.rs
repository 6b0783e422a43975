//! The daemon's settings: defaults, then a file, then the environment, then flags.
//!
//! Every value knows where it comes from, so that a refusal can name the place to mend. Values
//! are merged as text and read once, here.

pub mod explain;

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZero;
use std::path::{Path, PathBuf};

use jostle_proto::keys;
use thiserror::Error;

use crate::swarm::registry::Limits;

/// Every setting: its name, its default, and what it means.
///
/// The name is the same in the file, as a flag (`--max-hz`) and in the environment
/// (`JOSTLED_MAX_HZ`).
pub const SETTINGS: [(&str, &str, &str); 16] = [
    (
        "listen",
        "tcp/127.0.0.1:7447",
        "zenoh endpoints to listen on, separated by commas: tcp/127.0.0.1:PORT and \
         unixsock-stream/PATH for this machine, tls/ADDRESS:PORT for others, with an auth_dir",
    ),
    (
        "http",
        "127.0.0.1:8080",
        "where to serve HTTP, /healthz and /metrics: 127.0.0.1:PORT for this machine, \
         https://ADDRESS:PORT for others, with an auth_dir; nowhere if empty",
    ),
    (
        "node",
        "",
        "the daemon's name on the bus; the machine's name if left out",
    ),
    ("prefix", "jostle", "the first chunk of every key"),
    (
        "log",
        "info,zenoh=error",
        "what is logged, in the syntax of tracing's filters",
    ),
    ("log_format", "text", "text or json"),
    (
        "max_individuals",
        "2000",
        "individuals in one swarm; packed groups beyond a few hundred step slowly so far",
    ),
    ("max_swarms", "1024", "swarms at once"),
    (
        "max_memory_mb",
        "2048",
        "memory of all swarms together, in MiB",
    ),
    (
        "max_clients",
        "4000",
        "clients at once; to one more `hello` is refused",
    ),
    ("max_hz", "50", "states published per second and swarm"),
    (
        "data_dir",
        "",
        "the folder of everything that outlives the daemon; jostle/NODE below $STATE_DIRECTORY, \
         $XDG_STATE_HOME or ~/.local/state if left out",
    ),
    (
        "auth_dir",
        "",
        "the folder that `jostled auth init` made: who may do what; without it whoever reaches \
         the daemon may do everything",
    ),
    (
        "quota_mb",
        "64",
        "history kept of one swarm, in MiB; the oldest goes first",
    ),
    (
        "recordings_quota_mb",
        "10240",
        "all recordings of the daemon together, in MiB; one that reaches it ends, its swarm steps on",
    ),
    (
        "experiment_threads",
        "",
        "runs of an experiment at once; as many as there are cores if left out",
    ),
];

/// Where a value comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Nobody said otherwise.
    Default,
    /// This file.
    File(PathBuf),
    /// This environment variable.
    Environment(String),
    /// This flag.
    Flag(String),
}

impl fmt::Display for Source {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Default => formatter.write_str("the default"),
            Source::File(path) => write!(formatter, "{}", path.display()),
            Source::Environment(name) => write!(formatter, "the environment's {name}"),
            Source::Flag(name) => write!(formatter, "the flag {name}"),
        }
    }
}

/// Why the settings are refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {path}: {reason}")]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// There is no such setting.
    #[error("{source_}: there is no setting {name:?}; {remedy}")]
    Unknown {
        /// As it came.
        name: String,
        /// From where.
        source_: Source,
        /// The one that was probably meant, or those there are.
        remedy: String,
    },
    /// A value is not what the setting takes.
    #[error("{name} = {value:?} from {source_} is not {expected}")]
    Value {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// From where.
        source_: Source,
        /// What it takes.
        expected: String,
    },
}

/// The daemon's settings, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Where to serve HTTP; nowhere if empty.
    pub http: String,
    /// The daemon's name on the bus.
    pub node: String,
    /// The first chunk of every key.
    pub prefix: String,
    /// What is logged.
    pub log: String,
    /// Whether logs are JSON.
    pub logs_json: bool,
    /// What the daemon refuses to go beyond.
    pub limits: Limits,
    /// Clients at once.
    pub max_clients: usize,
    /// The folder of everything that outlives the daemon.
    pub data_dir: PathBuf,
    /// Who may do what; everybody everything if not given.
    pub auth_dir: Option<PathBuf>,
    /// History kept of one swarm, in bytes.
    pub quota_bytes: u64,
    /// All recordings together, in bytes.
    pub recordings_quota_bytes: u64,
    /// Runs of an experiment at once; as many as there are cores if not given.
    pub experiment_threads: Option<NonZero<usize>>,
}

/// Every setting's text and where it comes from.
pub type Merged = BTreeMap<&'static str, (String, Source)>;

/// Merges defaults, `file`, `environment` and `flags`, each over the one before.
///
/// # Errors
///
/// [`ConfigError`] when the file cannot be read, or something is set that does not exist.
pub fn merge(
    file: Option<&Path>,
    environment: impl Iterator<Item = (String, String)>,
    flags: &[(&'static str, Option<String>)],
) -> Result<Merged, ConfigError> {
    let mut merged: Merged = SETTINGS
        .iter()
        .map(|&(name, default, _)| (name, (default.to_owned(), Source::Default)))
        .collect();
    if let Some(path) = file {
        for (name, value) in read_file(path)? {
            let source = Source::File(path.to_owned());
            let name = known(&name, &source)?;
            merged.insert(name, (value, source));
        }
    }
    for (variable, value) in environment {
        if let Some(name) = variable.strip_prefix("JOSTLED_") {
            let source = Source::Environment(variable.clone());
            let name = known(&name.to_lowercase(), &source)?;
            merged.insert(name, (value, source));
        }
    }
    for (name, value) in flags {
        if let Some(value) = value {
            let source = Source::Flag(format!("--{}", name.replace('_', "-")));
            merged.insert(known(name, &source)?, (value.clone(), source));
        }
    }
    Ok(merged)
}

impl Config {
    /// Reads merged settings.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Value`] names the setting, its value and where it comes from.
    pub fn new(merged: &Merged) -> Result<Self, ConfigError> {
        let text = |name: &'static str| merged[name].0.trim().to_owned();
        let listen = endpoints(&text("listen"));
        if listen.is_empty() {
            return Err(wrong(merged, "listen", "at least one endpoint"));
        }
        let node = match text("node") {
            name if name.is_empty() => machine_name(),
            name if keys::is_name(&name) => name,
            _ => return Err(wrong(merged, "node", NAME)),
        };
        let prefix = text("prefix");
        if !keys::is_name(&prefix) {
            return Err(wrong(merged, "prefix", NAME));
        }
        let logs_json = match text("log_format").as_str() {
            "text" => false,
            "json" => true,
            _ => return Err(wrong(merged, "log_format", "text or json")),
        };
        let megabytes = number(merged, "max_memory_mb", 1 << 24)?;
        let data_dir = match text("data_dir") {
            folder if folder.is_empty() => state_folder(&node)
                .ok_or_else(|| wrong(merged, "data_dir", "a folder, and there is no $HOME"))?,
            folder => PathBuf::from(folder),
        };
        Ok(Config {
            data_dir,
            auth_dir: match text("auth_dir") {
                folder if folder.is_empty() => None,
                folder => Some(PathBuf::from(folder)),
            },
            experiment_threads: match text("experiment_threads") {
                text if text.is_empty() => None,
                _ => NonZero::new(number(merged, "experiment_threads", 1024)? as usize),
            },
            quota_bytes: u64::from(number(merged, "quota_mb", 1 << 20)?) << 20,
            recordings_quota_bytes: u64::from(number(merged, "recordings_quota_mb", 1 << 30)?)
                << 20,
            listen,
            http: text("http"),
            node,
            prefix,
            log: text("log"),
            logs_json,
            max_clients: number(merged, "max_clients", 100_000)? as usize,
            limits: Limits {
                max_individuals: number(merged, "max_individuals", 1_000_000)? as usize,
                max_swarms: number(merged, "max_swarms", 100_000)? as usize,
                max_memory_bytes: u64::from(megabytes) << 20,
                max_hz: number(merged, "max_hz", 10_000)?,
            },
        })
    }
}

/// The endpoints of a list with commas.
pub fn endpoints(listen: &str) -> Vec<String> {
    let endpoints = listen.split(',').map(|it| it.trim().to_owned());
    endpoints.filter(|it| !it.is_empty()).collect()
}

/// What a chunk of a key is.
const NAME: &str = "a name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit";

/// A whole number from 1 to `largest`.
fn number(merged: &Merged, name: &'static str, largest: u32) -> Result<u32, ConfigError> {
    match merged[name].0.trim().parse() {
        Ok(number) if (1..=largest).contains(&number) => Ok(number),
        _ => {
            let expected = format!("a whole number from 1 to {largest}");
            Err(wrong(merged, name, &expected))
        }
    }
}

fn wrong(merged: &Merged, name: &'static str, expected: &str) -> ConfigError {
    let (value, source) = merged[name].clone();
    ConfigError::Value {
        name,
        value,
        source_: source,
        expected: expected.to_owned(),
    }
}

fn known(name: &str, source: &Source) -> Result<&'static str, ConfigError> {
    let names = SETTINGS.map(|(name, ..)| name);
    if let Some(known) = names.into_iter().find(|known| *known == name) {
        return Ok(known);
    }
    let nearest = names.into_iter().min_by_key(|known| edits(name, known));
    let remedy = match nearest.filter(|nearest| 3 * edits(name, nearest) <= nearest.len()) {
        Some(nearest) => match source {
            Source::Environment(_) => format!("did you mean {}?", variable(nearest)),
            _ => format!("did you mean {nearest}?"),
        },
        None => format!("there are {}", names.join(", ")),
    };
    Err(ConfigError::Unknown {
        name: name.to_owned(),
        source_: source.clone(),
        remedy,
    })
}

/// The environment variable of a setting.
fn variable(name: &str) -> String {
    format!("JOSTLED_{}", name.to_uppercase())
}

/// How many letters must be put in, left out or changed to make `b` of `a`.
fn edits(a: &str, b: &str) -> usize {
    // What it takes to make each beginning of `b` of what was read of `a` so far.
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut corner = i;
        row[0] = i + 1;
        for (j, y) in b.chars().enumerate() {
            let changed = corner + usize::from(x != y);
            corner = row[j + 1];
            row[j + 1] = changed.min(corner + 1).min(row[j] + 1);
        }
    }
    row[row.len() - 1]
}

/// The settings in a TOML file, each as text. A list is joined by commas.
fn read_file(path: &Path) -> Result<Vec<(String, String)>, ConfigError> {
    let unreadable = |reason: String| ConfigError::Unreadable {
        path: path.to_owned(),
        reason,
    };
    let text = std::fs::read_to_string(path).map_err(|error| unreadable(error.to_string()))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
    let plain = |name: &str, value: &toml::Value| match value {
        toml::Value::String(text) => Ok(text.clone()),
        toml::Value::Integer(_) | toml::Value::Float(_) | toml::Value::Boolean(_) => {
            Ok(value.to_string())
        }
        _ => Err(unreadable(format!(
            "{name} is neither text nor a number, and there are no sections"
        ))),
    };
    table
        .iter()
        .map(|(name, value)| {
            let text = match value {
                toml::Value::Array(values) => values
                    .iter()
                    .map(|value| plain(name, value))
                    .collect::<Result<Vec<_>, _>>()?
                    .join(","),
                value => plain(name, value)?,
            };
            Ok((name.clone(), text))
        })
        .collect()
}

/// Where the system keeps what outlives a service.
fn state_folder(node: &str) -> Option<PathBuf> {
    let folder = |name: &str| {
        let value = std::env::var_os(name)?;
        (!value.is_empty()).then(|| PathBuf::from(value))
    };
    let base = folder("STATE_DIRECTORY")
        .or_else(|| folder("XDG_STATE_HOME"))
        .or_else(|| Some(folder("HOME")?.join(".local/state")))?;
    Some(base.join("jostle").join(node))
}

/// The machine's name, made a name of the bus.
fn machine_name() -> String {
    let uname = rustix::system::uname();
    let name: String = uname
        .nodename()
        .to_string_lossy()
        .to_lowercase()
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .take(keys::MAX_NAME_LENGTH)
        .collect();
    let name = name.trim_matches('-');
    if keys::is_name(name) {
        name.to_owned()
    } else {
        "node".to_owned()
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn environment(variables: &[(&str, &str)]) -> std::vec::IntoIter<(String, String)> {
        let pairs = variables.iter();
        pairs
            .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
            .collect::<Vec<_>>()
            .into_iter()
    }

    fn file(text: &str) -> PathBuf {
        use std::sync::atomic::{AtomicU32, Ordering};
        static FILES: AtomicU32 = AtomicU32::new(0);
        let number = FILES.fetch_add(1, Ordering::Relaxed);
        let name = format!("jostled-test-{}-{number}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn the_defaults_are_right() {
        let merged = merge(None, environment(&[]), &[]).unwrap();
        let config = Config::new(&merged).unwrap();
        assert_eq!(config.listen, ["tcp/127.0.0.1:7447"]);
        assert_eq!(config.http, "127.0.0.1:8080");
        assert!(keys::is_name(&config.node));
    }

    #[test]
    fn flags_go_over_the_environment_over_the_file_over_defaults() {
        let path = file("node = 'a'\nmax_swarms = 2\nmax_hz = 3\nlisten = ['x', 'y']\n");
        let merged = merge(
            Some(&path),
            environment(&[
                ("JOSTLED_MAX_SWARMS", "4"),
                ("JOSTLED_MAX_HZ", "5"),
                ("HOME", "/"),
            ]),
            &[("max_hz", Some("6".into())), ("log", None)],
        )
        .unwrap();
        std::fs::remove_file(&path).unwrap();
        let config = Config::new(&merged).unwrap();
        assert_eq!(config.node, "a");
        assert_eq!(config.listen, ["x", "y"]);
        assert_eq!(config.limits.max_swarms, 4);
        assert_eq!(config.limits.max_hz, 6);
        assert_eq!(merged["node"].1, Source::File(path));
        let variable = "JOSTLED_MAX_SWARMS".to_owned();
        assert_eq!(merged["max_swarms"].1, Source::Environment(variable));
        assert_eq!(merged["max_hz"].1, Source::Flag("--max-hz".into()));
        assert_eq!(merged["log"].1, Source::Default);
    }

    #[test]
    fn a_setting_that_does_not_exist_is_refused_with_the_one_that_was_meant() {
        let refused = |variable| {
            let merged = merge(None, environment(&[(variable, "4")]), &[]);
            merged.unwrap_err().to_string()
        };
        let typo = refused("JOSTLED_MAX_SWARM");
        assert!(typo.contains("did you mean JOSTLED_MAX_SWARMS?"), "{typo}");
        let strange = refused("JOSTLED_WINGS");
        assert!(
            strange.contains("there are listen, http, node"),
            "{strange}"
        );

        for (line, meant) in [("max-hz = 3", "max_hz"), ("lisen = 'x'", "listen")] {
            let path = file(line);
            let typo = merge(Some(&path), environment(&[]), &[]).unwrap_err();
            std::fs::remove_file(&path).unwrap();
            let typo = typo.to_string();
            assert!(typo.contains(&format!("did you mean {meant}?")), "{typo}");
            assert!(typo.contains(".toml"), "{typo}");
        }
    }

    #[test]
    fn edits_are_counted() {
        for (a, b, count) in [
            ("", "", 0),
            ("", "ab", 2),
            ("lisen", "listen", 1),
            ("ab", "ba", 2),
        ] {
            assert_eq!(edits(a, b), count, "{a} {b}");
            assert_eq!(edits(b, a), count, "{b} {a}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_place() {
        let path = file("max_swarms = 'many'\n");
        let merged = merge(Some(&path), environment(&[]), &[]).unwrap();
        let wrong = Config::new(&merged).unwrap_err().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(wrong.contains("many") && wrong.contains(".toml"), "{wrong}");

        let absent = merge(Some(Path::new("/nowhere.toml")), environment(&[]), &[]);
        assert!(matches!(absent, Err(ConfigError::Unreadable { .. })));

        for (name, bad) in [
            ("max_hz", "0"),
            ("max_hz", "-1"),
            ("max_hz", "1e3"),
            ("max_hz", "99999999999"),
            ("max_hz", ""),
            ("node", "no/name"),
            ("prefix", ""),
            ("prefix", "a/b"),
            ("listen", " , "),
            ("log_format", "xml"),
        ] {
            let flags = [(name, Some(bad.to_owned()))];
            let merged = merge(None, environment(&[]), &flags).unwrap();
            let refused = Config::new(&merged).unwrap_err().to_string();
            assert!(refused.starts_with(&format!("{name} = ")), "{refused}");
        }
    }
}
