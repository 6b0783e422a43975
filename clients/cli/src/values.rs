//! Parsers of option values: numbers, rates, points, assignments.
//!
//! They reject only what cannot be sent; the daemon checks ranges.

use std::num::NonZero;
use std::ops::RangeInclusive;
use std::str::FromStr;

use glob::Pattern;
use jostle_conditions::{Field, Selection};
use jostle_figures::Kind;
use jostle_proto::keys::{NAME_RULE, is_name};
use jostle_proto::verbs::{MAX_NOTE_CHARS, Pose, Region};
use jostle_proto::{LARGEST_WHOLE, MAX_LABEL_LENGTH};
use serde_json::{Value, json};

use crate::format;

/// The largest range of ids: more than any swarm has individuals.
const MAX_IDS: u32 = 1_000_000;

/// The most individuals of a swarm, for messages.
pub const MAX_INDIVIDUALS: u64 = MAX_IDS as u64;

/// The most steps of a command, for messages.
pub const MAX_STEPS: u64 = 1_000_000_000;

/// Time units per second of wall clock; `None` is as fast as possible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate(pub Option<f64>);

/// `name=value`, an argument of `set`.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// The field on the wire.
    pub field: String,
    /// A number if it parses as one, otherwise the text.
    pub value: Value,
}

/// A law of attraction in the form of a spec.
#[derive(Clone, Debug, PartialEq)]
pub struct Law(pub Value);

/// The laws of attraction, each with the name of its number.
pub const LAWS: [(&str, Option<&str>); 5] = [
    ("all", Some("accuracy")),
    ("voronoi", None),
    ("metric", Some("radius")),
    ("topological", Some("neighbours")),
    ("power", Some("exponent")),
];

/// A name, or a pattern of names.
#[derive(Clone, Debug, PartialEq)]
pub enum Names {
    One(String),
    /// All swarms that match.
    Matching(Pattern),
}

/// The kinds of figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Figure {
    /// A figure of the paper.
    Of(Kind),
    /// The current state of swarms.
    Snapshot,
}

/// Parses the kind of a figure.
pub fn figure(text: &str) -> Result<Figure, String> {
    if text == "snapshot" {
        return Ok(Figure::Snapshot);
    }
    let number = text.parse().ok();
    number
        .and_then(Kind::from_number)
        .map(Figure::Of)
        .ok_or_else(|| format!("`{text}` is none of {}", figures().join(", ")))
}

pub fn figures() -> Vec<String> {
    let numbers = Kind::ALL.into_iter().map(|kind| kind.number().to_string());
    numbers.chain(["snapshot".to_owned()]).collect()
}

/// Parses the name of a swarm or a node. It becomes part of a key, in which a wildcard would address
/// every swarm.
pub fn name(text: &str) -> Result<String, String> {
    if is_name(text) {
        Ok(text.into())
    } else {
        Err(format!("a name matches {NAME_RULE}"))
    }
}

/// What `--where` compares.
pub const FIELDS: [Field; 8] = [
    ("n", &[]),
    ("informed", &[]),
    ("order", &[]),
    ("step", &[]),
    ("time", &[]),
    ("rate", &[]),
    ("actual", &[]),
    ("phase", &["paused", "running", "faulted"]),
];

/// A selection of swarms.
pub fn selection(text: &str) -> Result<Selection, String> {
    Selection::parse(text, &FIELDS).map_err(|error| error.to_string())
}

/// Parses the name of a swarm, or a pattern of names such as `test-*`.
pub fn names(text: &str) -> Result<Names, String> {
    if !text.contains(['*', '?', '[']) {
        return name(text).map(Names::One);
    }
    let is_of_names =
        |it: char| it.is_ascii_lowercase() || it.is_ascii_digit() || "-_*?[]!".contains(it);
    if !text.chars().all(is_of_names) {
        return Err(format!("no name matches it: a name matches {NAME_RULE}"));
    }
    Pattern::new(text)
        .map(Names::Matching)
        .map_err(|error| format!("not a pattern: {}", error.msg))
}

/// Parses a number. JSON has no infinity and no NaN.
pub fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("`{text}` is not a finite number")),
    }
}

/// The end of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The first step at or after this time.
    Time(f64),
    /// The first step after which this condition holds. The daemon parses it.
    Condition(String),
}

/// Parses a time, or a text with a comparison.
pub fn end(text: &str) -> Result<End, String> {
    match text.contains(['<', '>']) {
        true => Ok(End::Condition(text.to_owned())),
        false => number(text).map(End::Time).map_err(|_| {
            format!("`{text}` is neither a finite number nor a condition such as 'order > 0.9'")
        }),
    }
}

