//! The arguments of each verb.

use std::path::PathBuf;

use clap::{ArgGroup, Args, ValueEnum, ValueHint};
use clap_complete::engine::ArgValueCompleter;
use jostle_proto::verbs::{Pose, Region};

use crate::arguments::parameters::help_of_assignments;
use crate::arguments::{
    CommandArguments, NumberArguments, SenderArguments, SendingArguments, SwarmsArguments,
};
use crate::completion;
use crate::selection::SelectionArguments;
use crate::values::{self, Assignment, End, Law, MAX_INDIVIDUALS, MAX_STEPS, Rate};

#[derive(Debug, Args)]
pub struct SelectArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    #[command(flatten)]
    pub selection: SelectionArguments,
    #[command(flatten)]
    pub sending: SendingArguments,
}

#[derive(Debug, Args)]
pub struct CreateArguments {
    /// Its name: lower case letters, digits, - and _
    pub name: String,
    /// The number of individuals
    #[arg(
        short,
        long,
        value_name = "COUNT",
        required_unless_present = "spec",
        allow_negative_numbers = true,
        value_parser = values::whole_in::<1, MAX_INDIVIDUALS>
    )]
    pub n: Option<u64>,
    #[command(flatten)]
    pub numbers: NumberArguments,
    /// Which of a pair's contacts constrain it: `endpoints`, `closest` or `clamped` [default: endpoints]
    #[arg(long, value_name = "RULE", add = ArgValueCompleter::new(completion::contact_rules))]
    pub contacts: Option<String>,
    /// What a contact limits: `position`, or the `velocity` of closing [default: position]
    #[arg(long, value_name = "RULE", add = ArgValueCompleter::new(completion::steppings))]
    pub stepping: Option<String>,
    /// Solve this many more programs per step, linearised at the predicted positions: less overlap
    #[arg(
        long,
        value_name = "PROGRAMS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1",
        allow_negative_numbers = true,
        value_parser = values::whole_in::<0, 1>
    )]
    pub relinearise: Option<u64>,
    /// What an individual turns towards: all, voronoi, metric=RADIUS, topological=NEIGHBOURS or
    /// power=EXPONENT of the distance [default: all]
    #[arg(long, value_name = "LAW", value_parser = values::law, add = ArgValueCompleter::new(completion::laws))]
    pub attraction: Option<Law>,
    /// Approximate error of the attraction to all, 1e-9 to 1e-3 (measured, not a bound); faster from a
    /// few thousand individuals on [default: exact to rounding]
    #[arg(
        long,
        value_name = "ERROR",
        conflicts_with = "attraction",
        value_parser = values::number,
        allow_hyphen_values = true
    )]
    pub accuracy: Option<f64>,
    /// The radius of the disc of the initial positions [default: √n, at least 1]
    #[arg(long, value_name = "LENGTH", value_parser = values::number, allow_hyphen_values = true)]
    pub radius: Option<f64>,
    /// The measures in each published order, such as `drift,milling` [default: none]
    #[arg(long, value_name = "MEASURES", add = ArgValueCompleter::new(completion::measures))]
    pub measures: Option<String>,
    /// Time units per second of wall clock, or `max` [default: 1]
    #[arg(long, value_name = "RATE", value_parser = values::rate, allow_hyphen_values = true)]
    pub rate: Option<Rate>,
    /// A JSON file with the spec, - for stdin; the options above override it
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub spec: Option<PathBuf>,
    /// Succeed if a swarm of this name with an equal spec exists
    #[arg(long)]
    pub exist_ok: bool,
    #[command(flatten)]
    pub sender: SenderArguments,
}

#[derive(Debug, Args)]
pub struct RunArguments {
    #[command(flatten)]
    pub swarms: SwarmsArguments,
    /// Pause at the first step at or after this time, or after which this condition holds, such as
    /// 'order > 0.9 for 20'
    #[arg(long, value_name = "TIME|CONDITION", value_parser = values::end, allow_hyphen_values = true)]
    pub until: Option<End>,
    /// Pause at this step
    #[arg(
        long,
        value_name = "STEP",
        conflicts_with = "until",
        allow_negative_numbers = true,
        value_parser = values::whole
    )]
    pub until_step: Option<u64>,
    /// Time units per second of wall clock, or `max` [default: no change]
    #[arg(long, value_name = "RATE", value_parser = values::rate, allow_hyphen_values = true)]
    pub rate: Option<Rate>,
    /// Return when it has reached the end, or without an end when it is paused; a --timeout that is
    /// given bounds the wait
    #[arg(long, conflicts_with = "at_step")]
    pub wait: bool,
}

#[derive(Debug, Args)]
pub struct StepArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// The number of steps
    #[arg(default_value_t = 1, allow_negative_numbers = true, value_parser = values::whole_in::<1, MAX_STEPS>)]
    pub steps: u64,
    /// Print the state reached, as JSON
    #[arg(long)]
    pub state: bool,
}

#[derive(Debug, Args)]
pub struct ResetArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// A new seed [default: the current one]
    #[arg(long, allow_negative_numbers = true, value_parser = values::whole)]
    pub seed: Option<u64>,
}

#[derive(Debug, Args)]
pub struct SetArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    #[arg(
        required = true,
        value_name = "NAME=VALUE",
        help = help_of_assignments(),
        value_parser = values::assignment,
        add = ArgValueCompleter::new(completion::assignments)
    )]
    pub assignments: Vec<Assignment>,
    /// With pi1: scale the positions by the least factor that avoids overlap
    #[arg(long)]
    pub make_room: bool,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("towards").args(["direction", "degrees"]).required(true))]
