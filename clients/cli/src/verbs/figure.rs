//! `figure`: pictures from tables of results, and of swarms as they are.

use std::path::Path;

use jostle_figures::{Group, Member, draw, save, snapshot as draw_snapshot};
use jostle_proto::{Reply, State, Status};
use jostle_results::table;
use serde_json::json;

use crate::arguments::FigureArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Figure;

/// Draws a figure of the paper from a table; needs no daemon.
///
/// # Errors
///
/// Why there is no picture.
pub fn of_results(output: Output, arguments: &FigureArguments) -> Result<(), Failure> {
    let (Figure::Of(kind), [results]) = (arguments.kind, arguments.of.as_slice()) else {
        return Err(Failure::Argument {
            argument: "RESULTS".into(),
            problem: "a figure is drawn from one table: name one folder or file".into(),
        });
    };
    let runs = table::read(Path::new(results)).map_err(wrong)?;
    let svg = draw(kind, &runs).map_err(wrong)?;
    write(
        output,
        arguments,
        &svg,
        &format!(
            "figure {} of {}",
            kind.number(),
            format::count(runs.len() as u64, "run")
        ),
    )
}

/// Draws swarms as they are, side by side.
///
/// # Errors
///
/// Why there is no picture.
pub async fn snapshot(
    bus: &Bus,
    output: Output,
    arguments: &FigureArguments,
) -> Result<(), Failure> {
    let mut groups = Vec::new();
    for swarm in &arguments.of {
        crate::values::name(swarm).map_err(|problem| Failure::Argument {
            argument: "SWARM".into(),
            problem,
        })?;
        groups.push(group(bus, swarm).await?);
    }
    let svg = draw_snapshot(&groups).map_err(wrong)?;
    let what = format!("a snapshot of {}", arguments.of.join(", "));
    write(output, arguments, &svg, &what)
}

async fn group(bus: &Bus, swarm: &str) -> Result<Group, Failure> {
    let status: Reply<Status> = bus.get(swarm, "status").await?.read()?;
    let state: State = bus.state(swarm).await?.read()?;
    let members = (0..state.id.len()).map(|i| Member {
        x: state.x[i],
        y: state.y[i],
        alpha: state.alpha[i],
        weight: state.weight[i],
        direction: state.direction[i],
    });
    Ok(Group {
        title: format!("{swarm}, time {}", format::time(state.time)),
        pi1: status.result.parameters.pi1,
        members: members.collect(),
    })
}

fn write(
    output: Output,
    arguments: &FigureArguments,
    svg: &str,
    what: &str,
) -> Result<(), Failure> {
    save(svg, &arguments.out).map_err(wrong)?;
    let out = arguments.out.display().to_string();
    if output.json {
        return output.data(&json!({"file": out}).to_string());
    }
    output.data(&format!("drew {what} to {out}"))
}

#[expect(clippy::needless_pass_by_value, reason = "`map_err` hands it over")]
fn wrong(error: impl ToString) -> Failure {
    Failure::Results(error.to_string())
}
