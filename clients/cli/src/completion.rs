//! What a shell completes: verbs and options by clap, names of swarms and daemons by asking.

use std::ffi::OsStr;
use std::time::Duration;

use clap::builder::StyledStr;
use clap_complete::CompleteEnv;
use clap_complete::engine::CompletionCandidate;
use jostle_proto::contract;
use jostle_proto::keys::DEFAULT_PREFIX;

use crate::arguments::{self, GlobalArguments};
use crate::bus::Bus;
use crate::output;
use crate::values::{self, LAWS};

/// The variable by which a shell asks.
const VARIABLE: &str = "JOSTLE_COMPLETE";
/// How long a shell may be kept waiting.
const PATIENCE: Duration = Duration::from_millis(300);

/// The shells that can be completed in.
pub const SHELLS: [&str; 5] = ["bash", "zsh", "fish", "elvish", "powershell"];

/// Answers a shell that asks for completions, and ends; does nothing otherwise.
pub fn complete_if_asked() {
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
        // A write fails if the shell has closed the pipe: not an error.
        let _ = output::write(&values.join(&separator));
        std::process::exit(0);
    }
    CompleteEnv::with_factory(arguments::command)
        .var(VARIABLE)
        .complete();
}

/// The line that makes a shell complete, and the file where it belongs.
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

/// The swarms that are there.
pub fn swarms(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(
        typed,
        ask(async |bus| bus.swarms().await.unwrap_or_default()),
    )
}

/// The daemons that are there.
pub fn nodes(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(
        typed,
        ask(async |bus| bus.nodes().await.unwrap_or_default()),
    )
}

/// The experiments that are there.
pub fn experiments(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(
        typed,
        ask(async |bus| bus.experiments().await.unwrap_or_default()),
    )
}

/// The recordings of the daemon.
pub fn recordings(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(
        typed,
        ask(async |bus| bus.recordings().await.unwrap_or_default()),
    )
}

/// The figures that can be drawn.
pub fn figures(typed: &OsStr) -> Vec<CompletionCandidate> {
    beginning_with(typed, values::figures())
}

/// The messages on the wire.
pub fn messages(typed: &OsStr) -> Vec<CompletionCandidate> {
    let messages = contract::schemas().into_keys();
    beginning_with(typed, messages.map(str::to_owned).collect())
}

/// The rules by which contacts are chosen.
pub fn contact_rules(typed: &OsStr) -> Vec<CompletionCandidate> {
    choices(typed, "contacts")
}

/// What contacts may limit.
pub fn steppings(typed: &OsStr) -> Vec<CompletionCandidate> {
    choices(typed, "stepping")
}

/// The laws of attraction, each that takes a number up to its `=`.
pub fn laws(typed: &OsStr) -> Vec<CompletionCandidate> {
    let laws = LAWS.map(|(law, number)| match number {
        Some(_) if law != "all" => format!("{law}="),
        _ => law.to_owned(),
    });
    beginning_with(typed, laws.into())
}

/// The values of an enumerated parameter; empty for any other parameter.
fn values_of(field: &str, typed: &str) -> Vec<CompletionCandidate> {
    match field {
        "attraction" => laws(OsStr::new(typed)),
        field => choices(OsStr::new(typed), field),
    }
}

/// The words that a parameter that is a choice may have.
fn choices(typed: &OsStr, name: &str) -> Vec<CompletionCandidate> {
    let parameters = contract::parameters().into_iter();
    let choices = parameters
        .filter(|it| it.name == name)
        .flat_map(|it| it.choices);
    let words = choices.filter_map(|choice| choice.as_str().map(str::to_owned));
    beginning_with(typed, words.collect())
}

/// Completes the value in `contacts=end` or `--contacts=end` for bash, which splits the word and
/// passes `contacts`, `=` and `end`.
fn values_behind_equals(words: &[String], at: &str) -> Option<Vec<CompletionCandidate>> {
    let typed = words.iter().position(|word| word == "--")? + 1;
    let words = words.get(typed..=typed + at.parse::<usize>().ok()?)?;
    let (field, typed) = match words {
        [.., field, equals, typed] if equals == "=" => (field, typed),
        // Directly behind the `=` it hands over an empty word instead.
        [before @ .., field, typed] if typed.is_empty() => {
            let is_set = before.iter().any(|word| word == "set");
            // Directly behind the verb stands a swarm.
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
    contract::parameters()
        .into_iter()
        .filter(|parameter| parameter.changed_by.iter().any(|verb| verb == "set"))
        .map(|parameter| (format!("{}=", parameter.name), parameter.doc))
        .filter(|(assignment, _)| assignment.starts_with(typed))
        .map(|(assignment, doc)| {
            CompletionCandidate::new(assignment).help(Some(StyledStr::from(doc)))
        })
        .collect()
}

fn beginning_with(typed: &OsStr, names: Vec<String>) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    names
        .into_iter()
        .filter(|name| name.starts_with(&*typed))
        .map(CompletionCandidate::new)
        .collect()
}

/// Asks the daemon; nobody there is no reason to disturb whoever is typing.
fn ask(question: impl AsyncFnOnce(&Bus) -> Vec<String>) -> Vec<String> {
    let words: Vec<String> = std::env::args().collect();
    let global = GlobalArguments {
        credentials: option(&words, &["--credentials"])
            .or_else(|| std::env::var("JOSTLE_CREDENTIALS").ok())
            .map(Into::into),
        endpoint: option(&words, &["-e", "--endpoint"])
            .or_else(|| std::env::var("JOSTLE_ENDPOINT").ok()),
        node: None,
        prefix: option(&words, &["--prefix"]).unwrap_or_else(|| DEFAULT_PREFIX.into()),
        timeout: PATIENCE.as_secs_f64(),
        json: false,
    };
    let Ok(runtime) = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
    else {
        return Vec::new();
    };
    let names = runtime.block_on(async {
        let asked = async {
            let bus = Bus::open(global).await.ok()?;
            let names = question(&bus).await;
            bus.close().await;
            Some(names)
        };
        tokio::time::timeout(PATIENCE, asked).await.ok().flatten()
    });
    // A thread may still wait for an answer that never comes.
    runtime.shutdown_background();
    names.unwrap_or_default()
}

/// The value of an option on the line that is being typed.
fn option(words: &[String], names: &[&str]) -> Option<String> {
    words.iter().enumerate().find_map(|(index, word)| {
        if names.contains(&word.as_str()) {
            let value = words.get(index + 1)?;
            // bash takes host and port of an address for two words, and the colon for a third.
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
    fn what_bash_has_split_at_its_equals_sign_is_completed_from_there_on() {
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
    fn messages_are_completed() {
        assert_eq!(
            completed(&messages(OsStr::new("batch"))),
            ["batch.args", "batch.reply"]
        );
    }

    #[test]
    fn the_line_that_is_typed_says_where_to_ask() {
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
