//! Shell completion: verbs and options by clap, names of swarms and daemons by queries.

use std::ffi::OsStr;
use std::time::Duration;

use clap::Command;
use clap::builder::StyledStr;
use clap::error::ErrorKind;
use clap_complete::CompleteEnv;
use clap_complete::engine::CompletionCandidate;
use jostle_client::{Client, ConnectOptions, Error};
use jostle_measures::Measure;
use jostle_proto::keys::DEFAULT_PREFIX;
use jostle_proto::{contract, keys};

use crate::arguments::ASSIGNED;
use crate::failure::Failure;
use crate::output::{self, Output};
use crate::values::{self, FIELDS, LAWS};

/// The variable by which a shell requests completions.
const VARIABLE: &str = "JOSTLE_COMPLETE";
/// How long completion may block the shell.
const COMPLETION_TIMEOUT: Duration = Duration::from_millis(300);

/// The supported shells.
pub const SHELLS: [&str; 5] = ["bash", "zsh", "fish", "elvish", "powershell"];

/// Prints completions and exits if a shell requests them.
pub fn complete_if_requested(command: fn() -> Command) {
    let variable = |name| std::env::var(name).ok();
    if variable(VARIABLE).as_deref() == Some("bash")
        && let Some(at) = variable("_CLAP_COMPLETE_INDEX")
        && let Some(values) = values_behind_equals(&std::env::args().collect::<Vec<_>>(), &at)
    {
        let values: Vec<_> = values
            .iter()
            .map(|it| it.get_value().to_string_lossy())
            .collect();
        let separator = variable("_CLAP_IFS").unwrap_or_else(|| "\n".into());
        exit(output::write(&values.join(&separator)));
    }
    let completed = CompleteEnv::with_factory(command)
        .var(VARIABLE)
        .try_complete(std::env::args_os(), std::env::current_dir().ok().as_deref());
    match completed {
        Ok(true) => exit(output::write("")),
        Ok(false) => {}
        // It lacks the kind, which another write has.
        Err(error) if error.kind() == ErrorKind::Io => exit(output::write("\n")),
        Err(error) => error.exit(),
    }
}

/// The line that enables completion, and the file where it belongs.
pub fn line(shell: &str) -> (String, &'static str) {
    match shell {
        "fish" => (
            format!("{VARIABLE}=fish jostle | source"),
            "~/.config/fish/completions/jostle.fish",
        ),
        "elvish" => (
            format!("set E:{VARIABLE} = elvish; eval (jostle | slurp); unset-env {VARIABLE}"),
            "~/.config/elvish/rc.elv",
        ),
        "powershell" => (
            format!(
                "$env:{VARIABLE} = \"powershell\"; jostle | Out-String | Invoke-Expression; \
                 Remove-Item Env:\\{VARIABLE}"
            ),
            "$PROFILE",
        ),
        "zsh" => (format!("source <({VARIABLE}=zsh jostle)"), "~/.zshrc"),
        _ => (format!("source <({VARIABLE}=bash jostle)"), "~/.bashrc"),
    }
}

/// Ends the process: a shell has requested nothing else.
fn exit(written: Result<(), Failure>) -> ! {
    let code = written.as_ref().map_or_else(Failure::exit_code, |()| 0);
    if let Err(failure) = written {
        Output { json: false }.failure(&failure);
    }
    std::process::exit(code.into())
}

pub fn swarms(typed: &OsStr) -> Vec<CompletionCandidate> {
    names(typed, async |client| client.swarms().await)
}

pub fn nodes(typed: &OsStr) -> Vec<CompletionCandidate> {
    names(typed, async |client| client.nodes().await)
}

/// The names of the daemon's experiments.
pub fn experiments(typed: &OsStr) -> Vec<CompletionCandidate> {
    names(typed, async |client| client.experiments().await)
}

/// The names of the daemon's recordings.
pub fn recordings(typed: &OsStr) -> Vec<CompletionCandidate> {
    names(typed, async |client| client.recordings().await)
}

/// The figures that can be drawn, and the experiments.
pub fn plots(typed: &OsStr) -> Vec<CompletionCandidate> {
    let mut plots = beginning_with(typed, values::figures());
    plots.extend(experiments(typed));
    plots
}