/// Parses a share above 0 and at most 1.
pub fn percentage(text: &str) -> Result<f64, String> {
    match share(text)? {
        share if share > 0.0 && share <= 1.0 => Ok(share),
        _ => Err(format!("`{text}` is not above 0 and at most 100%")),
    }
}

/// Parses a share: `0.1`, or in percent `10%`.
pub fn share(text: &str) -> Result<f64, String> {
    let share = match text.strip_suffix('%') {
        Some(percent) => number(percent).map(|percent| percent / 100.0),
        None => number(text),
    };
    share.map_err(|_| format!("`{text}` is not a share: give one such as 0.1 or 10%"))
}

/// Parses an id or an inclusive range of ids: `7` or `1-5`.
pub fn ids(text: &str) -> Result<RangeInclusive<u32>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let is_number = |it: &str| !it.is_empty() && it.bytes().all(|it| it.is_ascii_digit());
    let (Ok(first), Ok(last)) = (first.parse::<u32>(), last.parse::<u32>()) else {
        return Err(match is_number(first) && is_number(last) {
            true => format!("`{text}` is beyond the largest id, {}", u32::MAX),
            false => format!("`{text}` is neither an id nor a range: give one such as 7 or 1-5"),
        });
    };
    if first > last {
        return Err(format!("`{text}` is backwards: give {last}-{first}"));
    }
    if last - first >= MAX_IDS {
        return Err(format!(
            "`{text}` has more than {MAX_IDS} ids: give a shorter range"
        ));
    }
    Ok(first..=last)
}

/// Parses a positive number of seconds, such as `20` or `20s`.
pub fn seconds(text: &str) -> Result<f64, String> {
    match number(text.strip_suffix('s').unwrap_or(text)) {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err(format!(
            "`{text}` is not a number of seconds above 0 and at most 1e9"
        )),
    }
}

/// Parses a number of bytes, such as `500MB`, `2GiB` or `4096`.
pub fn size(text: &str) -> Result<u64, String> {
    const UNITS: [(&str, u64); 7] = [
        ("KiB", 1 << 10),
        ("MiB", 1 << 20),
        ("GiB", 1 << 30),
        ("kB", 1000),
        ("MB", 1_000_000),
        ("GB", 1_000_000_000),
        ("B", 1),
    ];
    let of = |(unit, bytes): &(&str, u64)| Some((text.strip_suffix(*unit)?, *bytes));
    let (number, unit) = UNITS.iter().find_map(of).unwrap_or((text, 1));
    let bytes = self::number(number)? * unit as f64;
    if !(1.0..=LARGEST_WHOLE as f64).contains(&bytes) {
        return Err(format!("`{text}` is not a size such as 500MB or 2GiB"));
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "it is in range"
    )]
    let bytes = bytes as u64;
    Ok(bytes)
}

/// Parses a whole number; the range is for the message, since the daemon checks ranges.
fn parsed<T: FromStr>(text: &str, least: u64, most: u64) -> Result<T, String> {
    between(text, [least as f64, most as f64])
}

fn between<T: FromStr>(text: &str, range: [f64; 2]) -> Result<T, String> {
    let [least, most] = range.map(format::number);
    text.parse()
        .map_err(|_| format!("give a whole number from {least} to {most}"))
}

/// Parses a whole number that the daemon accepts from `LEAST` to `MOST`.
pub fn whole_in<const LEAST: u64, const MOST: u64>(text: &str) -> Result<u64, String> {
    parsed(text, LEAST, MOST)
}

/// Parses a whole number that the daemon accepts in this range.
pub fn whole_between(text: &str, range: [f64; 2]) -> Result<u64, String> {
    between(text, range)
}

/// Parses a whole number.
pub fn whole(text: &str) -> Result<u64, String> {
    parsed(text, 0, LARGEST_WHOLE)
}

/// Parses a whole number above 0.
pub fn positive(text: &str) -> Result<u64, String> {
    parsed(text, 1, LARGEST_WHOLE).map(NonZero::<u64>::get)
}

/// Parses a count, at least one.
pub fn count(text: &str) -> Result<usize, String> {
    nonzero(text).map(NonZero::get)
}

/// Parses a count, at least one.
pub fn nonzero(text: &str) -> Result<NonZero<usize>, String> {
    parsed(text, 1, LARGEST_WHOLE)
}

/// Parses a request id or the name of a sender.
pub fn label(text: &str) -> Result<String, String> {
    match text {
        "" => Err("it is empty".into()),
        _ if text.len() > MAX_LABEL_LENGTH => {
            Err(format!("it is longer than {MAX_LABEL_LENGTH} bytes"))
        }
        _ if text.chars().any(char::is_control) => Err("it has control characters".into()),
        _ => Ok(text.into()),
    }
}

