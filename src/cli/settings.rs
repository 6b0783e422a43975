//! The settings of the daemon: a flag overrides an environment variable, which overrides the
//! settings file, which overrides the default.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use clap::builder::Resettable;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command};

use crate::config::{ConfigError, Resolved, Source};

/// An unknown name is taken for a misspelling of a setting if at most a third of its letters differ.
const MIN_SIMILARITY: f64 = 2.0 / 3.0;

// Declares each setting: a field is its name in the settings file. All values are text here, so
// that `Config::new` can name the source of an invalid one. A doc comment would replace the
// description of the program in its help.
#[derive(Args)]
struct Settings {
    /// Settings file (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Zenoh endpoints to listen on, separated by commas: tcp/127.0.0.1:PORT and
    /// unixsock-stream/PATH for clients on this machine; tls/ADDRESS:PORT for others, needs auth_dir
    #[arg(long, value_name = "ENDPOINTS", default_value = "tcp/127.0.0.1:7447")]
    listen: String,
    /// Address of the HTTP server for the page, /healthz, /livez and /metrics: 127.0.0.1:PORT for clients on
    /// this machine; https://ADDRESS:PORT for others, needs auth_dir; empty for no server
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    http: String,
    /// Name of the daemon in keys; empty for the host name
    #[arg(long, value_name = "NAME", default_value = "")]
    node: String,
    /// First chunk of every key
    #[arg(long, value_name = "PREFIX", default_value = "jostle")]
    prefix: String,
    /// Log filter, in the syntax of tracing's EnvFilter
    #[arg(long, value_name = "FILTER", default_value = "info,zenoh=error")]
    log: String,
    /// Log format: text or json
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: String,
    /// Maximum number of individuals in a swarm; packed groups of more than a few hundred step slowly
    #[arg(long, value_name = "N", default_value = "2000")]
    max_individuals: String,
    /// Maximum number of swarms
    #[arg(long, value_name = "N", default_value = "1024")]
    max_swarms: String,
    /// Maximum memory of all swarms and of the running experiment, in MiB
    #[arg(long, value_name = "MIB", default_value = "2048")]
    max_memory_mb: String,
    /// Maximum number of clients; the `hello` of another one is rejected
    #[arg(long, value_name = "N", default_value = "4000")]
    max_clients: String,
    /// Maximum number of states that a swarm publishes per second
    #[arg(long, value_name = "N", default_value = "50")]
    max_hz: String,
    /// Folder of all persistent data; empty for jostle/NODE in $STATE_DIRECTORY, $XDG_STATE_HOME or
    /// ~/.local/state, and for a temporary folder with `demo`
    #[arg(long, value_name = "FOLDER", default_value = "")]
    data_dir: String,
    /// Folder of users and their roles, made by `jostled auth init`; if empty, every client may do
    /// everything
    #[arg(long, value_name = "FOLDER", default_value = "")]
    auth_dir: String,
    /// Maximum history of a swarm, in MiB; the oldest part is deleted first
    #[arg(long, value_name = "MIB", default_value = "64")]
    quota_mb: String,
    /// Maximum size of the audit log, in MiB; the oldest lines of the user with most are deleted first
    #[arg(long, value_name = "MIB", default_value = "16")]
    audit_mb: String,
    /// Maximum age of the lines of the audit log, in days
    #[arg(long, value_name = "DAYS", default_value = "365")]
    audit_days: String,
    /// Maximum size of all recordings, in MiB; a recording that reaches it ends, its swarm continues
    #[arg(long, value_name = "MIB", default_value = "10240")]
    recordings_quota_mb: String,
    /// Maximum size of all experiments, in MiB; an experiment that reaches it is paused; empty for the
    /// whole disk but 64 MiB
    #[arg(long, value_name = "MIB", default_value = "")]
    experiments_quota_mb: String,
    /// Maximum number of experiment runs in parallel; empty for the number of cores
    #[arg(long, value_name = "N", default_value = "")]
    experiment_threads: String,
    /// Wasm module with which the page verifies swarms, compressed by gzip; empty for the installed one,
    /// share/jostle/jostle.wasm.gz beside the program's folder, if there is one
    #[arg(long, value_name = "FILE", default_value = "")]
    wasm: String,
}

/// Adds `--config` and the flag of each setting, which every subcommand accepts too.
pub fn add_to(command: Command) -> Command {
    Settings::augment_args(command).mut_args(|argument| {
        let (variable, has_default) = (variable(name(&argument)), !default(&argument).is_empty());
        let argument = argument.global(true).hide_default_value(!has_default);
        if name(&argument) == "config" {
            return argument;
        }
        argument.env(variable).hide_env_values(true)
    })
}

