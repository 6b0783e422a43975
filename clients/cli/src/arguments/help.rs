//! The examples of verbs, and the topics of `jostle help`.

use clap::Args;

/// A verb, or a topic, to describe.
#[derive(Debug, Args)]
pub struct HelpArguments {
    /// A verb such as `run` or `experiment run`, or a topic; `topics` lists the topics
    #[arg(value_name = "VERB|TOPIC")]
    pub words: Vec<String>,
}

/// A page of `jostle help`.
pub struct Topic {
    pub name: &'static str,
    pub about: &'static str,
    pub text: &'static str,
}

pub const TOPICS: [Topic; 4] = [
    Topic {
        name: "selectors",
        about: "How to select individuals and swarms",
        text: "\
`inform`, `uninform` and `remove` take exactly one selector of individuals:
  --ids 1,4-7                  these ids and ranges of ids
  --count 5                    5 individuals, drawn at random
  --fraction 10%               a share of all, drawn at random; also 0.1
  --within X,Y,RADIUS          all whose centre is in a disc
  --informed, --uninformed     all that have a direction of their own, all that have none
  --foremost 3 --along 1.57    the 3 furthest in a direction, in radians from +x

Draws depend on the seed and the seq of the command: a replay draws the same individuals.

`list`, `top`, `run`, `pause`, `protect` and `delete` take patterns of names, quoted for the
shell: `*` matches any text, `?` one character, `[abc]` one of these characters; and --where,
such as --where 'n >= 200 and phase = running'. The last four list what these match and ask for
confirmation; without a terminal they require --yes. `delete` leaves protected swarms.

Examples:
  jostle inform school --fraction 10% --degrees 90
  jostle remove school --within 0,0,5
  jostle delete 'test-*' --yes",
    },
    Topic {
        name: "exit-codes",
        about: "The exit codes, and the error codes of each",
        text: EXIT_CODES,
    },
    Topic {
        name: "environment",
        about: "The environment variables",
        text: "\
  JOSTLE_ENDPOINT      the default of --endpoint, such as tcp/127.0.0.1:7447
  JOSTLE_CREDENTIALS   the default of --credentials, a folder; empty for none
  JOSTLE_COMPLETE      set by the line that `jostle completions SHELL` prints
  NO_COLOR             if not empty, `jostle watch` uses no colours
  TERM                 `dumb` turns off the full-screen view and redrawing in place
  USER, LOGNAME        the user in the default of --client, user@host

An option overrides its variable. An endpoint given by option or variable overrides the one
in the credentials.

Example:
  JOSTLE_ENDPOINT=tcp/127.0.0.1:7448 jostle list",
    },
    Topic {
        name: "credentials",
        about: "How to connect to a daemon that authenticates its users",
        text: "\
A daemon with `auth_dir` authenticates its users and accepts connections of other machines, over
TLS. `jostled auth init` and `jostled auth add` write a folder for each user, with a certificate, a
password and a token. Pass the folder by --credentials FOLDER or JOSTLE_CREDENTIALS. It also has the
endpoint of the daemon, which --endpoint overrides.

Roles: a viewer watches; a controller may also join, advance, leave and annotate; an operator may
execute every verb. `permission_denied` (exit code 5) names the role that a verb requires.

Examples:
  jostle --credentials people/vera auth whoami
  jostle --credentials people/vera auth can pause
  jostle --credentials people/vera auth link",
    },
];

const EXIT_CODES: &str = "\
Exit codes:
    0  done
    1  failed: a defect, the swarm faulted, or `check` is not equal (internal, faulted, different)
    2  invalid command line or argument (invalid_argument)
    3  no such swarm, node, experiment, recording or message (not_found)
    4  not in this state (conflict, contested, incorrect_state, already_exists)
    5  not permitted (permission_denied)
    6  no daemon, or no reply in time (unreachable, deadline_exceeded, timeout)
    7  a limit is exceeded (busy, resource_exhausted)
    8  the disk of the daemon or of this machine is full (storage_full)
    9  a replay has other hashes, or a mean is outside its band (mismatch)
  130  interrupted by Ctrl-C; `record` and `experiment results` to files treat SIGTERM and SIGHUP
       like Ctrl-C; `record` completes its file and exits with 0";

const OVERVIEW: &str = "\
Examples:
  jostle create demo --n 50 --seed 1
  jostle inform demo --fraction 0.1 --direction 0
  jostle run demo --until 100 --rate max --wait
  jostle watch demo
  watch -n1 jostle status demo
  jostle --json watch demo --frames --count 3
  jostle set demo pi1=6 --make-room --at-step 9000
  jostle record demo -o demo.mcap --for 20s
  jostle record demo --at-daemon --every 50
  jostle replay demo.mcap --as tape
  jostle fork demo other --at-step 5000
  jostle diff demo other
  jostle snapshot demo -o demo.snapshot
  jostle experiment run order.toml
  jostle experiment results order -o results
  jostle plot results --y v --x n -o v.svg
  jostle doctor

