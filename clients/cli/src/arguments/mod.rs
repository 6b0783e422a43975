//! What may be typed.

mod auth;
mod claims;
mod copies;
mod experiment;
mod global;
mod looking;
mod parts;
mod recording;
mod replay;
mod sending;
mod verbs;

use clap::{Parser, Subcommand};

pub use self::auth::*;
pub use self::claims::*;
pub use self::copies::*;
pub use self::experiment::*;
pub use self::global::*;
pub use self::looking::*;
pub use self::parts::*;
pub use self::recording::*;
pub use self::replay::*;
pub use self::sending::*;
pub use self::verbs::*;

/// Where a daemon listens unless told otherwise.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

const EXAMPLES_AND_EXIT_CODES: &str = "\
Examples:
  jostle create demo --n 50 --seed 1
  jostle inform demo --fraction 0.1 --direction 0
  jostle run demo --until 100 --rate max --wait
  jostle watch demo
  jostle --json watch demo --frames --count 3
  jostle set demo pi1=6 --make-room --at-step 9000
  jostle status demo --watch
  jostle record demo -o demo.mcap --for 20s
  jostle record demo --at-daemon --every 50
  jostle replay demo.mcap --as tape
  jostle fork demo other --at-step 5000
  jostle diff demo other
  jostle snapshot demo -o demo.snapshot
  jostle experiment run order.toml
  jostle experiment results order -o results
  jostle figure 2 results -o figure-2.svg
  jostle doctor

Lengths are in body sizes, speeds in free speeds, times in their quotient; angles are radians
counter-clockwise from +x. Data goes to stdout, talk to stderr. With --json a reply is printed
as it came, a stream as a line per sample or event, and an error as an object on stderr. A command
whose answer is lost, or that comes when too much is going on, is sent again under its request_id
until --timeout; the daemon carries it out once.

Exit codes:
    0  done
    1  failed: a defect, or the swarm faulted (internal, faulted)
    2  the command line or an argument is wrong (invalid_argument)
    3  no such swarm or node (not_found)
    4  not in this state (conflict, contested, incorrect_state, already_exists)
    5  not permitted (permission_denied)
    6  no daemon, or no answer in time (unreachable, deadline_exceeded, timeout)
    7  too much (busy, resource_exhausted)
    8  the disk is full, the daemon's or here (storage_full)
    9  a replay has other hashes, or a mean lies outside its band (mismatch)
  130  interrupted by Ctrl-C; `record` to a file takes SIGTERM and SIGHUP as Ctrl-C, ends the file
       and then ends with 0";

/// Watches and steers swarms hosted by a daemon, `jostled`
#[derive(Debug, Parser)]
#[command(
    name = "jostle",
    version,
    max_term_width = 100,
    arg_required_else_help = true,
    subcommand_value_name = "VERB",
    subcommand_help_heading = "Verbs",
    after_help = EXAMPLES_AND_EXIT_CODES
)]
pub struct Arguments {
    /// The options that verbs have in common.
    #[command(flatten)]
    pub global: GlobalArguments,
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Creates a swarm, paused
    Create(CreateArguments),
    /// Looks.
    #[command(flatten)]
    Look(Look),
    /// Shows what happened to a swarm
    Events(EventsArguments),
    /// Watches swarms live; on a terminal a view that steers them, too
    Watch(WatchArguments),
    /// Records a swarm to a file, every k-th state of it, or has the daemon record it
    Record(RecordArguments),
    /// Shows a recording as if it were a swarm: to watch, pause, step and seek
    Replay(ReplayArguments),
    /// Has a replay go somewhere else in its recording
    Seek(SeekArguments),
    /// Lets a swarm run; changes target and rate of one that runs
    Run(RunArguments),
    /// Pauses a swarm
    Pause(PauseArguments),
    /// Runs a paused swarm some steps on, as fast as it can
    Step(StepArguments),
    /// Puts a swarm back to its start, paused
    Reset(ResetArguments),
    /// Changes parameters of a swarm and leaves the others
    Set(SetArguments),
    /// Gives individuals a direction of their own
    Inform(InformArguments),
    /// Takes individuals' direction away
    Uninform(SelectArguments),
    /// Adds individuals where they overlap nobody
    Inject(InjectArguments),
    /// Takes individuals out of the group
    Remove(SelectArguments),
    /// Applies several changes at one step, or none
    Batch(BatchArguments),
    /// Has a controller leave a swarm, so that nobody waits for it
    Leave(LeaveArguments),
    /// Writes a note into the journal and the events of a swarm; changes nothing else
    Annotate(AnnotateArguments),
    /// Deletes swarms
    Delete(DeleteArguments),
    /// Makes another swarm as this one is or was, paused: one future until treated differently
    Fork(ForkArguments),
    /// Shows where and how two swarms part: what they were told, where they are
    Diff(DiffArguments),
    /// Writes a swarm with all that its future depends on to a file
    Snapshot(SnapshotArguments),
    /// Makes a swarm from such a file, on a daemon of the same model version, paused
    Restore(RestoreArguments),
    /// Tells a swarm's kept history again and says whether it comes out the same
    Verify(VerifyArguments),
    /// Says who you are to the daemon, and what you may
    Auth(AuthArguments),
    /// Carries out experiments: grids of runs, on the daemon, whether anybody looks on or not
    Experiment(ExperimentArguments),
    /// Merges results of experiments that several machines executed
    Results(ResultsVerbArguments),
    /// Draws a figure of the paper from results, or swarms as they are
    Figure(FigureArguments),
    /// Holds results against the paper's claims, or against the bands of earlier ones
    Claims(ClaimsArguments),
    /// Finds out whether everything works from here, and what to do if not
    Doctor,
    /// Describes the messages on the wire, as JSON Schemas
    Schema(SchemaArguments),
    /// Prints the line that makes a shell complete verbs, options, swarms and parameters
    Completions(CompletionsArguments),
    /// Prints the manual page, or writes one for each verb
    Man(ManArguments),
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

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
        let surface = surface();
        let listed = include_str!("../../surface.txt");
        assert_eq!(surface, listed.trim_end(), "now:\n{surface}");
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
            "pause *",
            "delete demo a/b",
            "--node ** list",
            "--prefix a* list",
            "status demo --expect-step 3",
            "list --client me",
            "create demo --n 3 --at-step 4",
            "pause demo --at-step -1",
            "run demo --until 3 --wait --at-step 4",
            "status demo --watch 0",
            "events demo --limit 0",
            "completions tcsh",
            "fork demo",
            "fork demo a/b",
            "fork demo other --at-step -1",
            "fork demo other --expect-step 1",
            "snapshot demo",
            "restore",
            "diff demo",
            "verify",
            "experiment",
            "experiment run",
            "experiment pause a/b",
            "experiment results a -o b --csv",
            "figure 3 results -o a.svg",
            "figure 2 results",
            "figure 2 -o a.svg",
        ] {
            assert!(read(line).is_err(), "{line}");
        }
    }
}