fn command() -> Command {
    add_to(Command::new("jostled").no_binary_name(true))
}

/// `--config` and the flag of each setting.
pub fn flags() -> Vec<Arg> {
    command().get_arguments().cloned().collect()
}

/// The flag of each setting.
pub fn arguments() -> Vec<Arg> {
    let flags = flags().into_iter();
    flags.filter(|it| name(it) != "config").collect()
}

/// The name of a setting in the settings file.
pub fn name(argument: &Arg) -> &str {
    argument.get_id().as_str()
}

/// The default of a setting.
pub fn default(argument: &Arg) -> String {
    let values = argument.get_default_values();
    values.iter().map(|it| it.to_string_lossy()).collect()
}

fn flag(name: &str) -> String {
    format!("--{}", name.replace('_', "-"))
}

fn variable(name: &str) -> String {
    format!("JOSTLED_{}", name.to_uppercase())
}

/// Reads the settings file if there is one, and combines it with the flags and environment
/// variables in `matches`.
///
/// # Errors
///
/// [`ConfigError::Unreadable`] and [`ConfigError::Unknown`].
pub fn resolve(matches: &ArgMatches) -> Result<Resolved, ConfigError> {
    let mut file = match matches.get_one::<PathBuf>("config") {
        Some(path) => read_file(path)?,
        None => Resolved::new(),
    };
    let settings = arguments().into_iter().map(|argument| {
        let name = name(&argument).to_owned();
        let value = matches.get_one::<String>(&name).cloned();
        let value = value.unwrap_or_default();
        let setting = match (matches.value_source(&name), file.remove(&name)) {
            (Some(ValueSource::CommandLine), _) => (value, Source::Flag(flag(&name))),
            (Some(ValueSource::EnvVariable), _) => (value, Source::Environment(variable(&name))),
            (_, Some(setting)) => setting,
            (_, None) => (value, Source::Default),
        };
        (name, setting)
    });
    Ok(settings.collect())
}

/// The settings that these flags give, such as `("max_hz", "20")`. Does not read the environment.
pub fn from_flags<'a>(
    flags: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<Resolved, Box<dyn std::error::Error>> {
    let command = command().mut_args(|it| it.env(Resettable::Reset));
    let flags = flags.into_iter();
    let flags = flags.map(|(name, value)| format!("{}={value}", flag(name)));
    Ok(resolve(&command.try_get_matches_from(flags)?)?)
}

/// Rejects an environment variable `JOSTLED_*` that is not the one of a setting.
///
/// # Errors
///
/// [`ConfigError::Unknown`].
pub fn check_variables(variables: impl Iterator<Item = OsString>) -> Result<(), ConfigError> {
    for variable in variables {
        let variable = variable.to_string_lossy();
        if let Some(name) = variable.strip_prefix("JOSTLED_") {
            let source = Source::Environment(variable.to_string());
            check_name(&name.to_lowercase(), &source)?;
        }
    }
    Ok(())
}

fn check_name(given: &str, origin: &Source) -> Result<(), ConfigError> {
    let names: Vec<String> = arguments().iter().map(|it| name(it).to_owned()).collect();
    if names.iter().any(|name| name == given) {
        return Ok(());
    }
    let similarity = |name: &String| strsim::normalized_levenshtein(given, name);
    let nearest = names
        .iter()
        .max_by(|a, b| similarity(a).total_cmp(&similarity(b)));
    let remedy = match nearest.filter(|name| similarity(name) >= MIN_SIMILARITY) {
        Some(name) => match origin {
            Source::Environment(_) => format!("did you mean {}?", variable(name)),
            _ => format!("did you mean {name}?"),
        },
        None => format!("there are {}", names.join(", ")),
    };
    Err(ConfigError::Unknown {
        name: given.to_owned(),
        origin: origin.clone(),
        remedy,
    })
}

