//! `advance`: a controller lets the swarm step, as soon as every other one has too.

use jostle_proto::verbs::{AdvanceArgs, Return, SetPoints};

use crate::command::{CommandError, check_name, step};
use crate::model::Drive;
use crate::swarm::control;
use crate::swarm::order::Order;

/// Has a controller advance.
///
/// # Errors
///
/// [`CommandError`] for a name that is none, steps out of range, and columns that differ in length.
pub fn order(args: AdvanceArgs) -> Result<Order, CommandError> {
    let AdvanceArgs {
        controller,
        steps,
        set,
        return_: _,
    } = args;
    check_name("controller", &controller)?;
    Ok(Order::Advance {
        controller,
        steps: step::count(steps)?,
        set: set.map(set_points).transpose()?,
    })
}

/// Whether the reply is to carry the state reached.
pub fn returns_state(args: &AdvanceArgs) -> bool {
    args.return_ == Return::State
}

/// What a controller wants, its columns of one length and nobody named twice.
///
/// # Errors
///
/// [`CommandError::Field`].
pub fn set_points(set: SetPoints) -> Result<control::SetPoints, CommandError> {
    let SetPoints {
        ids,
        direction,
        weight,
        turn,
        speed,
    } = set;
    let wrong = |field, problem| Err(CommandError::Field { field, problem });
    if direction.len() != ids.len() {
        return wrong("set.direction", "has not as many numbers as there are ids");
    }
    if weight.as_ref().is_some_and(|it| it.len() != ids.len()) {
        return wrong("set.weight", "has not as many numbers as there are ids");
    }
    let fits = |column: &Option<Vec<Option<f64>>>| {
        column
            .as_ref()
            .is_none_or(|column| column.len() == ids.len())
    };
    for (field, column) in [("set.turn", &turn), ("set.speed", &speed)] {
        if !fits(column) {
            return wrong(field, "has not as many entries as there are ids");
        }
    }
    let entry = |column: &Option<Vec<Option<f64>>>, k: usize| column.as_ref().and_then(|it| it[k]);
    let is_driving = turn.is_some() || speed.is_some();
    let drives = is_driving.then(|| {
        let drives = (0..ids.len()).map(|k| Drive {
            turn: entry(&turn, k),
            speed: entry(&speed, k),
        });
        drives.collect()
    });
    let mut sorted = ids.clone();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        return wrong("set.ids", "names somebody twice");
    }
    Ok(control::SetPoints {
        ids,
        direction,
        weight,
        drives,
    })
}
