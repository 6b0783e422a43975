//! The protocol of a run: the commands that a file schedules, at steps and under conditions, and the
//! condition that ends the run.
//!
//! `[[at]]` blocks are checked for each condition of the plan ([`Protocol::resolve`]), with the
//! values of its variables, and executed between steps ([`ProtocolRun`]).

mod arguments;
mod block;
mod check;
mod execute;
pub mod keys;
mod resolve;
mod setting;
mod variables;

use std::sync::Arc;

use jostle_measures::check_past;
use toml::Spanned;

pub use self::block::{Block, Trigger};
pub use self::execute::{Boundary, ProtocolProgress, ProtocolRun};
use self::resolve::Resolver;
pub use self::resolve::first_span;
pub use self::setting::Setting;
pub use self::variables::{Variables, used};
use crate::error::PlanError;
use crate::file::{Source, Table};
use crate::set_points::SetPointTable;

/// The protocol of one condition of a plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Protocol {
    /// In the order of the file.
    pub blocks: Vec<Block>,
    /// Ends the run when it holds.
    pub stop: Option<Trigger>,
    /// The number of earlier steps whose states the conditions need.
    pub lag: u64,
    /// Set-points, which are applied between the blocks of their steps.
    pub set_points: Option<Arc<SetPointTable>>,
}

impl Protocol {
    /// Reads and checks the blocks and the `[stop]` of a file; none if it has neither, nor set-points.
    ///
    /// # Errors
    ///
    /// [`PlanError::Field`] with the place of the first error: an unknown key or variable, a command
    /// that no swarm of the spec accepts, or a time after the end.
    pub fn resolve(
        source: Source<'_>,
        blocks: &[Spanned<Table>],
        stop: &Table,
        setting: Setting<'_>,
    ) -> Result<Option<Arc<Self>>, PlanError> {
        if blocks.is_empty() && stop.is_empty() && setting.set_points.is_none() {
            return Ok(None);
        }
        let resolver = Resolver { source, setting };
        let mut protocol = Self::default();
        for table in blocks {
            protocol.blocks.push(resolver.block(table)?);
        }
        protocol.stop = resolver.stop(stop)?;
        resolver.check(&protocol.blocks, blocks)?;
        protocol.set_points = setting.set_points.cloned();
        let dt = setting.spec.parameters.dt;
        let triggers = protocol.blocks.iter().filter_map(Block::trigger);
        let lags = triggers
            .chain(&protocol.stop)
            .map(|it| it.condition.lag(dt));
        protocol.lag = lags.max().unwrap_or(0);
        check_past(protocol.lag, setting.spec.n).map_err(|error| {
            let tables = blocks.iter().map(Spanned::get_ref).chain([stop]);
            let mut keys = tables.flat_map(|table| table.keys());
            let when = keys.find(|key| key.get_ref() == "when");
            let span = when.map_or(0..0, Spanned::span);
            source.reject(&span, error.to_string())
        })?;
        Ok(Some(Arc::new(protocol)))
    }

    /// Returns the number of individuals that its commands inject, at most.
    #[must_use]
    pub fn injected(&self) -> u64 {
        let counts = self.blocks.iter().map(|block| {
            let executions = block.executions();
            // A ramp is largest at one of its ends.
            let ends = [0, executions.saturating_sub(1)];
            let counts = ends.map(|executed| {
                let changes = block.changes(executed);
                changes.map_or(0, |changes| check::injected(&changes))
            });
            counts[0].max(counts[1]).saturating_mul(executions)
        });
        counts.fold(0, u64::saturating_add)
    }
}

/// Reads the blocks of a file with their commands as text; see [`Block::commands`].
///
/// # Errors
///
/// As [`Protocol::resolve`].
pub fn templates(
    source: Source<'_>,
    blocks: &[Spanned<Table>],
    setting: Setting<'_>,
) -> Result<Vec<Block>, PlanError> {
    let resolver = Resolver { source, setting };
    blocks
        .iter()
        .map(|table| resolver.template(table))
        .collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
