//! `figure`: figures of tables of results, and of the current state of swarms.

use std::path::Path;

use jostle_client::Client;
use jostle_figures::{Group, Member, draw, save, snapshot as draw_snapshot};
use jostle_proto::State;
use jostle_results::table;
use serde_json::json;

use crate::arguments::FigureArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Figure;

/// Draws a figure of the paper from a table; needs no daemon.
pub fn of_results(output: Output, arguments: &FigureArguments) -> Result<(), Failure> {
    let (Figure::Of(kind), [results]) = (arguments.kind, arguments.of.as_slice()) else {
        return Err(Failure::argument(
            "RESULTS",
            "a figure is drawn from one table: name one folder or file",
        ));
    };
    let runs = table::read(Path::new(results)).map_err(Failure::results)?;
    let svg = draw(kind, &runs).map_err(Failure::results)?;
    let count = format::count(runs.len() as u64, "run");
    let what = format!("figure {} of {count}", kind.number());
    write(output, &arguments.out, &svg, &what)
}

/// Draws the current state of swarms, side by side.
pub async fn snapshot(context: &Context, arguments: &FigureArguments) -> Result<(), Failure> {
    let mut groups = Vec::new();
    for swarm in &arguments.of {
        crate::values::name(swarm).map_err(|problem| Failure::argument("SWARM", problem))?;
        groups.push(group(&context.client, swarm).await?);
    }
    let svg = draw_snapshot(&groups).map_err(Failure::results)?;
    let what = format!("a snapshot of {}", arguments.of.join(", "));
    write(context.output, &arguments.out, &svg, &what)
}

async fn group(client: &Client, swarm: &str) -> Result<Group, Failure> {
    let status = client.status(swarm).await?;
    let state: State = client.state(swarm).await?.read()?;
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

fn write(output: Output, out: &Path, svg: &str, what: &str) -> Result<(), Failure> {
    save(svg, out).map_err(Failure::results)?;
    let out = out.display().to_string();
    output.print(&json!({"file": out}), &format!("drew {what} to {out}"))
}