/// The settings in a TOML file, as text. An array is joined by commas.
fn read_file(path: &Path) -> Result<Resolved, ConfigError> {
    let unreadable = |reason: String| ConfigError::Unreadable {
        path: path.to_owned(),
        reason,
    };
    let text = fs::read_to_string(path).map_err(|error| unreadable(error.to_string()))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
    let scalar = |name: &str, value: &toml::Value| match value {
        toml::Value::String(text) => Ok(text.clone()),
        toml::Value::Integer(_) | toml::Value::Float(_) | toml::Value::Boolean(_) => {
            Ok(value.to_string())
        }
        _ => Err(unreadable(format!(
            "{name} is neither a string nor a number"
        ))),
    };
    let source = Source::File(path.to_owned());
    let mut settings = BTreeMap::new();
    for (name, value) in table {
        check_name(&name, &source)?;
        let value = match value {
            toml::Value::Array(values) => {
                let values = values.iter().map(|value| scalar(&name, value));
                values.collect::<Result<Vec<_>, _>>()?.join(",")
            }
            value => scalar(&name, &value)?,
        };
        settings.insert(name, (value, source.clone()));
    }
    Ok(settings)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::io::Write as _;

    use tempfile::NamedTempFile;

    use super::*;
    use crate::config::Config;

    fn file(text: &str) -> NamedTempFile {
        let mut file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn from_file(file: &NamedTempFile) -> Result<Resolved, String> {
        let path = file.path().to_str().unwrap();
        from_flags([("config", path)]).map_err(|error| error.to_string())
    }

    #[test]
    fn the_defaults_are_valid() {
        let config = Config::new(&from_flags([]).unwrap()).unwrap();
        assert_eq!(config.listen, ["tcp/127.0.0.1:7447"]);
        assert_eq!(config.http, "127.0.0.1:8080");
        assert!(jostle_proto::keys::is_name(&config.node));
        assert_eq!(config.experiment_threads, None);
    }

    #[test]
    fn each_setting_has_its_flag_and_its_variable() {
        for argument in arguments() {
            let (name, long, env) = (name(&argument), argument.get_long(), argument.get_env());
            assert_eq!(long.map(|it| format!("--{it}")), Some(flag(name)));
            assert_eq!(env.map(|it| it.to_str().unwrap()), Some(&*variable(name)));
            assert!(argument.is_global_set(), "{name}");
        }
    }

    #[test]
    fn flags_go_over_the_environment_over_the_file_over_defaults() {
        let file = file("node = 'a'\nmax_swarms = 2\nmax_hz = 3\nlog = 'x'\nlisten = ['x', 'y']\n");
        let path = file.path().to_str().unwrap();
        // A variable that is set stands for those of the settings.
        let command = command().mut_args(|argument| match name(&argument) {
            "log" | "max_hz" => argument.env("PATH"),
            _ => argument.env(Resettable::Reset),
        });
        let matches = command
            .try_get_matches_from(["--config", path, "--max-hz", "6"])
            .unwrap();
        let resolved = resolve(&matches).unwrap();
        let config = Config::new(&resolved).unwrap();
        assert_eq!(config.node, "a");
        assert_eq!(config.listen, ["x", "y"]);
        assert_eq!(config.limits.max_swarms, 2);
        assert_eq!(config.limits.max_hz, 6);
        assert_eq!(config.log, std::env::var("PATH").unwrap());
        let source = |name: &str| &resolved[name].1;
        assert_eq!(source("node"), &Source::File(file.path().to_owned()));
        assert_eq!(source("log"), &Source::Environment("JOSTLED_LOG".into()));
        assert_eq!(source("max_hz"), &Source::Flag("--max-hz".into()));
        assert_eq!(source("log_format"), &Source::Default);
    }

    #[test]
    fn a_setting_that_does_not_exist_is_rejected_with_a_similar_one() {
        let rejected = |variable: &str| {
            let variables = ["HOME", "JOSTLED", "JOSTLED_NODE", variable].map(OsString::from);
            check_variables(variables.into_iter())
                .unwrap_err()
                .to_string()
        };
        let typo = rejected("JOSTLED_MAX_SWARM");
        assert!(typo.contains("did you mean JOSTLED_MAX_SWARMS?"), "{typo}");
        let strange = rejected("JOSTLED_WINGS");
        assert!(
            strange.contains("there are listen, http, node"),
            "{strange}"
        );

        for (line, meant) in [("max-hz = 3", "max_hz"), ("lisen = 'x'", "listen")] {
            let typo = from_file(&file(line)).unwrap_err();
            assert!(typo.contains(&format!("did you mean {meant}?")), "{typo}");
            assert!(typo.contains(".toml"), "{typo}");
        }
    }

    #[test]
    fn an_invalid_value_is_rejected_with_its_source() {
        let resolved = from_file(&file("max_swarms = 'many'\n")).unwrap();
        let wrong = Config::new(&resolved).unwrap_err().to_string();
        assert!(wrong.contains("many") && wrong.contains(".toml"), "{wrong}");

        let absent = read_file(Path::new("/nowhere.toml"));
        assert!(matches!(absent, Err(ConfigError::Unreadable { .. })));
        assert!(from_file(&file("[max_hz]\na = 1\n")).is_err());

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
            let resolved = from_flags([(name, bad)]).unwrap();
            let rejected = Config::new(&resolved).unwrap_err().to_string();
            assert!(rejected.starts_with(&format!("{name} = ")), "{rejected}");
        }
    }
}