Lengths are in body sizes, speeds in free speeds, times in their quotient; angles are radians
counter-clockwise from +x. Data goes to stdout, notes and errors to stderr. With --json a reply is
printed as received, a stream as a line per sample or event, and an error as an object on stderr.
If the reply to a command is lost, or the daemon is busy, the client retries it with the same
request_id until --timeout; the daemon executes it once.";

/// What follows the options of `jostle --help`.
pub fn overview() -> String {
    format!(
        "{OVERVIEW}\n\n{EXIT_CODES}\n\nTopics (jostle help TOPIC):\n{}",
        topics()
    )
}

/// The list of topics.
pub fn topics() -> String {
    let lines = TOPICS
        .iter()
        .map(|it| format!("  {:12} {}", it.name, it.about));
    lines.collect::<Vec<_>>().join("\n")
}

/// One example of each verb.
pub const EXAMPLES: [(&str, &str); 61] = [
    ("create", "create school --n 50 --seed 1"),
    ("list", "list"),
    ("status", "status school"),
    ("parameters", "parameters school"),
    ("measures", "measures school order milling"),
    ("controllers", "controllers school"),
    ("spec", "spec school > spec.json"),
    ("journal", "journal school --limit 10"),
    ("audit", "audit --verb delete --since 3d"),
    ("nodes", "nodes"),
    ("top", "top --sort factor"),
    ("events", "events school --follow"),
    ("watch", "watch school"),
    ("record", "record school -o school.mcap --steps 1000"),
    ("replay", "replay school.mcap --as tape"),
    ("seek", "seek tape --fraction 50%"),
    ("run", "run school --until 100 --rate max --wait"),
    ("pause", "pause school"),
    ("step", "step school 10"),
    ("reset", "reset school --seed 2"),
    ("set", "set school pi1=6 --make-room"),
    ("inform", "inform school --fraction 10% --degrees 90"),
    ("uninform", "uninform school --ids 1,4-7"),
    ("inject", "inject school --count 5"),
    ("remove", "remove school --within 0,0,5"),
    ("batch", "batch school changes.json"),
    ("leave", "leave school pilot"),
    ("annotate", "annotate school 'camera 2 replaced'"),
    ("when", "when school 'order>0.9' pause"),
    ("wait", "wait school 'drift>0.9' --timeout 60"),
    ("protect", "protect school"),
    ("delete", "delete 'test-*' --yes"),
    ("fork", "fork school other --at-step 5000"),
    ("diff", "diff school other"),
    ("snapshot", "snapshot school -o school.snapshot"),
    ("restore", "restore school.snapshot copy"),
    ("verify", "verify school"),
    ("export", "export school -o school.html"),
    ("check", "check school.html"),
    ("auth whoami", "auth whoami --credentials people/vera"),
    ("auth can", "auth can pause"),
    ("auth link", "auth link --credentials people/vera"),
    ("experiment run", "experiment run order.toml"),
    (
        "experiment play",
        "experiment play order.toml --run 17 --as live",
    ),
    (
        "experiment plan",
        "experiment plan order.toml --parts 4 --emit slurm",
    ),
    ("experiment list", "experiment list"),
    ("experiment status", "experiment status order"),
    ("experiment attach", "experiment attach order"),
    ("experiment pause", "experiment pause order"),
    ("experiment resume", "experiment resume order"),
    ("experiment cancel", "experiment cancel order"),
    ("experiment delete", "experiment delete order"),
    (
        "experiment results",
        "experiment results order --by pi3,pi4",
    ),
    (
        "results merge",
        "results merge order-parts -o results --verify 1%",
    ),
    ("plot", "plot order --y v --x n -o v.svg"),
    ("claims", "claims results --page claims.md"),
    ("doctor", "doctor"),
    ("schema", "schema step.args"),
    ("completions", "completions bash >> ~/.bashrc"),
    ("man", "man -o ~/.local/share/man/man1"),
    ("help", "help exit-codes"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Arguments, command};

    #[test]
    fn every_example_is_a_valid_command_line_of_its_verb() {
        for (verb, example) in EXAMPLES {
            assert!(example.starts_with(verb), "{verb}: {example}");
            let (line, _) = example.split_once(" >").unwrap_or((example, ""));
            let line = line.replace('\'', "").replace("camera 2 ", "");
            let words = ["jostle"].into_iter().chain(line.split(' '));
            Arguments::read(words).unwrap_or_else(|error| panic!("{example}: {error}"));
        }
    }

    #[test]
    fn every_verb_has_an_example() {
        let command = command();
        for verb in command.get_subcommands() {
            let of_verb = verb.get_subcommands();
            let mut names: Vec<String> = of_verb
                .map(|it| format!("{} {}", verb.get_name(), it.get_name()))
                .collect();
            if names.is_empty() {
                names.push(verb.get_name().to_owned());
            }
            for name in names {
                assert!(EXAMPLES.iter().any(|(verb, _)| *verb == name), "{name}");
            }
        }
    }
}
