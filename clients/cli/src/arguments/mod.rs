//! The command line.

mod auth;
mod claims;
mod connection;
mod experiment;
mod export;
mod global;
mod help;
mod inspect;
mod parameters;
mod parts;
mod recording;
mod replay;
mod sending;
mod verbs;
mod which;

use clap::{Parser, Subcommand};

pub use self::auth::*;
pub use self::claims::*;
pub use self::connection::*;
pub use self::experiment::*;
pub use self::export::*;
pub use self::global::command;
pub use self::help::{EXAMPLES, HelpArguments, TOPICS, topics};
pub use self::inspect::*;
pub use self::parameters::{ASSIGNED, NumberArguments};
pub use self::parts::*;
pub use self::recording::*;
pub use self::replay::*;
pub use self::sending::*;
pub use self::verbs::*;
pub use self::which::*;

/// Observes and steers swarms that a daemon, `jostled`, hosts
#[derive(Debug, Parser)]
#[command(
    name = "jostle",
    version,
    max_term_width = 100,
    arg_required_else_help = true,
    subcommand_value_name = "VERB",
    subcommand_help_heading = "Verbs",
    disable_help_subcommand = true,
    after_help = help::overview()
)]
pub struct Arguments {
    #[command(flatten)]
    pub global: GlobalArguments,
    #[command(subcommand)]
    pub verb: Verb,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Creates a paused swarm
    Create(CreateArguments),
    /// Lists the swarms of a daemon
    List(FilterArguments),
    /// Shows the status of a swarm: phase, step, order, certificate
    Status(SwarmArguments),
    /// Lists the parameters of a swarm: values, ranges, units, and the verbs that change them
    Parameters(SwarmArguments),
    /// Evaluates measures of a swarm, such as milling; without a swarm lists all measures
    Measures(MeasuresArguments),
    /// Lists the controllers of a swarm and how long it waits for each
    Controllers(SwarmArguments),
    /// Prints the spec of a swarm, as `create --spec` reads it
    Spec(SwarmArguments),
    /// Lists the commands that a swarm has applied
    Journal(JournalArguments),
    /// Lists who sent which commands to a daemon, and with what outcome; requires an operator
    Audit(AuditArguments),
    /// Lists the reachable daemons
    Nodes,
    /// Shows the load and the speed of a daemon and its swarms, live
    Top(TopArguments),
    /// Lists the events of a swarm
    Events(EventsArguments),
    /// Shows swarms live; on a terminal in a full-screen view that also steers them
    Watch(WatchArguments),
    /// Records the states of a swarm, to a file or on the daemon
    Record(RecordArguments),
    /// Plays a recording as a swarm that can be watched, paused, stepped and sought
    Replay(ReplayArguments),
    /// Moves a playback to another place in its recording
    Seek(SeekArguments),
    /// Runs swarms, or changes the end and the rate of running ones
    Run(RunArguments),
    /// Pauses swarms
    Pause(SwarmsArguments),
    /// Executes steps of a paused swarm, as fast as possible
    Step(StepArguments),
    /// Resets a swarm to its initial state, paused
    Reset(ResetArguments),
    /// Sets parameters of a swarm
    Set(SetArguments),
    /// Gives individuals a preferred direction
    Inform(InformArguments),
    /// Removes the preferred direction of individuals
    Uninform(SelectArguments),
    /// Adds individuals at free positions
    Inject(InjectArguments),
    /// Removes individuals
    Remove(SelectArguments),
    /// Applies several changes atomically, at one step
    Batch(BatchArguments),
    /// Removes a controller, so that the swarm no longer waits for it
    Leave(LeaveArguments),
    /// Writes a note to the journal and the events of a swarm
    Annotate(AnnotateArguments),
    /// Pauses or changes a swarm once a condition holds
    When(WhenArguments),
    /// Waits until a condition holds in a swarm; without --timeout it waits as long as it takes
    Wait(WaitArguments),
    /// Protects swarms from `delete` and `reset`, or ends that
    Protect(ProtectArguments),
    /// Deletes swarms
    Delete(SwarmsArguments),
    /// Creates a paused copy of a swarm, at its current or an earlier step
    Fork(ForkArguments),
    /// Compares two swarms: specs, commands, positions and order
    Diff(DiffArguments),
    /// Writes the complete state of a swarm to a file
    Snapshot(SnapshotArguments),
    /// Creates a paused swarm from a snapshot file of the same or an earlier model version
    Restore(RestoreArguments),
    /// Replays the history of a swarm and compares state hashes; without --timeout for up to an hour
    Verify(SwarmArguments),
    /// Writes one HTML file that re-runs a swarm or a run in a browser, or plays a recording
    Export(ExportArguments),
    /// Executes the run of an HTML file again and compares how it ends; needs no daemon
    Check(CheckArguments),
    /// Shows your identity and your permissions on the daemon
    Auth(AuthArguments),
    /// Executes experiments on the daemon: grids of runs
    Experiment(ExperimentArguments),
    /// Merges results of experiments that several machines executed
    Results(ResultsVerbArguments),
    /// Draws charts of results, figures of the paper, and snapshots of swarms
    #[command(alias = "figure")]
    Plot(PlotArguments),
    /// Compares results with the claims of the paper, or with bands of earlier results
    Claims(ClaimsArguments),
    /// Checks the connection to a daemon and suggests remedies
    Doctor,
    /// Prints the JSON Schemas of the messages on the wire
    Schema(SchemaArguments),
    /// Prints the line that enables completion of verbs, options and names in a shell
    Completions(CompletionsArguments),
    /// Prints the manual page, or writes one for each verb
    Man(ManArguments),
    /// Describes a verb or a topic; `help topics` lists the topics
    Help(HelpArguments),
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::collections::BTreeSet;
    use std::{env, fs};

