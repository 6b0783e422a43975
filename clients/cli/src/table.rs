//! Tables for people; without borders, so that `awk` reads them too.

use comfy_table::{CellAlignment, Table, presets::NOTHING};
use jostle_proto::verbs::SetResult;
use jostle_proto::{ParameterValues, Reply, Status, SwarmSummary};

use crate::format;

/// A table of these columns.
fn table<const COLUMNS: usize>(header: [&str; COLUMNS], rows: Vec<[String; COLUMNS]>) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING).set_header(header.to_vec());
    // Numbers are aligned to the right.
    let is_number =
        |text: &String| text == format::NONE || text == "max" || text.parse::<f64>().is_ok();
    let numeric: Vec<bool> = (0..COLUMNS)
        .map(|column| rows.iter().all(|row| is_number(&row[column])))
        .collect();
    table.add_rows(rows.into_iter().map(|row| row.to_vec()));
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if numeric[index] {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.trim_fmt()
}

/// The swarms of a daemon, a line each.
pub fn swarms(swarms: &[SwarmSummary]) -> String {
    let rows = swarms.iter().map(|swarm| {
        [
            swarm.swarm.clone(),
            format::phase(swarm.phase).into(),
            swarm.reason.clone().unwrap_or_else(|| format::NONE.into()),
            swarm.step.to_string(),
            format::time(swarm.time),
            swarm.n.to_string(),
            swarm.informed.to_string(),
            format::share(Some(swarm.order)),
            format::rate(swarm.rate),
            format::factor(swarm.real_time_factor),
        ]
    });
    let header = [
        "swarm", "phase", "reason", "step", "time", "n", "informed", "order", "rate", "actual",
    ];
    table(header, rows.collect())
}

/// All that a swarm says about itself.
pub fn status(reply: &Reply<Status>) -> String {
    let Status {
        reason,
        until_step,
        rate,
        real_time_factor,
        n,
        informed,
        seed,
        dt,
        parameters,
        state_hash,
        order,
        certificate,
    } = &reply.result;
    let ParameterValues {
        pi1,
        pi2,
        pi3,
        pi4,
        publish_every,
    } = parameters;
    let mut lines = vec![
        ("swarm", reply.swarm.clone()),
        (
            "phase",
            match reason {
                Some(reason) => format!("{} ({reason})", format::phase(reply.phase)),
                None => format::phase(reply.phase).into(),
            },
        ),
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
                    "{}, actual {}",
                    format::rate(*rate),
                    format::factor(*real_time_factor)
                ),
                None => format::rate(*rate),
            },
        ),
        ("n", format!("{n}, {informed} informed")),
        ("order", with_mean(Some(order.order), order.mean_order)),
    ];
    if let Some(direction) = order.direction {
        let drift = with_mean(order.drift, order.mean_drift);
        lines.push((
            "drift",
            format!("{drift}, along {}", format::time(direction)),
        ));
    }
    lines.extend([
        (
            "parameters",
            format!("pi1={pi1} pi2={pi2} pi3={pi3} pi4={pi4} publish_every={publish_every}"),
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
        ("state hash", state_hash.clone()),
    ]);
    pairs(&lines)
}

/// What `set` changed.
pub fn changes(result: &SetResult) -> String {
    let SetResult { before, now, .. } = result;
    let rows = [
        ("pi1", before.pi1, now.pi1),
        ("pi2", before.pi2, now.pi2),
        ("pi3", before.pi3, now.pi3),
        ("pi4", before.pi4, now.pi4),
        (
            "publish_every",
            before.publish_every as f64,
            now.publish_every as f64,
        ),
    ];
    let rows = rows
        .into_iter()
        .filter(|(_, before, now)| before.to_bits() != now.to_bits())
        .map(|(name, before, now)| [name.into(), before.to_string(), now.to_string()])
        .collect();
    table(["parameter", "before", "now"], rows)
}

fn with_mean(now: Option<f64>, mean: Option<f64>) -> String {
    match mean {
        Some(_) => format!("{}, mean {}", format::share(now), format::share(mean)),
        None => format::share(now),
    }
}

/// Names and values, a line each.
fn pairs(pairs: &[(&str, String)]) -> String {
    let width = pairs.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let lines = pairs
        .iter()
        .map(|(name, value)| format!("{name:width$}  {value}"));
    lines.collect::<Vec<_>>().join("\n")
}