/// The verbs of the commands in a journal.
pub fn verbs_of_swarms(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(typed, keys::SWARM_VERBS.iter().chain(&keys::OWN_VERBS))
}

/// The verbs of all commands that a client sends.
pub fn verbs(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(typed, keys::SWARM_VERBS.iter().chain(&keys::NODE_VERBS))
}

/// The verbs that have messages, the messages, and the file of an experiment.
pub fn messages(typed: &OsStr) -> Vec<CompletionCandidate> {
    let verbs = keys::SWARM_VERBS.into_iter().chain(keys::NODE_VERBS);
    let mut messages = contract::messages();
    messages.insert(jostle_experiment::SCHEMA);
    beginning_with(typed, verbs.chain(messages))
}

/// The measures of one state, which a daemon evaluates.
pub fn measures(typed: &OsStr) -> Vec<CompletionCandidate> {
    let measures = Measure::all_of_one_state();
    beginning_with(typed, measures.iter().map(ToString::to_string))
}

pub fn contact_rules(typed: &OsStr) -> Vec<CompletionCandidate> {
    choices(typed, "contacts")
}

/// The values of `--stepping`.
pub fn steppings(typed: &OsStr) -> Vec<CompletionCandidate> {
    choices(typed, "stepping")
}

/// The laws of attraction, those with a number up to the `=`.
pub fn laws(typed: &OsStr) -> Vec<CompletionCandidate> {
    let laws = LAWS.map(|(law, number)| match number {
        Some(_) if law != "all" => format!("{law}="),
        _ => law.to_owned(),
    });
    beginning_with(typed, laws)
}

/// Completes the last word of a `--where`: a field where one begins a comparison, or a word that a field
/// can be.
pub fn selections(typed: &OsStr) -> Vec<CompletionCandidate> {
    let Some(typed) = typed.to_str() else {
        return Vec::new();
    };
    let start = typed.rfind([' ', '(', '=']).map_or(0, |at| at + 1);
    let (before, word) = typed.split_at(start);
    let words: Vec<&str> = before
        .split([' ', '('])
        .filter(|it| !it.is_empty())
        .collect();
    let (fields, word) = (FIELDS.iter(), OsStr::new(word));
    let found = match words.as_slice() {
        [] | [.., "and" | "or"] => beginning_with(word, fields.map(|(field, _)| field)),
        [.., field, "=" | "!="] => {
            let words = fields.filter(|(it, _)| it == field);
            beginning_with(word, words.flat_map(|(_, words)| words.iter()))
        }
        _ => Vec::new(),
    };
    let found = found.into_iter();
    found.map(|it| it.add_prefix(before)).collect()
}

/// The values of an enumerated parameter; empty for any other parameter.
fn values_of(field: &str, typed: &str) -> Vec<CompletionCandidate> {
    match field {
        "attraction" => laws(OsStr::new(typed)),
        field => choices(OsStr::new(typed), field),
    }
}

/// The values of an enumerated parameter.
fn choices(typed: &OsStr, name: &str) -> Vec<CompletionCandidate> {
    let parameters = contract::parameters().into_iter();
    let parameter = parameters.filter(|it| it.name == name);
    let choices: Vec<_> = parameter.flat_map(|it| it.choices).collect();
    beginning_with(typed, choices.iter().filter_map(|choice| choice.as_str()))
}

/// Completes the value in `contacts=end` or `--contacts=end` for bash, which splits the word and
/// passes `contacts`, `=` and `end`.
fn values_behind_equals(words: &[String], at: &str) -> Option<Vec<CompletionCandidate>> {
    let typed = words.iter().position(|word| word == "--")? + 1;
    let words = words.get(typed..=typed + at.parse::<usize>().ok()?)?;
    let (field, typed) = match words {
        [.., field, equals, typed] if equals == "=" => (field, typed),
        // Directly after the `=` bash passes an empty word instead.
        [before @ .., field, typed] if typed.is_empty() => {
            let is_set = before.iter().any(|word| word == "set");
            // The word after the verb is a swarm.
            let is_swarm = before.last().is_some_and(|word| word == "set");
            (field.starts_with("--") || is_set && !is_swarm).then_some((field, typed))?
        }
        _ => return None,
    };
    let values = values_of(field.trim_start_matches("--"), typed);
    (!values.is_empty()).then_some(values)
}

