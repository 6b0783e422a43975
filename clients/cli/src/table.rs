//! Tables for people; without borders, so that `awk` reads them too.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table};
use jostle_proto::verbs::SetResult;
use jostle_proto::{
    EarlierModel, HistoryFrom, Order, ParameterValues, Reply, Status, WaitingAction, WaitingClient,
    WaitingCondition, contract,
};
use serde_json::Value;

use crate::format;
use crate::stdout;

/// The strength of the common direction from which on the informed agree, as far as three decimals show.
const AGREED: f64 = 0.9995;

/// The name of a column, and its cell in a row.
pub type Column<T> = (&'static str, fn(&T) -> String);

/// A table with a line for each of `rows`.
pub fn of<T, const COLUMNS: usize>(rows: &[T], columns: [Column<T>; COLUMNS]) -> String {
    self::columns(&cells(rows, columns))
}

/// As [`of`]; on a terminal that is too narrow, cells take several lines, but those of the first column.
pub fn fitted<T, const COLUMNS: usize>(rows: &[T], columns: [Column<T>; COLUMNS]) -> String {
    let width = stdout::is_terminal().then(|| console::Term::stdout().size().1);
    layout(&cells(rows, columns), width)
}

fn cells<T, const COLUMNS: usize>(
    rows: &[T],
    columns: [Column<T>; COLUMNS],
) -> [(&'static str, Vec<String>); COLUMNS] {
    columns.map(|(name, cell)| (name, rows.iter().map(cell).collect()))
}

/// A table with this header.
pub fn table<const COLUMNS: usize>(
    header: [&str; COLUMNS],
    rows: Vec<[String; COLUMNS]>,
) -> String {
    let mut columns = header.map(|name| (name, Vec::with_capacity(rows.len())));
    for row in rows {
        for ((_, cells), cell) in columns.iter_mut().zip(row) {
            cells.push(cell);
        }
    }
    self::columns(&columns)
}

/// A table of columns of one length, each with its name.
pub fn columns(columns: &[(&str, Vec<String>)]) -> String {
    layout(columns, None)
}

fn layout(columns: &[(&str, Vec<String>)], width: Option<u16>) -> String {
    let mut table = Table::new();
    let header = columns.iter().map(|(name, _)| *name);
    table.load_style(NOTHING).set_header(header);
    let rows = columns.first().map_or(0, |(_, cells)| cells.len());
    table.add_rows((0..rows).map(|row| {
        let cells = columns.iter().map(move |(_, cells)| &cells[row]);
        cells.map(|cell| format::printable(cell))
    }));
    // Numbers are aligned to the right.
    let is_number =
        |text: &String| text == format::NONE || text == "max" || text.parse::<f64>().is_ok();
    for (column, (_, cells)) in table.column_iter_mut().zip(columns) {
        column.set_padding((0, 2));
        if cells.iter().all(is_number) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    if let Some(width) = width {
        table
            .set_content_arrangement(ContentArrangement::Dynamic)
            .set_width(width);
        if let Some(first) = table.column_mut(0) {
            first.set_constraint(ColumnConstraint::ContentWidth);
        }
    }
    table.trim_fmt()
}

/// A table with a line of documentation per row: in a column, or on a narrow terminal below the row.
pub fn documented(table: &str, docs: &[String]) -> String {
    let width = if stdout::is_terminal() {
        usize::from(console::Term::stdout().size().1)
    } else {
        usize::MAX
    };
    beside_or_below(table, docs, width)
}

fn beside_or_below(table: &str, docs: &[String], width: usize) -> String {
    let lines: Vec<&str> = table.lines().collect();
    let wide = |text: &str| console::measure_text_width(text);
    let column = lines.iter().map(|line| wide(line)).max().unwrap_or(0) + 2;
    let longest = docs.iter().map(|doc| wide(doc)).max().unwrap_or(0);
    let is_beside = longest <= width.saturating_sub(column);
    let mut text = String::new();
    for (index, line) in lines.iter().enumerate() {
        let doc = match index.checked_sub(1) {
            Some(row) => docs.get(row).map_or("", String::as_str),
            None if is_beside => "meaning",
            None => "",
        };
        let between = if is_beside {
            " ".repeat(column - wide(line))
        } else {
            "\n    ".into()
        };
        text.push_str(line);
        if !doc.is_empty() {
            text.push_str(&between);
            text.push_str(doc);
        }
        text.push('\n');
    }
    text.trim_end().into()
}

pub fn status(reply: &Reply<Status>) -> String {
    let Status {
        reason,
        // The reason says it in words.
        fault: _,
        swarm_id: _,
        origin,
        earlier_models,
        protected,
        until_step,
        rate,
        real_time_factor,
        behind_rate,
        published_hz,
        n,
        informed,
        seed,
        dt,
        parameters,
        scheduled,
        when,
        conditions: owned,
        waits,
        controllers,
        waiting_for,
        state_hash,
        order,
        certificate,
        history_from,
        replay,
        verifying,
    } = &reply.result;
    let mut lines = vec![
        ("swarm", reply.swarm.clone()),
        ("phase", format::phase(reply.phase, reason.as_deref())),
        (
            "step",
            match until_step {
                Some(until) => format!("{} of {until}", reply.step),
                None => reply.step.to_string(),
            },
        ),
        (
            "time",
            format!(
                "{} (dt {dt}, epoch {})",
                format::time(reply.time),
                reply.epoch
            ),
        ),
        (
            "rate",
            match real_time_factor {
                Some(_) => format!(
                    "{}, actual {}{}",
                    format::rate(*rate),
                    format::factor(*real_time_factor),
                    if *behind_rate {
                        ", behind its rate"
                    } else {
                        ""
                    }
                ),
                None => format::rate(*rate),
            },
        ),
        ("n", format!("{n}, {informed} informed")),
        ("order", with_mean(Some(order.order), order.mean_order)),
    ];
    if let Some(from) = origin.as_ref().and_then(format::origin) {
        lines.insert(1, ("made", from));
    }
    let asked = rate.map(|rate| rate / (parameters.publish_every as f64 * dt));
    if let (Some(hz), Some(asked)) = (published_hz, asked)
        && asked > *hz
    {
        let (hz, asked) = (format::number(*hz), format::number(asked));
        let text = format!("{hz} states a second, the daemon's max_hz, of {asked}");
        lines.push(("published", text));
    }
    if let Some(replay) = replay {
        let (frame, frames, of) = (replay.frame, replay.frames, &replay.of);
        let (position, duration) = (format::time(replay.position), format::time(replay.duration));
        let text = format!("of {of}: frame {frame} of {frames}, {position} of {duration}");
        lines.insert(1, ("replay", text));
    }
    lines.extend(earlier_models.iter().map(|it| {
        let EarlierModel {
            model_version,
            epoch,
            step,
        } = it;
        let text = format!("version {model_version} up to step {step} of epoch {epoch}");
        ("earlier model", text)
    }));
    if *protected {
        lines.push(("protected", "from delete and reset".to_owned()));
    }
    if let Some(share) = verifying {
        lines.push(("verifying", format::percent(*share)));
    }
    if *scheduled > 0 {
        let commands = format::count(*scheduled, "command");
        lines.push(("scheduled", format!("{commands} for a step to come")));
    }
    if let Some(conditions) = when {
        // An older daemon sends only the texts.
        let texts = || conditions.iter().map(|it| ("when", it.clone()));
        match owned.is_empty() {
            true => lines.extend(texts()),
            false => lines.extend(owned.iter().map(|it| ("when", condition(it)))),
        }
    }
    lines.extend(waits.iter().map(|it| ("waits", wait(it))));
    if *controllers > 0 {
        let joined = format::count(*controllers, "controller");
        let awaited = waiting_for.iter().map(|it| {
            let (secs, most) = (it.secs, it.deadline_secs);
            format!("{} for {secs:.1} of {most} s", it.controller)
        });
        let awaited: Vec<String> = awaited.collect();
        let waits = match awaited.is_empty() {
            true => String::new(),
            false => format!(", waiting for {}", awaited.join(", ")),
        };
        lines.push(("controllers", format!("{joined}{waits}")));
    }
    lines.extend(drift(order).map(|text| ("drift", text)));
    lines.extend([
        (
            "parameters",
            fields(parameters)
                .iter()
                .map(|(name, value)| format!("{name}={value}"))
                .collect::<Vec<_>>()
                .join(" "),
        ),
        (
            "exactness",
            format!(
                "worst gap {}, residual {}, degraded {}, crossed {}",
                format::magnitude(certificate.worst_gap),
                format::magnitude(Some(certificate.residual)),
                format::count(certificate.degraded, "step"),
                format::count(certificate.crossed, "pair"),
            ),
        ),
        (
            "solver",
            format!(
                "{}, {}",
                format::count(certificate.contacts, "contact"),
                format::count(certificate.iterations, "iteration")
            ),
        ),
        ("seed", seed.to_string()),
    ]);
    if replay.is_none() {
        lines.push(("state hash", state_hash.clone()));
    }
    if let Some(HistoryFrom { epoch, step }) = history_from {
        lines.push(("history", format!("kept from step {step} of epoch {epoch}")));
    }
    pairs(&lines)
}

/// A condition that waits: its id, its action and its client.
fn condition(waiting: &WaitingCondition) -> String {
    let WaitingCondition { id, condition, .. } = waiting;
    let of = client(waiting);
    format!("{id}  {condition}: {}, of {of}", action(waiting))
}

/// What a swarm does once a condition holds, and whether the condition is not evaluated.
pub fn action(waiting: &WaitingCondition) -> String {
    let action = match (waiting.action, &waiting.event) {
        (WaitingAction::Pause, _) => "pause".to_owned(),
        (WaitingAction::Commands, _) => "commands".to_owned(),
        (WaitingAction::Event, event) => format!("event {}", format::or_none(event.as_ref())),
    };
    match waiting.evaluated {
        true => action,
        false => format!("{action} (not evaluated)"),
    }
}

/// The client that sent a condition.
pub fn client(waiting: &WaitingCondition) -> String {
    format::or_none(waiting.client.as_deref().map(format::printable))
}

/// A condition for which a client waits.
fn wait(waiting: &WaitingClient) -> String {
    match &waiting.user {
        Some(user) => format!("{user} for {}", waiting.condition),
        None => format!("a client for {}", waiting.condition),
    }
}

/// The changes of a `set`.
pub fn changes(result: &SetResult) -> String {
    table(["parameter", "before", "now"], changed(result))
}

/// The parameters that `set` changed, with the previous and the new value.
pub fn changed(result: &SetResult) -> Vec<[String; 3]> {
    let SetResult { before, now, .. } = result;
    let (before, now) = (fields(before), fields(now));
    let rows = before.into_iter().zip(now);
    rows.filter(|(before, now)| before != now)
        .map(|((name, before), (_, now))| [name, before, now])
        .collect()
}

/// All parameters that may change, by name.
fn fields(values: &ParameterValues) -> Vec<(String, String)> {
    // All its numbers are finite and all its keys are strings.
    let Ok(Value::Object(fields)) = serde_json::to_value(values) else {
        return Vec::new();
    };
    let parameters = contract::parameters().into_iter();
    let written = parameters.filter_map(|parameter| {
        let value = fields.get(&parameter.name)?;
        Some((parameter.name, format::value(value, false)))
    });
    let measures = values.measures.as_deref().unwrap_or_default();
    let measures = match measures {
        [] => "none".to_owned(),
        names => names.join(","),
    };
    let idle = values.max_idle_secs;
    let idle = idle.map_or_else(|| "none".to_owned(), |secs| secs.to_string());
    let others = [("measures", measures), ("max_idle_secs", idle)];
    let others = others.map(|(name, value)| (name.to_owned(), value));
    written.chain(others).collect()
}

/// The drift and its direction; none if no individual is informed.
fn drift(order: &Order) -> Option<String> {
    let agreement = |strength| {
        format!(
            "the informed disagree: strength {}",
            format::share(strength)
        )
    };
    let strength = order.direction_strength;
    match order.direction {
        Some(direction) => {
            let drift = with_mean(order.drift, order.mean_drift);
            let mut text = format!("{drift}, along {} rad", format::time(direction));
            if strength.is_some_and(|it| it < AGREED) {
                text += &format!(", {}", agreement(strength));
            }
            Some(text)
        }
        None if strength.is_some() => Some(format!(
            "undefined, {}, below 0.1 they have no common direction",
            agreement(strength)
        )),
        None => None,
    }
}

fn with_mean(now: Option<f64>, mean: Option<f64>) -> String {
    match mean {
        Some(_) => format!("{}, mean {}", format::share(now), format::share(mean)),
        None => format::share(now),
    }
}

/// Names and values, one pair per line.
fn pairs(pairs: &[(&str, String)]) -> String {
    let width = pairs.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let lines = pairs
        .iter()
        .map(|(name, value)| format!("{name:width$}  {value}"));
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drift_has_its_direction_and_says_when_the_informed_disagree() {
        let of = |direction: Option<f64>, direction_strength, drift| {
            super::drift(&Order {
                order: 1.0,
                mean_order: None,
                velocity: [1.0, 0.0],
                mean_velocity: None,
                direction,
                direction_strength,
                drift,
                mean_drift: None,
            })
        };
        let along = "0.500, along 1.25 rad";
        assert_eq!(of(Some(1.25), Some(1.0), Some(0.5)).as_deref(), Some(along));
        // An older daemon sends no strength.
        assert_eq!(of(Some(1.25), None, Some(0.5)).as_deref(), Some(along));
        assert_eq!(
            of(Some(1.25), Some(0.5), Some(0.5)),
            Some(format!("{along}, the informed disagree: strength 0.500"))
        );
        assert_eq!(
            of(None, Some(0.02), None).as_deref(),
            Some(
                "undefined, the informed disagree: strength 0.020, below 0.1 they have no common direction"
            )
        );
        assert_eq!(of(None, None, None), None);
    }

    #[test]
    fn a_text_of_a_client_stays_in_its_cell() {
        let columns = [("client", vec!["a\nb\u{202e}c\u{1b}[2J".to_owned()])];
        assert_eq!(layout(&columns, None), "client\na\\nb\\u{202e}c\\u{1b}[2J");
    }

    #[test]
    fn a_fitted_table_is_as_wide_as_the_terminal_at_most() {
        let cells = |texts: [&str; 2]| texts.map(str::to_owned).to_vec();
        let outcome = "ok 57, conflict 2, permission_denied 12";
        let columns = [
            (
                "when",
                cells(["2026-11-24T14:40:01Z", "2026-11-24T14:41:01Z"]),
            ),
            (
                "client",
                cells(["ada@desk", &"a-long-name-of-a-client".repeat(3)]),
            ),
            ("count", cells(["1", "71"])),
            ("outcome", cells(["ok", outcome])),
        ];
        let wide = layout(&columns, None);
        assert_eq!(wide.lines().count(), 3, "{wide}");
        assert!(wide.ends_with(outcome), "{wide}");
        assert_eq!(layout(&columns, Some(200)), wide);
        let narrow = layout(&columns, Some(80));
        for line in narrow.lines() {
            assert!(console::measure_text_width(line) <= 80, "{narrow}");
        }
        assert!(narrow.contains("2026-11-24T14:41:01Z  "), "{narrow}");
    }

    #[test]
    fn docs_are_beside_the_rows_or_below_them_on_a_narrow_terminal() {
        let rows = vec![["pi1".into(), "4".into()], ["seed".into(), "0".into()]];
        let table = table(["name", "now"], rows);
        let docs = ["A ratio".to_owned(), "Of every draw".to_owned()];
        assert_eq!(
            beside_or_below(&table, &docs, usize::MAX),
            "name  now  meaning\npi1     4  A ratio\nseed    0  Of every draw"
        );
        assert_eq!(
            beside_or_below(&table, &docs, 20),
            "name  now\npi1     4\n    A ratio\nseed    0\n    Of every draw"
        );
    }
}
