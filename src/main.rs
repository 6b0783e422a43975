//! `jostled`: hosts swarms and serves them on zenoh.

use std::io::{IsTerminal as _, Write as _};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use jostled::app::{self, ServerError};
use jostled::backup::{self, BackupError, Manifest};
use jostled::cli::demo;
use jostled::cli::process;
use jostled::cli::run::{self, Which};
use jostled::cli::systemd;
use jostled::config::{self, Config, ConfigError, Merged, Source, explain};
use jostled::transport::http::{self, GatewayError, Token};
use jostled::transport::zenoh::session::{self, SessionError};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::signal::unix::{SignalKind, signal};
use tracing::warn;
use tracing_subscriber::EnvFilter;

use jostled::cli::auth::{Auth, give_rights};

/// Files that are open beside one for each client: the store's, recordings, pages, swarms' wakers.
const FILES_OF_ITS_OWN: u64 = 500;

/// Hosts swarms of bodies that only push each other, steps them exactly and serves them on zenoh.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = false)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    settings: Settings,
}

#[derive(Subcommand)]
enum Command {
    /// Serve until told to stop (the default).
    Serve,
    /// Serve a swarm that is worth watching: fifty bodies, ten of which learn of a direction.
    Demo {
        /// End by itself after this much time at the demo's rate, such as `20s`, `5m` or `1.5h`.
        #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
        lasting: Option<Duration>,
    },
    /// Execute an experiment without a daemon; finished runs are not executed again.
    Run {
        /// The experiment, a TOML file.
        file: PathBuf,
        /// Folder of the results; an interrupted experiment in it is resumed.
        #[arg(
            short,
            long,
            value_name = "FOLDER",
            required_unless_present = "dry_run"
        )]
        output: Option<PathBuf>,
        /// Execute only part K of N; parts have nearly equal expected times. FOLDER is created when
        /// the part is complete, unless it exists before. `jostle results merge` merges all parts.
        #[arg(long, value_name = "K/N", value_parser = run::part)]
        part: Option<Which>,
        /// Execute only these runs, such as `17,18,40-60`; `--dry-run` lists their numbers.
        #[arg(long, value_name = "LIST", conflicts_with = "part")]
        runs: Option<String>,
        /// Interval between checkpoints of each run, such as `5m`; also written on Ctrl-C and
        /// SIGTERM. The next execution resumes from them, with the same results.
        #[arg(long, value_name = "DURATION", value_parser = duration, conflicts_with = "dry_run")]
        checkpoint: Option<Duration>,
        /// Number of runs executed in parallel [default: number of cores].
        #[arg(long, value_name = "N")]
        threads: Option<NonZero<usize>>,
        /// As JSON.
        #[arg(long)]
        json: bool,
        /// List the runs with their numbers and seeds; execute nothing.
        #[arg(long, conflicts_with = "output")]
        dry_run: bool,
    },
    /// Take a backup of the data folder, while the daemon runs or not: swarms with their history,
    /// experiments and recordings, but no secrets.
    Backup {
        /// Where; the folder is made.
        #[arg(value_name = "FOLDER")]
        target: PathBuf,
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Restore a backup into the data folder, which must be empty, or not there yet.
    Restore {
        /// The folder of the backup.
        #[arg(value_name = "FOLDER")]
        source: PathBuf,
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Say what the settings are, and serve nothing.
    Config {
        #[command(subcommand)]
        command: Show,
    },
    /// Say who may do what: people, their roles and their secrets, in the folder `--auth-dir`.
    Auth {
        #[command(subcommand)]
        command: Auth,
    },
    /// Print the manual page, or write one for each command.
    Man {
        /// Write the pages into this folder.
        #[arg(short, long, value_name = "FOLDER")]
        out: Option<PathBuf>,
    },
}

#[derive(Subcommand)]
enum Show {
    /// Every setting in force: its value, where it comes from, what it means.
    Explain {
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// A commented file of every setting at its default, to begin from: `jostled --config FILE`.
    Default,
}

/// What a file and the environment can say, flags say too, and they have the last word.
#[derive(Args)]
struct Settings {
    /// Read settings from this TOML file.
    #[arg(long, global = true, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Listen on these zenoh endpoints, separated by commas [default: tcp/127.0.0.1:7447].
    #[arg(long, global = true, value_name = "ENDPOINTS")]
    listen: Option<String>,
    /// Serve HTTP here, /healthz and /metrics; nowhere if empty [default: 127.0.0.1:8080].
    #[arg(long, global = true, value_name = "ADDRESS")]
    http: Option<String>,
    /// The daemon's name on the bus [default: the machine's name].
    #[arg(long, global = true, value_name = "NAME")]
    node: Option<String>,
    /// The first chunk of every key [default: jostle].
    #[arg(long, global = true)]
    prefix: Option<String>,
    /// What is logged, in the syntax of tracing's filters [default: info,zenoh=error].
    #[arg(long, global = true, value_name = "FILTER")]
    log: Option<String>,
    /// Log as text or json [default: text].
    #[arg(long, global = true, value_name = "FORMAT")]
    log_format: Option<String>,
    /// Individuals in one swarm [default: 2000].
    #[arg(long, global = true, value_name = "N")]
    max_individuals: Option<String>,
    /// Swarms at once [default: 1024].
    #[arg(long, global = true, value_name = "N")]
    max_swarms: Option<String>,
    /// Memory of all swarms together, in MiB [default: 2048].
    #[arg(long, global = true, value_name = "MIB")]
    max_memory_mb: Option<String>,
    /// Clients at once [default: 4000].
    #[arg(long, global = true, value_name = "N")]
    max_clients: Option<String>,
    /// Keep everything that outlives the daemon in this folder [default: jostle/NODE below
    /// ~/.local/state; for a demo a temporary one].
    #[arg(long, global = true, value_name = "FOLDER")]
    data_dir: Option<String>,
    /// The folder that `jostled auth init` made: who may do what [default: everybody everything].
    #[arg(long, global = true, value_name = "FOLDER")]
    auth_dir: Option<String>,
    /// History kept of one swarm, in MiB [default: 64].
    #[arg(long, global = true, value_name = "MIB")]
    quota_mb: Option<String>,
    /// All recordings of the daemon together, in MiB [default: 10240].
    #[arg(long, global = true, value_name = "MIB")]
    recordings_quota_mb: Option<String>,
    /// States published per second and swarm [default: 50].
    #[arg(long, global = true, value_name = "N")]
    max_hz: Option<String>,
    /// Runs of experiments at once [default: as many as there are cores].
    #[arg(long, global = true, value_name = "N")]
    experiment_threads: Option<String>,
}

impl Settings {
    fn merge(self) -> Result<Merged, ConfigError> {
        let flags = [
            ("listen", self.listen),
            ("http", self.http),
            ("node", self.node),
            ("prefix", self.prefix),
            ("log", self.log),
            ("log_format", self.log_format),
            ("max_individuals", self.max_individuals),
            ("max_swarms", self.max_swarms),
            ("max_memory_mb", self.max_memory_mb),
            ("max_clients", self.max_clients),
            ("max_hz", self.max_hz),
            ("experiment_threads", self.experiment_threads),
            ("data_dir", self.data_dir),
            ("auth_dir", self.auth_dir),
            ("quota_mb", self.quota_mb),
            ("recordings_quota_mb", self.recordings_quota_mb),
        ];
        // What is not UTF-8 is not passed over: it is refused as what it then reads.
        let environment = std::env::vars_os().map(|(name, value)| {
            let [name, value] = [name, value].map(|it| it.to_string_lossy().into_owned());
            (name, value)
        });
        config::merge(self.config.as_deref(), environment, &flags)
    }
}

/// Whether a setting has an effect on a command, such as `config default`.
fn has_effect(setting: &str, command: &str) -> bool {
    match command {
        "config default" | "man" | "run" => false,
        // The node's name is part of the data folder's default.
        "backup" | "restore" => ["config", "data_dir", "node"].contains(&setting),
        "auth address" | "auth init" => ["auth_dir", "config", "http", "listen"].contains(&setting),
        command if command.starts_with("auth ") => ["auth_dir", "config"].contains(&setting),
        _ => true,
    }
}

/// The command line; each command offers the settings that have an effect on it.
fn command_line() -> clap::Command {
    let settings = Settings::augment_args(clap::Command::new("settings"));
    let settings: Vec<Arg> = settings.get_arguments().cloned().collect();
    hide_unused(Arguments::command(), "", &settings)
}

/// Hides the settings without effect from the commands below `command`.
fn hide_unused(command: clap::Command, of: &str, settings: &[Arg]) -> clap::Command {
    command.mut_subcommands(|command| {
        let name = joined(of, command.get_name());
        if command.has_subcommands() {
            return hide_unused(command, &name, settings);
        }
        let unused = settings
            .iter()
            .filter(|it| !has_effect(it.get_id().as_str(), &name));
        // In the place of the one that holds for all commands.
        command.args(unused.map(|setting| setting.clone().hide(true)))
    })
}

/// Refuses a setting that is on the command line and has no effect on the command.
fn refuse_unused(matches: &ArgMatches) -> Result<(), clap::Error> {
    let (mut name, mut level) = (String::new(), matches);
    while let Some((command, deeper)) = level.subcommand() {
        (name, level) = (joined(&name, command), deeper);
    }
    let names = config::SETTINGS.map(|(name, ..)| name);
    for setting in names.into_iter().chain(["config"]) {
        let is_given = level.value_source(setting) == Some(ValueSource::CommandLine);
        if is_given && !has_effect(setting, &name) {
            let option = setting.replace('_', "-");
            let problem = format!("--{option} has no effect on `jostled {name}`: leave it out");
            return Err(command_line().error(ErrorKind::ArgumentConflict, problem));
        }
    }
    Ok(())
}

fn joined(of: &str, command: &str) -> String {
    format!("{of} {command}").trim_start().to_owned()
}

fn main() -> ExitCode {
    process::settle();
    let matches = command_line().get_matches();
    if let Err(error) = refuse_unused(&matches) {
        error.exit();
    }
    let Arguments { command, settings } =
        Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let command = command.unwrap_or(Command::Serve);
    if let Command::Config {
        command: Show::Default,
    } = command
    {
        return show(&explain::default_file());
    }
    if let Command::Man { out } = command {
        return manual(out.as_deref());
    }
    if let Command::Run {
        file,
        output,
        part,
        runs,
        checkpoint,
        threads,
        json,
        ..
    } = command
    {
        let options = run::Options {
            file,
            output,
            which: part.or(runs.map(Which::Runs)).unwrap_or(Which::All),
            checkpoint_every: checkpoint,
            threads,
            json,
        };
        return match run::run(&options) {
            Ok(code) => ExitCode::from(code),
            Err(error) => fail(1, &error),
        };
    }
    let mut merged = match settings.merge() {
        Ok(merged) => merged,
        Err(error) => return fail(2, &error),
    };
    if let (Command::Demo { .. }, Some((log, Source::Default))) = (&command, merged.get_mut("log"))
    {
        // The demo's own lines are to be read; whoever sets `log` gets the rest.
        "warn,zenoh=error".clone_into(log);
    }
    if let Command::Auth { command } = command {
        return auth(&merged, &command);
    }
    let mut temporary = None;
    if let (Command::Demo { .. }, Some((folder, Source::Default))) =
        (&command, merged.get_mut("data_dir"))
    {
        // A demo leaves nothing behind, unless it is told where.
        match tempfile::tempdir() {
            Ok(made) => {
                *folder = made.path().to_string_lossy().into_owned();
                temporary = Some(made);
            }
            Err(error) => return fail(1, &error),
        }
    }
    let config = match Config::new(&merged) {
        Ok(config) => config,
        Err(error) => return fail(2, &error),
    };
    // Tests make the process fail at named points; elsewhere the variable is not set.
    let _failing = std::env::var_os("FAILPOINTS").map(|_| fail::FailScenario::setup());
    match &command {
        Command::Backup { target, json } => {
            let taken = backup::take(&config.data_dir, target);
            return conclude("backed up", taken, target, *json);
        }
        Command::Restore { source, json } => {
            let restored = backup::restore(source, &config.data_dir);
            return conclude("restored", restored, &config.data_dir, *json);
        }
        _ => {}
    }
    let filter = match EnvFilter::try_new(&config.log) {
        Ok(filter) => filter,
        Err(error) => {
            let (log, source) = &merged["log"];
            return fail(2, &format_args!("log = {log:?} from {source}: {error}"));
        }
    };
    let demo = match command {
        Command::Serve
        | Command::Run { .. }
        | Command::Auth { .. }
        | Command::Man { .. }
        | Command::Backup { .. }
        | Command::Restore { .. } => None,
        Command::Demo { lasting } => Some(lasting),
        Command::Config { command } => {
            if let Err(error) = session::check(&config.listen, config.auth_dir.is_some()) {
                return fail(2, &error);
            }
            if let Err(error) = http::check(&config.http, config.auth_dir.is_some()) {
                return fail(2, &error);
            }
            return show(&match command {
                Show::Explain { json: true } => explain::json(&merged),
                Show::Explain { json: false } => explain::table(&merged),
                Show::Default => explain::default_file(),
            });
        }
    };
    let logs = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    if config.logs_json {
        logs.json().init();
    } else {
        logs.init();
    }
    open_many(config.max_clients);
    if let Some(points) = std::env::var_os("FAILPOINTS") {
        warn!(?points, "set to fail");
    }
    // zenoh needs a runtime of several threads.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let code = match runtime {
        Ok(runtime) => runtime.block_on(serve(&config, demo)),
        Err(error) => {
            fail(1, &error);
            1
        }
    };
    // Whoever is still in a long step is not waited for, nor what zenoh does at an ordinary exit:
    // with a frozen client that took ten seconds.
    let _ = std::io::stdout().flush();
    if let Some(temporary) = temporary {
        let _ = temporary.close();
    }
    signal_hook::low_level::exit(code)
}

/// Changes or shows who may do what, and where the daemon is reached.
fn auth(merged: &Merged, command: &Auth) -> ExitCode {
    let set = |name: &str| match &merged[name] {
        (_, Source::Default) => None,
        (text, _) => Some(text.trim().to_owned()),
    };
    let is_flag = |name: &str| matches!(merged[name].1, Source::Flag(_));
    let settings = jostled::cli::auth::Settings {
        listen: set("listen").map(|listen| config::endpoints(&listen)),
        http: set("http"),
        are_flags: is_flag("listen") || is_flag("http"),
    };
    if let Some(listen) = &settings.listen {
        if listen.is_empty() {
            return fail(2, &"--listen takes at least one endpoint");
        }
        if let Err(error) = session::check(listen, true) {
            return fail(2, &error);
        }
    }
    if let Some(http) = &settings.http
        && let Err(error) = http::check(http, true)
    {
        return fail(2, &error);
    }
    match give_rights(merged["auth_dir"].0.trim(), &settings, command) {
        Ok(told) => show(&told),
        Err((code, problem)) => fail(code, &problem),
    }
}

/// Prints what a backup or a restoration has written, and where.
fn conclude(
    done: &str,
    manifest: Result<Manifest, BackupError>,
    folder: &Path,
    as_json: bool,
) -> ExitCode {
    match manifest {
        Ok(manifest) if as_json => show(&format!("{}\n", manifest.summary(folder))),
        Ok(manifest) => {
            let Manifest { swarms, files, .. } = &manifest;
            let mebibytes = manifest.bytes().div_ceil(1024 * 1024);
            let (folder, files) = (folder.display(), files.len());
            show(&format!(
                "{done}: swarms: {swarms}, files: {files}, {mebibytes} MiB in {folder}\n"
            ))
        }
        Err(error) => fail(1, &error),
    }
}

/// Has as many files open as the system lets it, since each client takes one, and a shell often
/// begins with a thousand.
fn open_many(max_clients: usize) {
    let allowed = getrlimit(Resource::Nofile);
    let most = Rlimit {
        current: allowed.maximum,
        ..allowed
    };
    if let Err(error) = setrlimit(Resource::Nofile, most) {
        warn!(%error, "failed to raise the number of open files");
    }
    let allowed = getrlimit(Resource::Nofile).current;
    if allowed.is_some_and(|files| files < max_clients as u64 + FILES_OF_ITS_OWN) {
        warn!(
            allowed,
            max_clients,
            "fewer files may be open than it takes: raise `ulimit -n`, or lower max_clients"
        );
    }
}

/// Serves, a demo or whatever comes, until told to stop; returns the process's exit code.
async fn serve(config: &Config, demo: Option<Option<Duration>>) -> i32 {
    let server = match app::start(config).await {
        Ok(server) => server,
        Err(error) => {
            let code = if is_setting(&error) { 2 } else { 1 };
            fail(code, &error);
            return code.into();
        }
    };
    for endpoint in server.endpoints() {
        // Whoever started it may have closed its output.
        let _ = writeln!(std::io::stdout(), "listening on {endpoint}");
    }
    if let Some(url) = server.url() {
        let _ = writeln!(std::io::stdout(), "http on {url}");
    }
    if let Some(link) = server.page() {
        // What is no terminal may be a log, and the link opens the page to whoever reads it.
        let told = match std::io::stdout().is_terminal() {
            true => link,
            false => {
                let bare = link.split('#').next().unwrap_or_default();
                let file = Token::file_in(&config.data_dir);
                format!("{bare} with the token in {}", file.display())
            }
        };
        let _ = writeln!(std::io::stdout(), "page on {told}");
    }
    let informing = systemd::keep_informed(server.watch().clone(), server.host().clone());
    let informing = tokio::spawn(informing);
    let code = match demo {
        None => {
            told_to_stop().await;
            0
        }
        Some(lasting) => tokio::select! {
            ended = demo::run(&server, lasting) => match ended {
                Ok(()) => 0,
                Err(demo::DemoError::Gone) if lasting.is_none() => {
                    eprintln!("jostled: somebody deleted the demo's swarm; serving on, Ctrl-C ends");
                    told_to_stop().await;
                    0
                }
                Err(error) => {
                    fail(1, &error);
                    1
                }
            },
            () = told_to_stop() => 0,
        },
    };
    informing.abort();
    systemd::tell_end();
    match server.stop().await {
        false if code == 0 => app::EXIT_STORE,
        _ => code,
    }
}

/// Whether a setting is to blame, and not the machine.
fn is_setting(error: &ServerError) -> bool {
    matches!(
        error,
        ServerError::Name(_)
            | ServerError::Store(_)
            | ServerError::Rights(_)
            | ServerError::Gateway(
                GatewayError::NoAddress(_)
                    | GatewayError::NotLoopback(_)
                    | GatewayError::NobodyKnown(_)
                    | GatewayError::Certificate(_)
            )
            | ServerError::Session(
                SessionError::NoEndpoint(_)
                    | SessionError::NotLoopback(_)
                    | SessionError::NobodyKnown(_)
                    | SessionError::OtherTls(_)
            )
    )
}

/// Waits for SIGTERM or Ctrl-C.
async fn told_to_stop() {
    let (Ok(mut terminate), Ok(mut interrupt)) = (
        signal(SignalKind::terminate()),
        signal(SignalKind::interrupt()),
    ) else {
        // Without handlers the signals end the process by themselves.
        return std::future::pending().await;
    };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
}

/// Prints what was asked for; whoever asked may have closed the output.
fn show(text: &str) -> ExitCode {
    let _ = std::io::stdout().write_all(text.as_bytes());
    ExitCode::SUCCESS
}

/// Prints the manual page, or writes a page for each command into `folder`.
fn manual(folder: Option<&Path>) -> ExitCode {
    let command = command_line();
    let written = match folder {
        Some(folder) => {
            std::fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder))
        }
        // Whoever asked may have closed the output.
        None => {
            let _ = clap_mangen::Man::new(command).render(&mut std::io::stdout());
            Ok(())
        }
    };
    match written {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(1, &error),
    }
}