/// Completes the parameters that `set` changes up to their `=`, then the values of the enumerated
/// ones.
pub fn assignments(typed: &OsStr) -> Vec<CompletionCandidate> {
    let Some(typed) = typed.to_str() else {
        return Vec::new();
    };
    if let Some((field, value)) = typed.split_once('=') {
        let values = values_of(field, value).into_iter();
        return values
            .map(|value| value.add_prefix(format!("{field}=")))
            .collect();
    }
    let fields = ASSIGNED.iter();
    fields
        .map(|(name, doc)| (format!("{name}="), doc))
        .filter(|(assignment, _)| assignment.starts_with(typed))
        .map(|(assignment, doc)| {
            CompletionCandidate::new(assignment).help(Some(StyledStr::from(doc.clone())))
        })
        .collect()
}

/// Those names that begin with the typed text.
pub fn beginning_with(
    typed: &OsStr,
    names: impl IntoIterator<Item = impl AsRef<str>>,
) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    let names = names.into_iter();
    names
        .filter(|name| name.as_ref().starts_with(&*typed))
        .map(|name| CompletionCandidate::new(name.as_ref()))
        .collect()
}

/// Completes names that the daemon knows. If there is no daemon, returns none and no error.
fn names(
    typed: &OsStr,
    query: impl AsyncFnOnce(&Client) -> Result<Vec<String>, Error>,
) -> Vec<CompletionCandidate> {
    let words: Vec<String> = std::env::args().collect();
    let given = |names: &[&str], variable: &str| {
        option(&words, names).or_else(|| std::env::var(variable).ok())
    };
    let options = ConnectOptions {
        credentials: given(&["--credentials"], "JOSTLE_CREDENTIALS").map(Into::into),
        endpoint: given(&["-e", "--endpoint"], "JOSTLE_ENDPOINT"),
        prefix: option(&words, &["--prefix"]).unwrap_or_else(|| DEFAULT_PREFIX.into()),
        timeout: COMPLETION_TIMEOUT,
        wait: Duration::ZERO,
        ..ConnectOptions::default()
    };
    let Ok(runtime) = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
    else {
        return Vec::new();
    };
    let names = runtime.block_on(async {
        let names = async {
            let client = Client::connect(options).await?;
            let names = query(&client).await;
            client.close().await;
            names
        };
        tokio::time::timeout(COMPLETION_TIMEOUT, names).await
    });
    // A thread may still wait for a reply.
    runtime.shutdown_background();
    match names {
        Ok(Ok(names)) => beginning_with(typed, names),
        _ => Vec::new(),
    }
}

