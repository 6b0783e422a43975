//! The checked settings of the daemon; `src/cli/settings.rs` reads them.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZero;
use std::path::PathBuf;
use std::thread;

use jostle_proto::keys;
use thiserror::Error;

use crate::swarm::registry::Limits;

/// Where the value of a setting comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The built-in default.
    Default,
    /// This settings file.
    File(PathBuf),
    /// This environment variable.
    Environment(String),
    /// This command-line flag.
    Flag(String),
}

impl fmt::Display for Source {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Default => formatter.write_str("default"),
            Source::File(path) => write!(formatter, "{}", path.display()),
            Source::Environment(name) => write!(formatter, "environment variable {name}"),
            Source::Flag(name) => write!(formatter, "flag {name}"),
        }
    }
}

/// Why settings are rejected.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The settings file cannot be read or parsed.
    #[error("cannot read {path}: {reason}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
    /// No setting has this name.
    #[error("unknown setting {name:?} from {origin}: {remedy}")]
    Unknown {
        /// The name.
        name: String,
        /// Where it is set.
        origin: Source,
        /// A similar name, or all names.
        remedy: String,
    },
    /// The value of a setting is invalid.
    #[error("{name} = {value:?} from {origin} is not {expected}")]
    Value {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// Where it is set.
        origin: Source,
        /// The valid values.
        expected: String,
    },
}

/// The daemon's settings, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Zenoh endpoints to listen on.
    pub listen: Vec<String>,
    /// Address of the HTTP server; empty for none.
    pub http: String,
    /// The daemon's name in keys.
    pub node: String,
    /// The first chunk of every key.
    pub prefix: String,
    /// The log filter.
    pub log: String,
    /// Whether log lines are JSON.
    pub logs_json: bool,
    /// Limits on swarms.
    pub limits: Limits,
    /// Maximum number of clients.
    pub max_clients: usize,
    /// Folder of all persistent data.
    pub data_dir: PathBuf,
    /// Folder of users and roles; without it every client may do everything.
    pub auth_dir: Option<PathBuf>,
    /// Maximum size of the history of one swarm, in bytes.
    pub quota_bytes: u64,
    /// Maximum size of the audit log, in bytes.
    pub audit_bytes: u64,
    /// Maximum age of its lines, in milliseconds.
    pub audit_ms: u64,
    /// Maximum size of all recordings, in bytes.
    pub recordings_quota_bytes: u64,
    /// Maximum size of all experiments, in bytes; `None` for the whole disk.
    pub experiments_quota_bytes: Option<u64>,
    /// Maximum number of experiment runs in parallel; `None` for the number of cores.
    pub experiment_threads: Option<NonZero<usize>>,
    /// The wasm module that the page steps swarms with; `None` for the installed one, if there is one.
    pub wasm: Option<PathBuf>,
}

/// The value of each setting, by name, and where it comes from.
pub type Resolved = BTreeMap<String, (String, Source)>;

/// The milliseconds of a day.
const DAY_MS: u64 = 24 * 60 * 60 * 1000;

const NAME: &str = "a name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit";

impl Config {
    /// Checks settings.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Value`].
    pub fn new(resolved: &Resolved) -> Result<Self, ConfigError> {
        let text = |name: &str| resolved[name].0.trim().to_owned();
        let some_text = |name: &str| Some(text(name)).filter(|text| !text.is_empty());
        let invalid = |name: &'static str, expected: &str| {
            let (value, origin) = resolved[name].clone();
            ConfigError::Value {
                name,
                value,
                origin,
                expected: expected.to_owned(),
            }
        };
        let number = |name: &'static str, max: u32| match text(name).parse() {
            Ok(number) if (1..=max).contains(&number) => Ok(number),
            _ => Err(invalid(name, &format!("a whole number from 1 to {max}"))),
        };
        let mebibytes = |name, max| number(name, max).map(|mebibytes| u64::from(mebibytes) << 20);
        let listen = endpoints(&text("listen"));
        if listen.is_empty() {
            return Err(invalid("listen", "at least one endpoint"));
        }
        let node = some_text("node").unwrap_or_else(machine_name);
        let prefix = text("prefix");
        for (name, value) in [("node", &node), ("prefix", &prefix)] {
            if !keys::is_name(value) {
                return Err(invalid(name, NAME));
            }
        }
        let logs_json = match text("log_format").as_str() {
            "text" => false,
            "json" => true,
            _ => return Err(invalid("log_format", "text or json")),
        };
        let data_dir = some_text("data_dir")
            .map(PathBuf::from)
            .or_else(|| state_folder(&node))
            .ok_or_else(|| invalid("data_dir", "a folder, and there is no $HOME"))?;
        let experiment_threads = match some_text("experiment_threads") {
            None => None,
            Some(_) => NonZero::new(number("experiment_threads", 1024)? as usize),
        };
        let experiments_quota_bytes = match some_text("experiments_quota_mb") {
            None => None,
            Some(_) => Some(mebibytes("experiments_quota_mb", 1 << 30)?),
        };
        Ok(Config {
            listen,
            http: text("http"),
            node,
            prefix,
            log: text("log"),
            logs_json,
            limits: Limits {
                max_individuals: number("max_individuals", 1_000_000)? as usize,
                max_swarms: number("max_swarms", 100_000)? as usize,
                max_memory_bytes: mebibytes("max_memory_mb", 1 << 24)?,
                max_hz: number("max_hz", 10_000)?,
            },
            max_clients: number("max_clients", 100_000)? as usize,
            data_dir,
            auth_dir: some_text("auth_dir").map(PathBuf::from),
            quota_bytes: mebibytes("quota_mb", 1 << 20)?,
            audit_bytes: mebibytes("audit_mb", 1 << 20)?,
            audit_ms: u64::from(number("audit_days", 36_500)?) * DAY_MS,
            recordings_quota_bytes: mebibytes("recordings_quota_mb", 1 << 30)?,
            experiments_quota_bytes,
            experiment_threads,
            wasm: some_text("wasm").map(PathBuf::from),
        })
    }
}

impl Config {
    /// Maximum number of experiment runs in parallel.
    pub fn experiment_threads(&self) -> usize {
        let cores = || thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
        self.experiment_threads.unwrap_or_else(cores).get()
    }
}

/// Splits a comma-separated list of endpoints.
pub fn endpoints(listen: &str) -> Vec<String> {
    let endpoints = listen.split(',').map(|it| it.trim().to_owned());
    endpoints.filter(|it| !it.is_empty()).collect()
}

/// The default of `data_dir`.
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

/// The default of `node`: the host name, with each character that a key cannot contain replaced.
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
