//! Executes a protocol between the steps of a run.

use std::sync::Arc;

use jostle_conditions::Held;
use jostle_measures::{Past, View};
use jostle_physics::simulation::Simulation;
use serde::{Deserialize, Serialize};

use super::Protocol;

/// What happens between two steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boundary {
    /// The run goes on.
    Continue,
    /// The condition of `[stop]` holds.
    Stop,
}

/// How far a protocol has been executed. A checkpoint of a run contains it.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct ProtocolProgress {
    /// How often each block has been executed.
    executed: Vec<u64>,
    /// Since when the comparisons of each block's condition hold.
    held: Vec<Held>,
    /// Those of `[stop]`.
    stop: Held,
    /// The key of the draws of the next change.
    next_draw: u64,
}

/// A protocol and how far it has been executed.
pub struct ProtocolRun {
    protocol: Arc<Protocol>,
    pub progress: ProtocolProgress,
}

impl ProtocolRun {
    /// Starts a protocol. `next_draw` is the key of the draws of the first change.
    pub fn new(protocol: Arc<Protocol>, next_draw: u64) -> Self {
        let blocks = protocol.blocks.len();
        Self {
            progress: ProtocolProgress {
                executed: vec![0; blocks],
                held: vec![Held::default(); blocks],
                stop: Held::default(),
                next_draw,
            },
            protocol,
        }
    }

    /// Continues a protocol; none if the progress is of another one.
    pub fn resume(protocol: Arc<Protocol>, progress: ProtocolProgress) -> Option<Self> {
        let blocks = protocol.blocks.len();
        let lengths = [progress.executed.len(), progress.held.len()];
        (lengths == [blocks; 2]).then_some(Self { protocol, progress })
    }

    /// Executes what is due between two steps: first the conditions are evaluated, all on the state
    /// that the step left, then the blocks are executed, those whose condition holds before those of
    /// this step, each in the order of the file. `past` contains this state.
    ///
    /// # Errors
    ///
    /// The reason if a command is rejected. None of its block's commands is applied.
    pub fn boundary(
        &mut self,
        simulation: &mut Simulation,
        past: &Past,
        is_last: bool,
    ) -> Result<Boundary, String> {
        let protocol = self.protocol.clone();
        let (step, dt) = (simulation.state.step, simulation.state.parameters.dt);
        let view = View::new(&simulation.state, past).under(simulation.definitions);
        if let Some(trigger) = &protocol.stop
            && trigger.observe(&view, step, dt, &mut self.progress.stop)
        {
            return Ok(Boundary::Stop);
        }
        if is_last {
            return Ok(Boundary::Continue);
        }
        let mut due = Vec::new();
        for (index, block) in protocol.blocks.iter().enumerate() {
            if let Some(trigger) = block.trigger()
                && self.progress.executed[index] == 0
                && trigger.observe(&view, step, dt, &mut self.progress.held[index])
            {
                due.push(index);
            }
        }
        for (index, block) in protocol.blocks.iter().enumerate() {
            let due_at = block.step(self.progress.executed[index], dt);
            if due_at.is_some_and(|due_at| due_at <= step) {
                due.push(index);
            }
        }
        for (executed, &index) in (0..).zip(&due) {
            if let Some(set_points) = &protocol.set_points {
                set_points.apply(executed..executed + 1, simulation)?;
            }
            self.execute(index, simulation)?;
        }
        if let Some(set_points) = &protocol.set_points {
            set_points.apply(due.len() as u64..u64::MAX, simulation)?;
        }
        Ok(Boundary::Continue)
    }

    fn execute(&mut self, index: usize, simulation: &mut Simulation) -> Result<(), String> {
        let (block, step) = (&self.protocol.blocks[index], simulation.state.step);
        let rejected =
            |reason: String| format!("step {step}: [[at]] of line {}: {reason}", block.line);
        let executed = self.progress.executed[index];
        let changes = block.changes(executed).map_err(rejected)?;
        let count = changes.len() as u64;
        let first = match block.draw {
            Some(draw) => draw + executed * count,
            None => self.progress.next_draw,
        };
        let saved = (count > 1).then(|| simulation.save());
        if let Err((at, error)) = simulation.apply_all_at(first, &changes) {
            if let Some(saved) = saved {
                simulation.rollback(saved);
            }
            let place = match count {
                1 => String::new(),
                _ => format!("command {}: ", at + 1),
            };
            return Err(rejected(format!("{place}{error}")));
        }
        if block.draw.is_none() {
            self.progress.next_draw += count;
        }
        self.progress.executed[index] += 1;
        Ok(())
    }
}