pub struct InformArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The direction, counter-clockwise from +x
    #[arg(long, value_name = "RADIANS", value_parser = values::number, allow_hyphen_values = true)]
    pub direction: Option<f64>,
    /// The direction in degrees
    #[arg(long, value_name = "DEGREES", value_parser = values::number, allow_hyphen_values = true)]
    pub degrees: Option<f64>,
    /// The weight of the direction relative to attraction [default: the swarm's pi2]
    #[arg(long, value_parser = values::number, allow_hyphen_values = true)]
    pub weight: Option<f64>,
    /// Uninform them after this time
    #[arg(long, value_name = "TIME", value_parser = values::number, allow_hyphen_values = true)]
    pub for_time: Option<f64>,
    #[command(flatten)]
    pub selection: SelectionArguments,
    #[command(flatten)]
    pub sending: SendingArguments,
}

#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("whom").args(["count", "at"]).required(true),
    group = ArgGroup::new("towards").args(["direction", "degrees"])
)]
pub struct InjectArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// The number of individuals, placed at the border of the group or in --within
    #[arg(long, value_name = "COUNT", allow_negative_numbers = true, value_parser = values::whole_in::<1, MAX_INDIVIDUALS>)]
    pub count: Option<u64>,
    /// The position and angle of one individual; may be repeated
    #[arg(long, value_name = "X,Y,ALPHA", value_parser = values::pose, allow_hyphen_values = true)]
    pub at: Vec<Pose>,
    /// With --count: the disc in which positions are drawn
    #[arg(long, value_name = "X,Y,RADIUS", value_parser = values::region, allow_hyphen_values = true)]
    pub within: Option<Region>,
    /// Inform them with this direction, counter-clockwise from +x
    #[arg(long, value_name = "RADIANS", value_parser = values::number, allow_hyphen_values = true)]
    pub direction: Option<f64>,
    /// Inform them with this direction in degrees
    #[arg(long, value_name = "DEGREES", value_parser = values::number, allow_hyphen_values = true)]
    pub degrees: Option<f64>,
    /// The weight of their direction relative to attraction [default: the swarm's pi2]
    #[arg(long, value_parser = values::number, allow_hyphen_values = true)]
    pub weight: Option<f64>,
}

#[derive(Debug, Args)]
pub struct BatchArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// A JSON list such as [{"verb": "set", "args": {"pi3": 2}}], - for stdin; the verbs are set, inform,
    /// uninform, inject and remove
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
}

#[derive(Debug, Args)]
pub struct LeaveArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// The controller
    #[arg(value_parser = values::name)]
    pub controller: String,
}

#[derive(Debug, Args)]
pub struct AnnotateArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// The note: 1 to 1000 characters in one line
    #[arg(value_parser = values::note)]
    pub text: String,
}

#[derive(Debug, Args)]
pub struct ProtectArguments {
    #[command(flatten)]
    pub swarms: SwarmsArguments,
    /// End the protection
    #[arg(long)]
    pub off: bool,
}

#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("effect").args(["action", "commands", "cancel"]),
    override_usage = "jostle when [OPTIONS] <NAME> <CONDITION> <ACTION|--commands <FILE>>\n       \
                      jostle when [OPTIONS] <NAME> --cancel [ID]\n       \
                      jostle when [OPTIONS] <NAME>"
)]
pub struct WhenArguments {
    #[command(flatten)]
    pub command: CommandArguments,
    /// The condition, such as 'order > 0.9 for 20' [default: list the conditions that wait]
    #[arg(requires = "effect", conflicts_with = "cancel")]
    pub condition: Option<String>,
    /// What the swarm does when it holds
    #[arg(value_enum)]
    pub action: Option<WhenAction>,
    /// Apply the changes of this file when it holds, as `batch` does; - for stdin
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, requires = "condition")]
    pub commands: Option<PathBuf>,
    /// Remove the waiting condition of this id, which `jostle when NAME` shows; without an id, all of them
    #[arg(long, value_name = "ID", num_args = 0..=1, value_parser = values::name)]
    pub cancel: Option<Option<String>>,
}

#[derive(Debug, Args)]
pub struct WaitArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The condition, such as 'drift > 0.9 for 20'
    pub condition: String,
}

/// What a swarm does when a condition holds.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum WhenAction {
    /// It pauses
    Pause,
}

#[derive(Debug, Args)]
pub struct ForkArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The new swarm's name
    #[arg(value_parser = values::name)]
    pub copy: String,
    /// Copy its state at this step, before the commands applied there [default: its current state]
    #[arg(long, value_name = "STEP", value_parser = values::whole, allow_negative_numbers = true)]
    pub at_step: Option<u64>,
    #[command(flatten)]
    pub sender: SenderArguments,
}

#[derive(Debug, Args)]
pub struct DiffArguments {
    /// The first swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub one: String,
    /// The second swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub other: String,
}

#[derive(Debug, Args)]
pub struct SnapshotArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The file
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct RestoreArguments {
    /// The file that `snapshot` wrote
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// The new swarm's name [default: the one in the file]
    #[arg(value_parser = values::name)]
    pub name: Option<String>,
    #[command(flatten)]
    pub sender: SenderArguments,
}
