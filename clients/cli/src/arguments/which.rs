//! Which swarms a verb lists or changes: names, patterns, and what holds for them.

use clap::Args;
use clap_complete::engine::ArgValueCompleter;
use jostle_conditions::Selection;

use crate::arguments::SendingArguments;
use crate::completion;
use crate::values::{self, Names};

/// The swarms of a verb that lists; all without an argument.
#[derive(Clone, Debug, Default, Args)]
pub struct FilterArguments {
    /// Only these: names of swarms, or quoted patterns with `*`, `?` and `[abc]`, such as 'test-*'
    #[arg(value_name = "NAME", value_parser = values::names, add = ArgValueCompleter::new(completion::swarms))]
    pub names: Vec<Names>,
    /// Only those for which this holds, such as 'n >= 200 and phase = running': n, informed, order,
    /// step, time, rate, actual, phase
    #[arg(long = "where", value_name = "CONDITION", value_parser = values::selection, add = ArgValueCompleter::new(completion::selections))]
    pub condition: Option<Selection>,
}

/// The swarms that a command is sent to, each a request of its own.
#[derive(Clone, Debug, Args)]
pub struct SwarmsArguments {
    /// Names of swarms, or quoted patterns with `*`, `?` and `[abc]`, such as 'test-*'
    #[arg(required_unless_present = "condition", value_name = "NAME", value_parser = values::names, add = ArgValueCompleter::new(completion::swarms))]
    pub names: Vec<Names>,
    /// Those of them, or of all swarms, for which this holds, such as 'n >= 200 and phase = running':
    /// n, informed, order, step, time, rate, actual, phase
    #[arg(long = "where", value_name = "CONDITION", value_parser = values::selection, add = ArgValueCompleter::new(completion::selections))]
    pub condition: Option<Selection>,
    /// Do not ask for confirmation of what a pattern or --where selects
    #[arg(short, long)]
    pub yes: bool,
    #[command(flatten)]
    pub sending: SendingArguments,
}