/// Parses the value of a parameter of a query, in which `;` separates the parameters.
pub fn parameter(text: &str) -> Result<String, String> {
    match text.contains(';') {
        true => Err("`;` cannot be sent: leave the option out, and search the output".into()),
        false => label(text),
    }
}

pub fn note(text: &str) -> Result<String, String> {
    match text {
        "" => Err("it is empty".into()),
        _ if text.chars().count() > MAX_NOTE_CHARS => {
            Err(format!("it is longer than {MAX_NOTE_CHARS} characters"))
        }
        _ if text.chars().any(char::is_control) => {
            Err("it has control characters: write one line".into())
        }
        _ => Ok(text.into()),
    }
}

/// Parses a rate: a number, or `max`.
pub fn rate(text: &str) -> Result<Rate, String> {
    if text == "max" {
        return Ok(Rate(None));
    }
    number(text)
        .map(|rate| Rate(Some(rate)))
        .map_err(|_| format!("`{text}` is neither a number nor `max`"))
}

/// Parses a law of attraction: `voronoi`, or with a number `metric=3`.
pub fn law(text: &str) -> Result<Law, String> {
    let (kind, number) = match text.split_once('=') {
        Some((kind, number)) => (kind, Some(number)),
        None => (text, None),
    };
    let (_, field) = LAWS.iter().find(|(law, _)| *law == kind).ok_or_else(|| {
        format!(
            "`{kind}` is none of {}",
            LAWS.map(|(law, _)| law).join(", ")
        )
    })?;
    let mut law = json!({ "kind": kind });
    match (field, number) {
        (Some(field), Some(text)) => law[field] = assignment(&format!("{field}={text}"))?.value,
        (None, Some(_)) => return Err(format!("{kind} takes no number: leave it out")),
        // Only for `all` the number is optional; the daemon checks that.
        (_, None) => {}
    }
    Ok(Law(law))
}

/// Parses `X,Y,RADIUS`.
pub fn region(text: &str) -> Result<Region, String> {
    let [x, y, radius] = triple(text, "X,Y,RADIUS")?;
    Ok(Region { x, y, radius })
}

/// Parses `X,Y,ALPHA`.
pub fn pose(text: &str) -> Result<Pose, String> {
    let [x, y, alpha] = triple(text, "X,Y,ALPHA")?;
    Ok(Pose { x, y, alpha })
}

/// Parses `name=value`.
pub fn assignment(text: &str) -> Result<Assignment, String> {
    let (field, value) = text
        .split_once('=')
        .filter(|(field, _)| !field.is_empty())
        .ok_or_else(|| format!("`{text}` is not NAME=VALUE, such as pi1=6"))?;
    if field == "attraction" {
        let field = field.to_owned();
        return law(value).map(|Law(value)| Assignment { field, value });
    }
    if field == "measures" {
        return Ok(Assignment {
            field: field.to_owned(),
            value: measures(value).into(),
        });
    }
    if (field, value) == ("max_idle_secs", "none") {
        return Ok(Assignment {
            field: field.to_owned(),
            value: 0.into(),
        });
    }
    // An integer stays one: counts are rejected as 5.0.
    let value = serde_json::from_str::<serde_json::Number>(value)
        .map(Value::Number)
        .or_else(|_| number(value).map(Value::from))
        .unwrap_or_else(|_| Value::from(value));
    Ok(Assignment {
        field: field.replace('-', "_"),
        value,
    })
}

/// The names of measures, separated by commas; none of an empty text.
pub fn measures(text: &str) -> Vec<String> {
    let names = text.split(',').map(str::trim).filter(|_| !text.is_empty());
    names.map(str::to_owned).collect()
}

