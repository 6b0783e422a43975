//! Conditions on the measures of a swarm, such as `drift > 0.9 for 20 and order > 0.5`.
//!
//! A [`Condition`] is a comparison of a measure with a number, which may have to hold for some time,
//! or several of them joined by `and` and `or`. It is evaluated at steps, on the state, never on a
//! clock: [`Condition::observe`] after each step. Since when each comparison holds is a [`Held`],
//! which a checkpoint contains.
//!
//! A [`Selection`] has the same form, and is evaluated once, on what is given: `n >= 200 and
//! phase = running`.

mod condition;
mod error;
mod held;
mod parse;
mod selection;

pub use condition::{Comparison, Condition, Operator};
pub use error::{ConditionError, Problem};
pub use held::Held;
pub use selection::{Field, Selection, Value};

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
