//! The verbs that read the state of swarms and daemons and change nothing.

mod audit;
mod controllers;
mod journal;
mod measures;
mod nodes;
mod parameters;
mod show;
mod top;

pub use self::audit::audit;
pub use self::controllers::controllers;
pub use self::journal::{FullJournal, full_journal, journal};
pub use self::measures::{list_measures, measures};
pub use self::nodes::nodes;
pub use self::parameters::parameters;
pub use self::show::{list, spec, status};
pub use self::top::top;
