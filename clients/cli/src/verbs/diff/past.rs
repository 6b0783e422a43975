//! What two swarms were told: the first commands that differ.

use serde::Serialize;
use serde_json::Value;

use crate::verbs::look::Whole;

/// Verbs that change how far a swarm is, and not where its way leads.
const MOVING: [&str; 3] = ["run", "pause", "step"];

/// A command that a swarm was told.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Told {
    /// Counts the swarm's applied commands.
    pub seq: u64,
    /// The step it was applied at.
    pub step: u64,
    /// Its verb.
    pub verb: String,
    /// Its arguments as they came.
    pub args: Value,
}

/// The first commands that differ; `null` where there is none left.
#[derive(Debug, PartialEq, Serialize)]
pub struct Parting {
    /// What the first swarm was told.
    pub one: Option<Told>,
    /// What the second swarm was told.
    pub other: Option<Told>,
}

/// What is known of what a swarm was told.
pub struct Past {
    /// Its commands up to this `seq` are not known.
    lost: u64,
    told: Vec<Told>,
}

impl Past {
    /// The past that a journal tells of.
    pub fn of(journal: Whole) -> Self {
        let told = journal.entries.into_iter().map(|entry| Told {
            seq: entry.seq,
            step: entry.step,
            verb: entry.verb,
            args: entry.args,
        });
        Past {
            lost: journal.lost,
            told: told.collect(),
        }
    }

    /// The commands after a `seq` that change the state, each with the number that keys its random
    /// draws: its `seq` without the annotations after that `seq`.
    fn after(&self, seq: u64) -> impl Iterator<Item = (u64, &Told)> {
        let mut annotations = 0;
        let told = self.told.iter().filter(move |told| told.seq > seq);
        told.filter_map(move |told| {
            if told.verb == "annotate" {
                annotations += 1;
                return None;
            }
            let is_moving = MOVING.contains(&told.verb.as_str());
            (!is_moving).then_some((told.seq - annotations, told))
        })
    }
}

/// From where on the pasts can be compared, and the first commands that differ.
pub fn parting(one: &Past, other: &Past) -> (u64, Option<Parting>) {
    let after = one.lost.max(other.lost);
    let (mut ones, mut others) = (one.after(after), other.after(after));
    loop {
        let (one, other) = (ones.next(), others.next());
        match (one, other) {
            (None, None) => return (after, None),
            (Some(one), Some(other)) if is_same(one, other) => {}
            (one, other) => {
                let parting = Parting {
                    one: one.map(|(_, told)| told.clone()),
                    other: other.map(|(_, told)| told.clone()),
                };
                return (after, Some(parting));
            }
        }
    }
}

/// Whether both have one effect on swarms that are the same.
fn is_same((key, one): (u64, &Told), (other_key, other): (u64, &Told)) -> bool {
    let is_one_draw = key == other_key || !(draws(&one.args) || draws(&other.args));
    (one.step, &one.verb, &one.args) == (other.step, &other.verb, &other.args) && is_one_draw
}

/// Whether anything is drawn by chance, which depends on `seq` too.
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

    fn past(lost: u64, told: &[(u64, u64, &str, Value)]) -> Past {
        let told = told.iter().cloned().map(|(seq, step, verb, args)| Told {
            seq,
            step,
            verb: verb.into(),
            args,
        });
        Past {
            lost,
            told: told.collect(),
        }
    }

    fn seqs(parting: Option<Parting>) -> (Option<u64>, Option<u64>) {
        let parting = parting.unwrap();
        let seq = |told: Option<Told>| told.map(|it| it.seq);
        (seq(parting.one), seq(parting.other))
    }

    #[test]
    fn a_fork_is_compared_from_where_it_was_made() {
        let steps = json!({"steps": 10});
        let inform = json!({"select": {"ids": [3]}, "direction": 0.0});
        let one = past(
            0,
            &[
                (1, 0, "set", json!({"pi3": 2.0})),
                (2, 0, "step", steps.clone()),
                (3, 10, "step", steps.clone()),
            ],
        );
        let other = past(2, &[(3, 10, "inform", inform), (4, 10, "step", steps)]);
        let (after, parting) = parting(&one, &other);
        assert_eq!(after, 2);
        assert_eq!(seqs(parting), (None, Some(3)), "a step is no difference");
    }

    #[test]
    fn the_same_commands_are_no_parting_unless_they_draw_under_another_seq() {
        let ids = json!({"select": {"ids": [3]}, "direction": 0.0});
        let count = json!({"select": {"count": 3}, "direction": 0.0});
        let foremost = json!({"select": {"foremost": {"count": 3, "along": 0.0}}, "direction": 0});
        for (args, parts) in [(ids, false), (count, true), (foremost, false)] {
            let one = past(
                0,
                &[(1, 0, "pause", json!({})), (2, 5, "inform", args.clone())],
            );
            let other = past(0, &[(1, 5, "inform", args.clone())]);
            assert_eq!(parting(&one, &other).1.is_some(), parts, "{args}");
        }
    }

    #[test]
    fn an_annotation_is_no_parting_and_changes_no_draw() {
        let count = json!({"select": {"count": 3}, "direction": 0.0});
        let note = json!({"text": "lights off"});
        let one = past(
            0,
            &[(1, 0, "annotate", note), (2, 5, "inform", count.clone())],
        );
        let other = past(0, &[(1, 5, "inform", count)]);
        assert_eq!(parting(&one, &other), (0, None));
    }

    #[test]
    fn one_command_at_other_steps_is_a_difference() {
        let set = json!({"pi3": 2.0});
        let one = past(0, &[(1, 5, "set", set.clone())]);
        let other = past(0, &[(1, 6, "set", set)]);
        assert_eq!(seqs(parting(&one, &other).1), (Some(1), Some(1)));
    }
}
