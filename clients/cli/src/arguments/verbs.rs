//! The arguments of each verb.

use std::path::PathBuf;

use clap::{ArgGroup, Args, ValueHint};
use clap_complete::engine::ArgValueCompleter;
use jostle_proto::verbs::{Pose, Region};

use crate::arguments::{SenderArguments, SendingArguments};
use crate::completion;
use crate::selection::SelectionArguments;
use crate::values::{self, Assignment, Law, Names, Rate};

/// Which swarm to pause.
#[derive(Debug, Args)]
pub struct PauseArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// A swarm and some of its individuals.
#[derive(Debug, Args)]
pub struct SelectArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Whom.
    #[command(flatten)]
    pub selection: SelectionArguments,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// What a swarm is made from.
#[derive(Debug, Args)]
pub struct CreateArguments {
    /// Its name: lower case letters, digits, - and _
    pub name: String,
    /// How many individuals
    #[arg(
        short,
        long,
        value_name = "COUNT",
        required_unless_present = "spec",
        allow_negative_numbers = true
    )]
    pub n: Option<u64>,
    /// Length over width of a body, 1 (a disc) to 32 [the daemon's default: 4]
    #[arg(long, value_name = "RATIO", value_parser = values::number, allow_hyphen_values = true)]
    pub pi1: Option<f64>,
    /// Weight of the direction of those informed without one [default: 0.5]
    #[arg(long, value_name = "WEIGHT", value_parser = values::number, allow_hyphen_values = true)]
    pub pi2: Option<f64>,
    /// Body size over turning radius [default: 1]
    #[arg(long, value_name = "RATIO", value_parser = values::number, allow_hyphen_values = true)]
    pub pi3: Option<f64>,
    /// Translational over rotational drag [default: 10]
    #[arg(long, value_name = "RATIO", value_parser = values::number, allow_hyphen_values = true)]
    pub pi4: Option<f64>,
    /// The time step [default: 0.02]
    #[arg(long, value_name = "TIME", value_parser = values::number, allow_hyphen_values = true)]
    pub dt: Option<f64>,
    /// Which of a pair's contacts constrain it: `endpoints`, `closest` or `clamped` [default: endpoints]
    #[arg(long, value_name = "RULE", add = ArgValueCompleter::new(completion::contact_rules))]
    pub contacts: Option<String>,
    /// What a contact limits: `position`, or the `velocity` of closing [default: position]
    #[arg(long, value_name = "RULE", add = ArgValueCompleter::new(completion::steppings))]
    pub stepping: Option<String>,
    /// Solve another program about what the first one predicts: less overlap
    #[arg(
        long,
        value_name = "PROGRAMS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1",
        allow_negative_numbers = true
    )]
    pub relinearise: Option<u64>,
    /// What an individual turns towards: all, voronoi, metric=RADIUS, topological=NEIGHBOURS or
    /// power=EXPONENT of the distance [default: all]
    #[arg(long, value_name = "LAW", value_parser = values::law, add = ArgValueCompleter::new(completion::laws))]
    pub attraction: Option<Law>,
    /// About how far off the attraction to all may be, 1e-9 to 1e-3 (measured, no bound); quicker
    /// from some thousand individuals on [default: exact to rounding]
    #[arg(
        long,
        value_name = "ERROR",
        conflicts_with = "attraction",
        value_parser = values::number,
        allow_hyphen_values = true
    )]
    pub accuracy: Option<f64>,
    /// Intensity of white noise on the turning rate, squared angle over time [default: 0]
    #[arg(long, value_name = "INTENSITY", value_parser = values::number, allow_hyphen_values = true)]
    pub noise: Option<f64>,
    /// The seed of every draw [default: 0]
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// The radius of the disc they start in [√n, at least 1]
    #[arg(long, value_name = "LENGTH", value_parser = values::number, allow_hyphen_values = true)]
    pub radius: Option<f64>,
    /// Steps between two published states [default: 5]
    #[arg(long, value_name = "STEPS", allow_negative_numbers = true)]
    pub publish_every: Option<u64>,
    /// Time units per second of wall clock, or `max` [default: 1]
    #[arg(long, value_name = "RATE", value_parser = values::rate, allow_hyphen_values = true)]
    pub rate: Option<Rate>,
    /// A JSON file with the spec, - for stdin; the options above override it
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub spec: Option<PathBuf>,
    /// Be content with a swarm of that name and an equal spec
    #[arg(long)]
    pub exist_ok: bool,
    /// Who sends it.
    #[command(flatten)]
    pub sender: SenderArguments,
}