    use serde_json::{Map, Value};

    use super::*;

    /// Every verb with its arguments, an option of every verb only once.
    fn surface() -> String {
        let mut command = command();
        command.build();
        let mut lines = Vec::new();
        let verbs = command.get_subcommands().flat_map(|verb| {
            let of_verb = verb.get_subcommands();
            let named = of_verb.map(|it| (format!("{} {}", verb.get_name(), it.get_name()), it));
            [(verb.get_name().to_owned(), verb)]
                .into_iter()
                .chain(named)
        });
        let jostle = [("jostle".to_owned(), &command)];
        for (name, verb) in jostle.into_iter().chain(verbs) {
            if name.split(' ').any(|word| word == "help") {
                continue;
            }
            let is_verb = name != "jostle";
            let in_common: Vec<_> = command.get_arguments().map(clap::Arg::get_id).collect();
            for argument in verb.get_arguments() {
                let is_in_common = in_common.contains(&argument.get_id());
                if is_verb && is_in_common || argument.get_id() == "help" {
                    continue;
                }
                let flags = argument.get_long().map(|long| format!("--{long}"));
                let flags = flags.unwrap_or_else(|| format!("<{}>", argument.get_id()));
                lines.push(format!("{name} {flags}"));
                let short = argument.get_short().map(|short| format!("-{short}"));
                lines.extend(short.map(|short| format!("{name} {short}")));
            }
            if is_verb {
                lines.push(name);
            }
        }
        lines.sort();
        lines.join("\n")
    }

    #[test]
    fn nothing_that_scripts_may_use_is_lost() {
        const COMMAND: &str = "JOSTLE_RECORD=1 cargo test --release -p jostle-cli scripts";
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/surface.txt");
        let surface = format!("{}\n", surface());
        if env::var_os("JOSTLE_RECORD").is_some() {
            fs::write(file, &surface).unwrap();
        }
        let listed = fs::read_to_string(file).unwrap();
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<BTreeSet<_>>();
        let (now, before) = (lines(&surface), lines(&listed));
        let (new, lost): (Vec<_>, Vec<_>) = (
            now.difference(&before).collect(),
            before.difference(&now).collect(),
        );
        assert_eq!(
            surface, listed,
            "new: {new:?}, lost: {lost:?}; `{COMMAND}` writes {file}"
        );
    }

    #[test]
    fn the_help_of_set_names_each_field_that_an_assignment_can_have() {
        let mut command = command();
        let set = command.find_subcommand_mut("set").unwrap();
        let help = set.render_long_help().to_string();
        let (assignments, _) = help.split_once(", such as").unwrap();
        let fixtures = concat!(env!("CARGO_MANIFEST_DIR"), "/../../proto/fixtures");
        let files = fs::read_dir(fixtures)
            .unwrap()
            .map(|file| file.unwrap().path());
        let of_set = files.filter(|file| {
            let name = file.file_name().and_then(|name| name.to_str()).unwrap();
            name.starts_with("set.args")
        });
        let mut fields = BTreeSet::new();
        for file in of_set {
            let args: Map<String, Value> =
                serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
            fields.extend(args.into_iter().map(|(field, _)| field));
        }
        assert!(fields.remove("make_room"), "is an option");
        assert!(fields.len() > 10, "{fields:?}");
        let words: BTreeSet<&str> = assignments.split([' ', ',', '\n']).collect();
        for field in fields {
            assert!(words.contains(field.as_str()), "{field}: {assignments}");
        }
    }

    fn read(line: &str) -> Result<Arguments, clap::Error> {
        Arguments::read(["jostle"].into_iter().chain(line.split(' ')))
    }

    #[test]
    fn clap_finds_no_contradiction_in_the_arguments() {
        command().debug_assert();
    }