/// The value of an option on the line to complete.
fn option(words: &[String], names: &[&str]) -> Option<String> {
    words.iter().enumerate().find_map(|(index, word)| {
        if names.contains(&word.as_str()) {
            let value = words.get(index + 1)?;
            // bash splits an address into the host, the colon and the port.
            return match words.get(index + 2..index + 4) {
                Some([colon, port]) if colon == ":" => Some(format!("{value}:{port}")),
                _ => Some(value.clone()),
            };
        }
        names
            .iter()
            .filter(|name| name.starts_with("--"))
            .find_map(|name| word.strip_prefix(name)?.strip_prefix('='))
            .map(str::to_owned)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn completed(candidates: &[CompletionCandidate]) -> Vec<String> {
        candidates
            .iter()
            .map(|candidate| candidate.get_value().to_string_lossy().into_owned())
            .collect()
    }

    #[test]
    fn parameters_are_completed_up_to_their_value() {
        let of = |typed: &str| completed(&assignments(OsStr::new(typed)));
        assert_eq!(of("pi"), ["pi1=", "pi2=", "pi3=", "pi4="]);
        assert_eq!(of("pu"), ["publish_every="]);
        assert_eq!(of("m"), ["max_idle_secs=", "measures="]);
        assert_eq!(of("d"), [""; 0], "`set` does not change dt");
        assert_eq!(of("pi1=6"), [""; 0]);
        let contacts = ["contacts=endpoints", "contacts=closest", "contacts=clamped"];
        assert_eq!(of("contacts="), contacts);
        assert_eq!(of("contacts=e"), ["contacts=endpoints"]);
        assert_eq!(of("stepping=v"), ["stepping=velocity"]);
        assert_eq!(of("attraction=m"), ["attraction=metric="]);
        assert_eq!(of("colour="), [""; 0]);
    }

    #[test]
    fn values_are_completed_after_an_equals_sign_split_by_bash() {
        let of = |line: &str| {
            let words = format!("jostle -- jostle {line}");
            let words: Vec<String> = words.split(' ').map(str::to_owned).collect();
            let at = (words.len() - 3).to_string();
            values_behind_equals(&words, &at).map(|values| completed(&values))
        };
        let contacts = ["endpoints", "closest", "clamped"].map(str::to_owned);
        assert_eq!(of("set demo contacts "), Some(contacts.to_vec()));
        assert_eq!(
            of("set demo pi1 = 6 contacts = e"),
            Some(vec!["endpoints".into()])
        );
        assert_eq!(
            of("create demo --contacts = e"),
            Some(vec!["endpoints".into()])
        );
        assert_eq!(of("create demo --contacts "), Some(contacts.to_vec()));
        for other in [
            "set demo pi1 = 6 conta",
            "set demo pi1 = 6",
            "set contacts ",
            "status contacts ",
            "set demo ",
            "",
        ] {
            assert_eq!(of(other), None, "{other:?}");
        }
    }

    #[test]
    fn choices_are_completed() {
        let all = OsStr::new("");
        assert_eq!(
            completed(&contact_rules(all)),
            ["endpoints", "closest", "clamped"]
        );
        assert_eq!(completed(&steppings(all)), ["position", "velocity"]);
        let laws = completed(&laws(all));
        assert_eq!(
            laws,
            ["all", "voronoi", "metric=", "topological=", "power="]
        );
        let of_contract = contract::parameters().into_iter();
        let kinds: Vec<_> = of_contract
            .filter(|it| it.name == "attraction")
            .flat_map(|it| it.choices)
            .map(|it| it["kind"].clone())
            .collect();
        assert_eq!(
            kinds,
            LAWS.map(|(law, _)| law),
            "they are those of the contract"
        );
    }

    #[test]
    fn fields_and_words_of_a_selection_are_completed() {
        let completed = |typed: &str| completed(&selections(OsStr::new(typed)));
        assert_eq!(completed("").len(), FIELDS.len());
        for (typed, expected) in [
            ("ph", &["phase"][..]),
            ("n >= 200 and ph", &["n >= 200 and phase"]),
            ("(n > 3 or st", &["(n > 3 or step"]),
            ("(o", &["(order"]),
            ("phase = r", &["phase = running"]),
            (
                "n > 1 and phase != ",
                &[
                    "n > 1 and phase != paused",
                    "n > 1 and phase != running",
                    "n > 1 and phase != faulted",
                ],
            ),
            ("n ", &[]),
            ("n = ", &[]),
            ("phase = running ", &[]),
        ] {
            assert_eq!(completed(typed), expected, "{typed}");
        }
        // Each is accepted where a comparison is complete.
        for typed in ["phase = ", "n > 1 or phase != "] {
            for text in completed(typed) {
                assert!(values::selection(&text).is_ok(), "{text}");
            }
        }
    }

    #[test]
    fn messages_are_completed() {
        assert_eq!(
            completed(&messages(OsStr::new("batch"))),
            ["batch", "batch.args", "batch.reply"]
        );
    }

    #[test]
    fn options_on_the_line_select_the_daemon_to_query() {
        let words: Vec<String> = [
            "jostle",
            "--",
            "jostle",
            "-e",
            "tcp/h:1",
            "--prefix=p",
            "status",
        ]
        .map(str::to_owned)
        .into();
        assert_eq!(
            option(&words, &["-e", "--endpoint"]).as_deref(),
            Some("tcp/h:1")
        );
        assert_eq!(option(&words, &["--prefix"]).as_deref(), Some("p"));
        assert_eq!(option(&words, &["--node"]), None);
        let split = ["-e", "tcp/h", ":", "1", "status"].map(str::to_owned);
        assert_eq!(option(&split, &["-e"]).as_deref(), Some("tcp/h:1"));
    }

    #[test]
    fn every_shell_has_a_line() {
        for shell in SHELLS {
            let (line, file) = line(shell);
            assert!(line.contains(shell) && line.contains(VARIABLE), "{line}");
            assert!(!file.is_empty());
        }
    }
}
