//! `jostled`: hosts swarms and serves them on zenoh.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgMatches, FromArgMatches as _};
use jostled::cli::arguments::{Arguments, Command, Show, command_line, reject_unused};
use jostled::cli::run;
use jostled::cli::serve::{self, Mode};
use jostled::cli::settings;
use jostled::cli::{self, auth, backup, check, doctor, explain, man, print, process};
use jostled::config::{Config, ConfigError, Resolved, Source};
use jostled::transport::http;
use jostled::transport::zenoh::session;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    process::configure_process();
    let matches = match command_line().try_get_matches() {
        Ok(matches) => matches,
        Err(error) => return cli::usage(&error),
    };
    let read = reject_unused(&matches).and_then(|()| Arguments::from_arg_matches(&matches));
    let arguments = match read {
        Ok(arguments) => arguments,
        Err(error) => return cli::usage(&error),
    };
    match arguments.command.unwrap_or(Command::Serve) {
        Command::Config {
            command: Show::Default,
        } => print(&explain::default_file()),
        Command::Man { out } => man::manual(out.as_deref()),
        Command::Run(options) => match run::run(&options) {
            Ok(code) => ExitCode::from(code),
            Err(error) => cli::fail(1, &error),
        },
        Command::Check(options) => check::run(&options),
        command => match resolve(&matches) {
            Ok(resolved) => with_settings(command, resolved, matches.get_one("config")),
            Err(error) => cli::fail(2, &error),
        },
    }
}

fn resolve(matches: &ArgMatches) -> Result<Resolved, ConfigError> {
    settings::check_variables(std::env::vars_os().map(|(name, _)| name))?;
    settings::resolve(matches)
}

fn with_settings(
    command: Command,
    mut resolved: Resolved,
    config_file: Option<&PathBuf>,
) -> ExitCode {
    if let Command::Auth { command } = command {
        return auth::run(&resolved, config_file, &command);
    }
    let mut temporary = None;
    if let Command::Demo { .. } = command {
        // A demo prints lines of its own, and keeps its data only where a setting says so.
        if let Some((log, Source::Default)) = resolved.get_mut("log") {
            "warn,zenoh=error".clone_into(log);
        }
        if let Some((folder, Source::Default)) = resolved.get_mut("data_dir") {
            match tempfile::tempdir() {
                Ok(created) => {
                    *folder = created.path().to_string_lossy().into_owned();
                    temporary = Some(created);
                }
                Err(error) => return cli::fail(1, &error),
            }
        }
    }
    let config = match Config::new(&resolved) {
        Ok(config) => config,
        Err(error) => return cli::fail(2, &error),
    };
    // Tests set the variable to inject failures.
    let _failpoints = std::env::var_os("FAILPOINTS").map(|_| fail::FailScenario::setup());
    match &command {
        Command::Backup { target, json } => {
            let done = jostled::backup::take(&config.data_dir, target);
            return backup::report("backed up", done, target, *json, 0);
        }
        Command::Restore { source, json } => {
            let done = jostled::backup::restore(source, &config.data_dir);
            let code = backup::EXIT_INCOMPLETE;
            return backup::report("restored", done, &config.data_dir, *json, code);
        }
        Command::Doctor(options) => {
            let is_default = resolved["data_dir"].1 == Source::Default;
            return doctor::run(options, &config.data_dir, is_default);
        }
        _ => {}
    }
    let filter = match EnvFilter::try_new(&config.log) {
        Ok(filter) => filter,
        Err(error) => {
            let (log, source) = &resolved["log"];
            return cli::fail(2, &format_args!("log = {log:?} from {source}: {error}"));
        }
    };
    match command {
        Command::Config {
            command: Show::Explain { json },
        } => {
            if let Err(error) = session::check(&config.listen, config.auth_dir.is_some()) {
                return cli::fail(2, &error);
            }
            if let Err(error) = http::check(&config.http, config.auth_dir.is_some()) {
                return cli::fail(2, &error);
            }
            print(&match json {
                true => explain::json(&resolved, &config),
                false => explain::table(&resolved, &config),
            })
        }
        Command::Demo { lasting } => {
            serve::run(&config, &resolved, filter, Mode::Demo(lasting), temporary)
        }
        _ => serve::run(&config, &resolved, filter, Mode::Serve, temporary),
    }
}