    #[test]
    fn negative_numbers_are_values() {
        for line in [
            "inform demo --count 3 --direction -1.57",
            "inform demo --count 3 --degrees -90 --weight -1 --for-time -2",
            "inform demo --foremost 3 --along -3.1 --direction -.5",
            "inject demo --at -3,2,0 --at -4,-2,-1e-3 --direction -1",
            "inject demo --count 2 --within -3,-2,1",
            "uninform demo --within -1,-1,2",
            "run demo --until -5 --rate -2",
            "set demo pi1=-6 pi2=-1",
        ] {
            assert!(read(line).is_ok(), "{line}: {}", read(line).unwrap_err());
        }
    }

    #[test]
    fn a_word_that_an_option_took_is_named() {
        for (line, expected) in [
            (
                "when --cancel 99",
                "NAME is missing: 99 is the ID of --cancel; write `jostle when NAME --cancel 99`, or \
                 `jostle when 99 --cancel` if it is the NAME",
            ),
            (
                "--json when --cancel demo",
                "NAME is missing: demo is the ID of --cancel",
            ),
            (
                "experiment results --series small",
                "NAME is missing: small is the RUN of --series; write `jostle experiment results NAME \
                 --series small`",
            ),
        ] {
            let error = read(line).unwrap_err();
            let text = error.to_string();
            assert!(text.contains(expected), "{line}: {text}");
            assert!(text.contains("Usage: jostle "), "{line}: {text}");
            assert_eq!(error.exit_code(), 2, "{line}");
        }
        for line in ["when", "when --cancel", "when --cancel --json", "delete"] {
            let text = read(line).unwrap_err().to_string();
            assert!(text.contains("required arguments"), "{line}: {text}");
        }
        for line in [
            "when demo --cancel 99",
            "when --cancel 99 demo",
            "when demo --cancel",
        ] {
            assert!(read(line).is_ok(), "{line}");
        }
    }

    #[test]
    fn contradictions_are_refused() {
        for line in [
            "inform demo --count 3",
            "inform demo --count 3 --direction 1 --degrees 2",
            "inform demo --direction 1",
            "inject demo --count 1 --at 1,2,3",
            "inject demo",
            "run demo --until 3 --until-step 3",
            "create demo",
            "set demo",
            "annotate demo",
            "when demo order>0",
            "when demo order>0 reset",
            "when demo order>0 pause --cancel",
            "when demo order>0 pause --commands a.json",
            "run demo --until nan",
            "run demo --until soon",
            "run demo --until order>0 --until-step 3",
            "delete",
            "watch demo --count 0",
            "record demo",
            "record demo -o a.mcap --every 0",
            "record demo -o a.mcap --steps 0",
            "record demo -o a.mcap --at-daemon",
            "record demo -o a.mcap --as take",
            "record demo -o a.mcap --request-id one",
            "record demo --at-daemon --for 3",
            "record demo --at-daemon --list",
            "record demo -o a.mcap --max-size 0",
            "record demo -o a.mcap --max-size 1TiB5",
            "record demo -o a.mcap --published --drop-when-behind",
            "record demo --published",
            "record --fetch take",
            "record demo --fetch take -o a.mcap",
            "record --fetch take -o a.mcap --every 5",
            "record demo --list",
            "record --at-daemon",
            "record --list --every 5",
            "record --list --stop take",
            "record --stop take --delete take",
            "record --stop a/b",
            "record demo --delete take",
            "step demo -3",
            "status demo --timeout 0",
            "pause",
            "pause a/*",
            "run",
            "list --where n",
            "delete --where phase=runing",
            "delete demo a/b",
            "--node ** list",
            "--prefix a* list",
            "status demo --expect-step 3",
            "list --client me",
            "create demo --n 3 --at-step 4",
            "pause demo --at-step -1",
            "run demo --until 3 --wait --at-step 4",
            "status demo --watch",
            "events demo --limit 0",
            "audit --limit 0",
            "audit --limit 5 --all",
            "audit --user a;b",
            "audit --since yesterday",
            "audit demo",
            "journal demo --verb a;b",
            "journal demo --as-experiment --from-step 3",
            "completions tcsh",
            "fork demo",
            "fork demo a/b",
            "fork demo other --at-step -1",
            "fork demo other --expect-step 1",
            "snapshot demo",
            "restore",
            "diff demo",
            "verify",
            "export demo",
            "export demo -o a.html --no-engine --wasm a",
            "check",
            "experiment",
            "experiment run",
            "experiment pause a/b",
            "experiment results a -o b --csv",
            "experiment results a --by n --csv",
            "experiment results a --limit 3 -o b",
            "experiment results a --limit 0",
            "plot 2 results",
            "plot a --x n -o a.svg",
            "plot a --over-time -o a.svg",
            "plot a --y v --x n --over-time -o a.svg",
        ] {
            assert!(read(line).is_err(), "{line}");
        }
    }
}