fn fail(code: u8, error: &dyn std::fmt::Display) -> ExitCode {
    eprintln!("jostled: {error}");
    ExitCode::from(code)
}

/// The longest demo: thirty years.
const LONGEST: Duration = Duration::from_secs(1_000_000_000);

/// Reads `20s`, `5m`, `1.5h` or a plain number of seconds.
fn duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = match text.find(|c: char| c.is_ascii_alphabetic()) {
        Some(at) => text.split_at(at),
        None => (text, "s"),
    };
    let secs = match unit {
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("{unit:?} is none of ms, s, m, h")),
    };
    let number: f64 = number
        .parse()
        .map_err(|_| format!("{number:?} is not a number"))?;
    Duration::try_from_secs_f64(number * secs)
        .ok()
        .filter(|duration| !duration.is_zero() && *duration <= LONGEST)
        .ok_or_else(|| format!("{text:?} is not a time to wait for"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_flags_are_consistent_and_there_is_one_for_every_setting() {
        let command = command_line();
        command.clone().debug_assert();
        for (name, ..) in config::SETTINGS {
            let flag = name.replace('_', "-");
            assert!(
                command
                    .get_arguments()
                    .any(|it| it.get_long() == Some(flag.as_str())),
                "--{flag}"
            );
        }
    }

    #[test]
    fn a_command_offers_the_settings_that_have_an_effect_on_it_and_refuses_others() {
        let read = |line: &str| {
            let words = ["jostled"].into_iter().chain(line.split(' '));
            let matches = command_line().try_get_matches_from(words)?;
            refuse_unused(&matches)
        };
        for line in [
            "--listen tcp/127.0.0.1:1 serve",
            "demo --node a --for 3s",
            "config explain --max-swarms 3",
            "--auth-dir a auth list",
            "auth init --auth-dir a",
            "auth address --auth-dir a --listen tls/127.0.0.1:1 --http https://127.0.0.1:2",
        ] {
            assert!(read(line).is_ok(), "{line}");
        }
        for line in [
            "--listen tcp/127.0.0.1:1 man",
            "man --log info",
            "run order.toml -o results --experiment-threads 2",
            "--config a.toml run order.toml -o results",
            "config default --node a",
            "config --node a default",
            "auth list --auth-dir a --max-hz 3",
        ] {
            let error = read(line).expect_err(line).to_string();
            assert!(error.contains("has no effect on `jostled "), "{error}");
        }

        let mut command = command_line();
        command.build();
        let is_offered = |name: &str, setting: &str| {
            let mut of = &command;
            for word in name.split(' ') {
                of = of.find_subcommand(word).expect(name);
            }
            let mut arguments = of.get_arguments();
            arguments.any(|it| it.get_id() == setting && !it.is_hide_set())
        };
        let settings = config::SETTINGS.map(|(name, ..)| name);
        for name in [
            "serve",
            "demo",
            "run",
            "man",
            "backup",
            "restore",
            "config explain",
            "config default",
            "auth init",
            "auth address",
            "auth add",
            "auth remove",
            "auth list",
        ] {
            for setting in settings.into_iter().chain(["config"]) {
                let has_effect = has_effect(setting, name);
                assert_eq!(is_offered(name, setting), has_effect, "{name} {setting}");
            }
        }
    }

    #[test]
    fn durations_are_read_with_their_unit() {
        assert_eq!(duration("20s"), Ok(Duration::from_secs(20)));
        assert_eq!(duration("20"), Ok(Duration::from_secs(20)));
        assert_eq!(duration("1.5h"), Ok(Duration::from_secs(5400)));
        assert_eq!(duration("250ms"), Ok(Duration::from_millis(250)));
        for bad in [
            "",
            "s",
            "-1s",
            "0s",
            "1d",
            "nan",
            "1e400s",
            "inf",
            "1000000000h",
        ] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }
}