fn triple(text: &str, shape: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(number)
        .collect::<Result<_, _>>()
        .map_err(|problem| format!("{problem}; expected {shape}"))?;
    <[f64; 3]>::try_from(numbers).map_err(|numbers| {
        format!(
            "expected three numbers {shape} without spaces, not {}",
            numbers.len()
        )
    })
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_rate_is_a_number_or_max() {
        assert_eq!(rate("2.5"), Ok(Rate(Some(2.5))));
        assert_eq!(rate("max"), Ok(Rate(None)));
        assert_eq!(rate("-1"), Ok(Rate(Some(-1.0))), "the daemon refuses it");
        for text in ["", "fast", "inf", "nan", "1 "] {
            assert_eq!(rate(text).is_err(), text != "1 ", "{text:?}");
        }
    }

    #[test]
    fn a_law_of_attraction_may_have_a_number() {
        let of = |text: &str| law(text).unwrap().0;
        assert_eq!(of("voronoi"), json!({"kind": "voronoi"}));
        assert_eq!(of("all"), json!({"kind": "all"}));
        assert_eq!(of("metric=2.5"), json!({"kind": "metric", "radius": 2.5}));
        assert_eq!(
            of("topological=7"),
            json!({"kind": "topological", "neighbours": 7})
        );
        assert_eq!(of("power=-1"), json!({"kind": "power", "exponent": -1}));
        assert_eq!(
            of("metric"),
            json!({"kind": "metric"}),
            "the daemon refuses it"
        );
        for text in ["", "none", "voronoi=1", "=1"] {
            assert!(law(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn names_that_would_address_every_swarm_are_rejected() {
        for text in ["*", "**", "a/b", "@node", "A", ""] {
            assert!(name(text).is_err(), "{text:?}");
        }
        assert_eq!(name("demo").as_deref(), Ok("demo"));
    }

    #[test]
    fn a_pattern_of_names_matches_whole_names() {
        let matches = |pattern: &str, name: &str| match names(pattern).unwrap() {
            Names::One(one) => one == name,
            Names::Matching(pattern) => pattern.matches(name),
        };
        assert!(matches("test-*", "test-1") && matches("test-*", "test-"));
        assert!(!matches("test-*", "latest-1") && !matches("test-*", "test"));
        assert!(matches("test-?", "test-1") && !matches("test-?", "test-12"));
        assert!(matches("run-[12]", "run-2") && !matches("run-[!12]", "run-2"));
        assert!(matches("demo", "demo") && !matches("demo", "demo-2"));
        for text in ["a/*", "@*", "A*", "***", "[a", "", "$*", "a b*"] {
            assert!(names(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn numbers_without_a_json_form_are_rejected() {
        for text in ["nan", "inf", "-inf", "1e999", "", "1,2"] {
            assert!(number(text).is_err(), "{text:?}");
        }
        assert_eq!(number("-1.5e-3"), Ok(-0.0015));
        assert_eq!(number("0.1").unwrap().to_bits(), 0.1_f64.to_bits());
    }

    #[test]
    fn seconds_are_positive_and_fit_a_duration() {
        assert_eq!(seconds("0.5"), Ok(0.5));
        assert_eq!(seconds("20s"), Ok(20.0));
        for text in ["0", "-1", "1e300", "soon", "s", "2ss"] {
            assert!(seconds(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn counts_and_labels_are_what_the_wire_takes() {
        assert_eq!(whole("0"), Ok(0));
        let range = Err("give a whole number from 0 to 2^53-1".to_owned());
        assert_eq!([whole("-1"), whole("1.5")], [range.clone(), range]);
        let range = Err("give a whole number from 1 to 1e9".to_owned());
        assert_eq!(whole_in::<1, MAX_STEPS>("ten"), range);
        let range = Err("give a whole number from 1 to 2^53-1".to_owned());
        assert_eq!([positive("0"), positive("many")], [range.clone(), range]);
        assert_eq!(count("1"), Ok(1));
        assert!(count("0").is_err() && count("many").is_err());
        assert_eq!(label("ada@desk").as_deref(), Ok("ada@desk"));
        for text in ["", "a\nb", &"a".repeat(257)] {
            assert!(label(text).is_err(), "{text:?}");
        }
        assert_eq!(parameter("ada@desk").as_deref(), Ok("ada@desk"));
        for text in ["", "a\nb", "a;limit=1"] {
            assert!(parameter(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn points_may_be_negative_and_must_have_three_numbers() {
        let Pose { x, y, alpha } = pose("-3,2.5,-1e-2").unwrap();
        assert_eq!([x, y, alpha], [-3.0, 2.5, -0.01]);
        for text in ["1,2", "1,2,3,4", "1,2,x", "", "1,,2"] {
            assert!(region(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn an_assignment_keeps_integers_and_leaves_words_to_the_daemon() {
        let value = |text: &str| assignment(text).unwrap().value;
        assert_eq!(value("publish_every=5"), Value::from(5));
        assert_eq!(value("pi1=.5"), Value::from(0.5));
        assert_eq!(value("pi2=-2"), Value::from(-2));
        assert_eq!(value("max_idle_secs=none"), Value::from(0));
        assert_eq!(value("pi1=six"), Value::from("six"));
        assert_eq!(value("pi1=nan"), Value::from("nan"));
        assert_eq!(
            assignment("publish-every=5").unwrap().field,
            "publish_every"
        );
        let names = serde_json::json!(["drift", "clusters.count(0.1)"]);
        assert_eq!(value("measures=drift, clusters.count(0.1)"), names);
        assert_eq!(value("measures="), serde_json::json!([]));
        for text in ["pi1", "=3", ""] {
            assert!(assignment(text).is_err(), "{text:?}");
        }
    }
}
