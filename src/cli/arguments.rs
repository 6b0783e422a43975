//! The command line of `jostled`.

use std::path::PathBuf;
use std::time::Duration;

use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, CommandFactory, Parser, Subcommand};

use crate::cli::auth::Auth;
use crate::cli::check;
use crate::cli::doctor;
use crate::cli::duration;
use crate::cli::run;
use crate::cli::settings;

/// Hosts swarms of bodies that only push each other, steps them exactly and serves them on zenoh.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = false)]
pub struct Arguments {
    /// What to do; `serve` if left out.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The commands.
#[derive(Subcommand)]
pub enum Command {
    /// Serve until SIGTERM or Ctrl-C (the default).
    Serve,
    /// Serve, and run a swarm to watch: fifty bodies, ten of which are informed of a direction.
    Demo {
        /// Stop after this time at the demo's rate, such as `20s`, `5m` or `1.5h`.
        #[arg(long = "for", value_name = "DURATION", value_parser = duration::parse)]
        lasting: Option<Duration>,
    },
    /// Execute an experiment without a daemon; finished runs are not executed again.
    Run(run::Options),
    /// Execute the run of an HTML file of `jostle export` again, and compare how it ends.
    Check(check::Options),
    /// Back up the data folder: swarms with their history, experiments and recordings, but no
    /// secrets. The daemon may be running.
    Backup {
        /// Folder to create.
        #[arg(value_name = "FOLDER")]
        target: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Restore a backup into the data folder, which must be empty or absent.
    Restore {
        /// Folder of the backup.
        #[arg(value_name = "FOLDER")]
        source: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Say what this version will do with the swarms, experiments and results of an earlier one.
    ///
    /// Reads the data folder and folders of results, and changes nothing in them. The daemon may be running.
    Doctor(doctor::Options),
    /// Show the settings.
    Config {
        /// What to show.
        #[command(subcommand)]
        command: Show,
    },
    /// Manage the users, their roles and their secrets, in the folder `--auth-dir`.
    Auth {
        /// What to change or show.
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

/// The commands below `config`.
#[derive(Subcommand)]
pub enum Show {
    /// Show each setting: its value, its source and its meaning.
    Explain {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Print a settings file with comments that sets each setting to its default.
    Default,
}

/// Whether a setting has an effect on a command, such as `config default`.
fn has_effect(setting: &str, command: &str) -> bool {
    match command {
        "check" | "config default" | "man" | "run" => false,
        // The node's name is part of the data folder's default.
        "backup" | "doctor" | "restore" => ["config", "data_dir", "node"].contains(&setting),
        "auth address" | "auth init" => ["auth_dir", "config", "http", "listen"].contains(&setting),
        command if command.starts_with("auth ") => ["auth_dir", "config"].contains(&setting),
        _ => true,
    }
}

/// The command line. Each command shows only the settings that have an effect on it.
pub fn command_line() -> clap::Command {
    hide_unused(
        settings::add_to(Arguments::command()),
        "",
        &settings::flags(),
    )
}

fn hide_unused(command: clap::Command, parent: &str, flags: &[Arg]) -> clap::Command {
    command.mut_subcommands(|command| {
        let name = joined(parent, command.get_name());
        if command.has_subcommands() {
            return hide_unused(command, &name, flags);
        }
        let unused = flags
            .iter()
            .filter(|it| !has_effect(settings::name(it), &name));
        // Each replaces the global flag of the same name.
        command.args(unused.map(|flag| flag.clone().hide(true)))
    })
}

/// Rejects a flag that has no effect on the command.
pub fn reject_unused(matches: &ArgMatches) -> Result<(), clap::Error> {
    let (mut name, mut level) = (String::new(), matches);
    while let Some((command, deeper)) = level.subcommand() {
        (name, level) = (joined(&name, command), deeper);
    }
    for flag in settings::flags() {
        let setting = settings::name(&flag);
        let is_given = level.value_source(setting) == Some(ValueSource::CommandLine);
        if is_given && !has_effect(setting, &name) {
            let option = setting.replace('_', "-");
            let problem = format!("--{option} has no effect on `jostled {name}`: leave it out");
            return Err(command_line().error(ErrorKind::ArgumentConflict, problem));
        }
    }
    Ok(())
}

fn joined(parent: &str, command: &str) -> String {
    format!("{parent} {command}").trim_start().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_flags_are_consistent() {
        command_line().debug_assert();
    }

    #[test]
    fn the_help_begins_with_what_the_program_does() {
        let help = command_line().render_long_help().to_string();
        assert!(help.starts_with("Hosts swarms of bodies"), "{help}");
    }

    #[test]
    fn a_command_offers_the_settings_that_have_an_effect_on_it_and_rejects_others() {
        let read = |line: &str| {
            let words = ["jostled"].into_iter().chain(line.split(' '));
            let matches = command_line().try_get_matches_from(words)?;
            reject_unused(&matches)
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
            "check school.html --log info",
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
        for name in [
            "serve",
            "demo",
            "run",
            "check",
            "man",
            "backup",
            "restore",
            "doctor",
            "config explain",
            "config default",
            "auth init",
            "auth address",
            "auth add",
            "auth remove",
            "auth list",
        ] {
            for flag in settings::flags() {
                let setting = settings::name(&flag);
                let has_effect = has_effect(setting, name);
                assert_eq!(is_offered(name, setting), has_effect, "{name} {setting}");
            }
        }
    }
}