/// How a swarm should run.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Pause at the first step at or after this time
    #[arg(long, value_name = "TIME", value_parser = values::number, allow_hyphen_values = true)]
    pub until: Option<f64>,
    /// Pause at this step
    #[arg(
        long,
        value_name = "STEP",
        conflicts_with = "until",
        allow_negative_numbers = true
    )]
    pub until_step: Option<u64>,
    /// Time units per second of wall clock, or `max`; left out, no change
    #[arg(long, value_name = "RATE", value_parser = values::rate, allow_hyphen_values = true)]
    pub rate: Option<Rate>,
    /// Return only when it is there; without an end, when it is paused
    #[arg(long, conflicts_with = "at_step")]
    pub wait: bool,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// How far to step.
#[derive(Debug, Args)]
pub struct StepArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// How many steps
    #[arg(default_value_t = 1, allow_negative_numbers = true)]
    pub steps: u64,
    /// Print the state reached, as JSON
    #[arg(long)]
    pub state: bool,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// How to begin anew.
#[derive(Debug, Args)]
pub struct ResetArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// A new seed; left out, the old one
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// What to change.
#[derive(Debug, Args)]
pub struct SetArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// pi1 to pi4, contacts, stepping, relinearise, attraction, noise or publish_every, such as
    /// pi1=6 or attraction=metric=3
    #[arg(required = true, value_name = "NAME=VALUE", value_parser = values::assignment, add = ArgValueCompleter::new(completion::assignments))]
    pub assignments: Vec<Assignment>,
    /// With pi1: spread the individuals by the least factor that makes room
    #[arg(long)]
    pub make_room: bool,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// Whom to give which direction.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("towards").args(["direction", "degrees"]).required(true))]
pub struct InformArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// Their direction, counter-clockwise from +x
    #[arg(long, value_name = "RADIANS", value_parser = values::number, allow_hyphen_values = true)]
    pub direction: Option<f64>,
    /// Their direction in degrees
    #[arg(long, value_name = "DEGREES", value_parser = values::number, allow_hyphen_values = true)]
    pub degrees: Option<f64>,
    /// How much it counts beside attraction [default: the swarm's pi2]
    #[arg(long, value_parser = values::number, allow_hyphen_values = true)]
    pub weight: Option<f64>,
    /// After this long they are uninformed again
    #[arg(long, value_name = "TIME", value_parser = values::number, allow_hyphen_values = true)]
    pub for_time: Option<f64>,
    /// Whom.
    #[command(flatten)]
    pub selection: SelectionArguments,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// Whom to add where.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("whom").args(["count", "at"]).required(true),
    group = ArgGroup::new("towards").args(["direction", "degrees"])
)]
pub struct InjectArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// This many, at the border of the group or in --within
    #[arg(long, value_name = "COUNT", allow_negative_numbers = true)]
    pub count: Option<u64>,
    /// One exactly there; once for each
    #[arg(long, value_name = "X,Y,ALPHA", value_parser = values::pose, allow_hyphen_values = true)]
    pub at: Vec<Pose>,
    /// With --count: the disc they are drawn in
    #[arg(long, value_name = "X,Y,RADIUS", value_parser = values::region, allow_hyphen_values = true)]
    pub within: Option<Region>,
    /// Informs them: their direction, counter-clockwise from +x
    #[arg(long, value_name = "RADIANS", value_parser = values::number, allow_hyphen_values = true)]
    pub direction: Option<f64>,
    /// Informs them: their direction in degrees
    #[arg(long, value_name = "DEGREES", value_parser = values::number, allow_hyphen_values = true)]
    pub degrees: Option<f64>,
    /// How much their direction counts beside attraction [default: the swarm's pi2]
    #[arg(long, value_parser = values::number, allow_hyphen_values = true)]
    pub weight: Option<f64>,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// Several changes at once.
#[derive(Debug, Args)]
pub struct BatchArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// A JSON list such as [{"verb": "set", "args": {"pi3": 2}}], - for stdin; set, inform,
    /// uninform, inject and remove are the verbs
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// Which controller is to leave.
#[derive(Debug, Args)]
pub struct LeaveArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The controller
    #[arg(value_parser = values::name)]
    pub controller: String,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// The note for a swarm.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  jostle annotate school \"camera 2 replaced\"")]
pub struct AnnotateArguments {
    /// The swarm
    #[arg(value_parser = values::name, add = ArgValueCompleter::new(completion::swarms))]
    pub name: String,
    /// The note: 1 to 1000 characters in one line
    #[arg(value_parser = values::note)]
    pub text: String,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}

/// Which swarms to delete.
#[derive(Debug, Args)]
pub struct DeleteArguments {
    /// Names of swarms, or quoted patterns with `*`, `?` and `[abc]`, such as 'test-*'. With --node
    /// only swarms of that daemon are deleted
    #[arg(required = true, value_name = "NAME", value_parser = values::names, add = ArgValueCompleter::new(completion::swarms))]
    pub names: Vec<Names>,
    /// Delete what a pattern matches without asking
    #[arg(short, long)]
    pub yes: bool,
    /// How it is sent.
    #[command(flatten)]
    pub sending: SendingArguments,
}
