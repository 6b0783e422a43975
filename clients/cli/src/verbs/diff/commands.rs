//! The command histories of two swarms: the first commands that differ.

use jostle_proto::verbs::definition;
use serde::Serialize;
use serde_json::Value;

use crate::verbs::inspect::FullJournal;

/// Verbs that change when a swarm steps, and not its trajectory.
const STEPPING_VERBS: [&str; 4] = ["run", "pause", "step", "when"];

/// A command that a swarm has applied.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Command {
    /// Counts the swarm's applied commands.
    pub seq: u64,
    /// The step it was applied at.
    pub step: u64,
    pub verb: String,
    pub args: Value,
}

/// The first commands that differ; `null` where a history has ended.
#[derive(Debug, PartialEq, Serialize)]
pub struct Divergence {
    /// The command of the first swarm.
    pub one: Option<Command>,
    /// The command of the second swarm.
    pub other: Option<Command>,
}

/// The commands of a swarm that its journal still has.
pub struct History {
    /// The journal no longer has the commands up to this `seq`.
    lost: u64,
    commands: Vec<Command>,
}

impl History {
    /// Converts a journal.
    pub fn of(journal: FullJournal) -> Self {
        let commands = journal.entries.into_iter().map(|entry| Command {
            seq: entry.seq,
            step: entry.step,
            verb: entry.verb,
            args: entry.args,
        });
        History {
            lost: journal.lost,
            commands: commands.collect(),
        }
    }

    /// The commands after a `seq` that change the state, each with the number that keys its random
    /// draws: its `seq` without the annotations after that `seq`.
    fn after(&self, seq: u64) -> impl Iterator<Item = (u64, &Command)> {
        let mut annotations = 0;
        let commands = self.commands.iter().filter(move |it| it.seq > seq);
        commands.filter_map(move |command| {
            // A condition that only publishes an event counts as one.
            let is_condition = ["when", "fired"].contains(&command.verb.as_str());
            let is_event = is_condition && command.args.get("event").is_some();
            let is_annotation = definition(&command.verb).is_some_and(|it| it.is_annotation);
            if is_annotation || is_event {
                annotations += 1;
                return None;
            }
            let is_pause = command.verb == "fired" && command.args.get("commands").is_none();
            let is_stepping = is_pause || STEPPING_VERBS.contains(&command.verb.as_str());
            (!is_stepping).then_some((command.seq - annotations, command))
        })
    }
}

/// The `seq` after which both histories are known, and the first commands that differ after it.
pub fn diverge(one: &History, other: &History) -> (u64, Option<Divergence>) {
    let after = one.lost.max(other.lost);
    let (mut ones, mut others) = (one.after(after), other.after(after));
    loop {
        let (one, other) = (ones.next(), others.next());
        match (one, other) {
            (None, None) => return (after, None),
            (Some(one), Some(other)) if is_same(one, other) => {}
            (one, other) => {
                let divergence = Divergence {
                    one: one.map(|(_, command)| command.clone()),
                    other: other.map(|(_, command)| command.clone()),
                };
                return (after, Some(divergence));
            }
        }
    }
}

/// Whether both have the same effect on equal swarms.
fn is_same((key, one): (u64, &Command), (other_key, other): (u64, &Command)) -> bool {
    let is_one_draw = key == other_key || !(draws(&one.args) || draws(&other.args));
    (one.step, &one.verb, &one.args) == (other.step, &other.verb, &other.args) && is_one_draw
}

/// Whether the command draws individuals at random; the draw depends on `seq`.
fn draws(args: &Value) -> bool {
    match args {
        Value::Object(fields) => {
            fields.contains_key("count") && !fields.contains_key("along")
                || fields.contains_key("fraction")
                || fields.values().any(draws)
        }
        Value::Array(items) => items.iter().any(draws),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;

    fn history(lost: u64, commands: &[(u64, u64, &str, Value)]) -> History {
        let commands = commands.iter().cloned();
        let commands = commands.map(|(seq, step, verb, args)| Command {
            seq,
            step,
            verb: verb.into(),
            args,
        });
        History {
            lost,
            commands: commands.collect(),
        }
    }

    fn seqs(divergence: Option<Divergence>) -> (Option<u64>, Option<u64>) {
        let divergence = divergence.unwrap();
        let seq = |command: Option<Command>| command.map(|it| it.seq);
        (seq(divergence.one), seq(divergence.other))
    }

    #[test]
    fn conditions_with_events_change_no_draw() {
        let draw = json!({"select": {"count": 1}});
        let wait = json!({"condition": "order > 0", "event": "mine"});
        let one = history(0, &[(1, 4, "remove", draw.clone())]);
        let other = history(
            0,
            &[
                (1, 0, "when", wait.clone()),
                (2, 4, "fired", wait),
                (3, 4, "when", json!({"event": "other", "cancel": true})),
                (4, 4, "remove", draw),
            ],
        );
        assert!(diverge(&one, &other).1.is_none());
    }

    #[test]
    fn a_fork_is_compared_from_its_first_command_on() {
        let steps = json!({"steps": 10});
        let inform = json!({"select": {"ids": [3]}, "direction": 0.0});
        let one = history(
            0,
            &[
                (1, 0, "set", json!({"pi3": 2.0})),
                (2, 0, "step", steps.clone()),
                (3, 10, "step", steps.clone()),
            ],
        );
        let other = history(2, &[(3, 10, "inform", inform), (4, 10, "step", steps)]);
        let (after, divergence) = diverge(&one, &other);
        assert_eq!(after, 2);
        assert_eq!(seqs(divergence), (None, Some(3)), "a step is no difference");
    }

    #[test]
    fn equal_commands_do_not_diverge_unless_they_draw_with_another_seq() {
        let ids = json!({"select": {"ids": [3]}, "direction": 0.0});
        let count = json!({"select": {"count": 3}, "direction": 0.0});
        let foremost = json!({"select": {"foremost": {"count": 3, "along": 0.0}}, "direction": 0});
        for (args, diverges) in [(ids, false), (count, true), (foremost, false)] {
            let one = history(
                0,
                &[(1, 0, "pause", json!({})), (2, 5, "inform", args.clone())],
            );
            let other = history(0, &[(1, 5, "inform", args.clone())]);
            assert_eq!(diverge(&one, &other).1.is_some(), diverges, "{args}");
        }
    }

    #[test]
    fn an_annotation_does_not_diverge_and_changes_no_draw() {
        let count = json!({"select": {"count": 3}, "direction": 0.0});
        for (verb, args) in [
            ("annotate", json!({"text": "lights off"})),
            ("protect", json!({"on": true})),
        ] {
            let one = history(0, &[(1, 0, verb, args), (2, 5, "inform", count.clone())]);
            let other = history(0, &[(1, 5, "inform", count.clone())]);
            assert_eq!(diverge(&one, &other), (0, None), "{verb}");
        }
    }

    #[test]
    fn one_command_at_different_steps_diverges() {
        let set = json!({"pi3": 2.0});
        let one = history(0, &[(1, 5, "set", set.clone())]);
        let other = history(0, &[(1, 6, "set", set)]);
        assert_eq!(seqs(diverge(&one, &other).1), (Some(1), Some(1)));
    }
}
