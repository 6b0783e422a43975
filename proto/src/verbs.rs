//! Every verb: one row of `verbs!` says its arguments, its reply, and who may send it.

mod changes;
mod controllers;
mod swarms;
mod when;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::visitor::Visitor;
use crate::{
    ExperimentArgs, ExperimentResult, NodeReply, RecordArgs, Recording, ReplayArgs, ReplayResult,
    Reply, Role, SeekArgs,
};

pub use crate::parameters::SetArgs;
pub use changes::{
    BatchArgs, BatchResult, Change, Changed, Foremost, IdsResult, InformArgs, InjectArgs,
    MAX_CHANGES, Pose, Region, RemoveArgs, Select, SetResult, UninformArgs,
};
pub use controllers::{
    AdvanceArgs, AdvanceResult, Control, Departed, Departure, JoinArgs, JoinResult, LeaveArgs,
    Miss, Mode, News, OnTimeout, SetPoints,
};
pub use swarms::{
    AnnotateArgs, CreateArgs, CreateResult, DeleteArgs, DiscardArgs, EmptyResult, ForkArgs,
    MAX_NOTE_CHARS, PauseArgs, ProtectArgs, ResetArgs, ResetResult, RestoreArgs, Return, RunArgs,
    RunResult, Scheduled, StepArgs, StepResult,
};
pub use when::{WhenArgs, WhenResult};

/// What is known of a verb.
#[derive(Clone, Copy, Debug)]
pub struct Definition {
    /// Its name: the last chunk of its key, and its name in journals and events.
    pub name: &'static str,
    /// Its key, below the prefix.
    pub key: &'static str,
    /// What it does, in a line.
    pub doc: &'static str,
    /// The message with its arguments.
    pub args: &'static str,
    /// The message that replies.
    pub reply: &'static str,
    /// The least role that may send it.
    pub role: Role,
    /// Whether `at_step` can schedule it.
    pub at_step: bool,
    /// Whether it is an annotation whatever its arguments: it changes no state, and the number that keys
    /// random draws does not count it.
    pub is_annotation: bool,
    /// The place of the name of the swarm that it creates, in its arguments: a JSON pointer.
    pub creates: Option<&'static str>,
}

impl Definition {
    /// What holds for a verb whose row has no facts.
    const fn new(
        name: &'static str,
        key: &'static str,
        doc: &'static str,
        (args, reply): (&'static str, &'static str),
    ) -> Self {
        Definition {
            name,
            key,
            doc: doc.trim_ascii_start(),
            args,
            reply,
            role: Role::Operator,
            at_step: true,
            is_annotation: false,
            creates: None,
        }
    }
}

/// The arguments of a verb of a swarm.
pub trait Command: Serialize + Sync {
    /// The verb.
    const VERB: SwarmVerb;
    /// The result in its reply.
    type Result: DeserializeOwned;
}

/// Makes [`SwarmVerb`] and [`NodeVerb`], their definitions and the lists of their names. Each verb is one
/// row, in the order of all lists:
///
/// ```text
/// /// What it does, in a line.
/// name = Variant(Arguments) -> Result { fact: value };
/// ```
///
/// The facts are fields of [`Definition`]; one that is left out has the value of [`Definition::new`].
/// The reply of a swarm is a [`Reply`] with the result; a row of `node` has the whole reply.
macro_rules! verbs {
    // Both groups.
    (@group $Enum:ident, $NAMES:ident, $start:literal, $title:literal;
        $(($($doc:literal)+) $name:ident $Variant:ident $Args:ty, $Reply:ty, { $($fact:ident: $value:expr),* })+
    ) => {
        #[doc = $title]
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $Enum { $($(#[doc = $doc])+ $Variant,)+ }

        impl $Enum {
            /// What is known of each, in the order of the variants.
            pub const DEFINITIONS: &[Definition] = &[$(Definition {
                $($fact: $value,)*
                ..Definition::new(
                    stringify!($name),
                    concat!($start, stringify!($name)),
                    concat!($($doc),+),
                    (concat!(stringify!($name), ".args"), concat!(stringify!($name), ".reply")),
                )
            },)+];

            /// Calls `visitor` with the type of a message of a verb.
            fn visit<V: Visitor>(message: &str, visitor: V) -> Result<V::Output, V> {
                match message {
                    $(
                        concat!(stringify!($name), ".args") => Ok(visitor.received::<$Args>()),
                        concat!(stringify!($name), ".reply") => Ok(visitor.sent::<$Reply>()),
                    )+
                    _ => Err(visitor),
                }
            }

            /// The verb of this name.
            pub fn of(name: &str) -> Option<Self> {
                match name {
                    $(stringify!($name) => Some(Self::$Variant),)+
                    _ => None,
                }
            }

            /// What is known of it.
            pub const fn definition(self) -> &'static Definition {
                &Self::DEFINITIONS[self as usize]
            }

            /// Its name.
            pub const fn name(self) -> &'static str {
                self.definition().name
            }
        }

        /// The names of all, in the order of the variants.
        pub const $NAMES: [&str; $Enum::DEFINITIONS.len()] = [$(stringify!($name)),+];
    };
    (
        swarm { $($(#[doc = $doc:literal])+
            $name:ident = $Variant:ident($Args:ty) -> $Result:ty $({ $($fact:ident: $value:expr),+ })?;)+ }
        node { $($(#[doc = $node_doc:literal])+
            $node_name:ident = $Node:ident($NodeArgs:ty) -> $NodeReply:ty
            $({ $($node_fact:ident: $node_value:expr),+ })?;)+ }
    ) => {
        verbs!(@group SwarmVerb, SWARM_VERBS, "{swarm}/cmd/", "A verb of a swarm.";
            $(($($doc)+) $name $Variant $Args, Reply<$Result>, { $($($fact: $value),+)? })+);
        verbs!(@group NodeVerb, NODE_VERBS, "@node/{node}/cmd/", "A verb of a daemon.";
            $(($($node_doc)+) $node_name $Node $NodeArgs, $NodeReply, { $($($node_fact: $node_value),+)? })+);
        $(impl Command for $Args {
            const VERB: SwarmVerb = SwarmVerb::$Variant;
            type Result = $Result;
        })+
    };
}

verbs! {
    swarm {
        /// Deletes the swarm.
        delete = Delete(DeleteArgs) -> EmptyResult;
        /// Steps at a rate.
        run = Run(RunArgs) -> RunResult;
        /// Pauses.
        pause = Pause(PauseArgs) -> EmptyResult;
        /// Takes steps.
        step = Step(StepArgs) -> StepResult;
        /// Restarts from the spec.
        reset = Reset(ResetArgs) -> ResetResult;
        /// Changes parameters.
        set = Set(SetArgs) -> SetResult;
        /// Gives individuals a direction of their own.
        inform = Inform(InformArgs) -> IdsResult;
        /// Takes individuals' direction away.
        uninform = Uninform(UninformArgs) -> IdsResult;
        /// Adds individuals.
        inject = Inject(InjectArgs) -> IdsResult;
        /// Removes individuals.
        remove = Remove(RemoveArgs) -> IdsResult;
        /// Applies several changes at one step, or none.
        batch = Batch(BatchArgs) -> BatchResult;
        /// Creates a paused copy of this swarm, of its present state or that at an earlier step.
        fork = Fork(ForkArgs) -> CreateResult { at_step: false, creates: Some("/name") };
        /// Registers a controller, and claims its individuals.
        join = Join(JoinArgs) -> JoinResult { role: Role::Controller };
        /// Permits steps; the swarm takes them when all its controllers in lock-step have permitted
        /// them.
        advance = Advance(AdvanceArgs) -> AdvanceResult { role: Role::Controller, at_step: false };
        /// Removes a controller.
        leave = Leave(LeaveArgs) -> EmptyResult { role: Role::Controller };
        /// Writes a note into the journal and the events; the state is unchanged.
        annotate = Annotate(AnnotateArgs) -> EmptyResult {
            role: Role::Controller, is_annotation: true
        };
        /// Moves a playback to another frame.
        seek = Seek(SeekArgs) -> EmptyResult { at_step: false };
        /// Pauses the swarm, changes it or publishes an event once a condition holds.
        when = When(WhenArgs) -> WhenResult;
        /// Protects the swarm from `delete` and `reset`, or ends that.
        protect = Protect(ProtectArgs) -> EmptyResult { is_annotation: true };
    }
    node {
        /// Creates a swarm, paused.
        create = Create(CreateArgs) -> Reply<CreateResult> { at_step: false, creates: Some("/name") };
        /// Creates a swarm from a snapshot, paused.
        restore = Restore(RestoreArgs) -> Reply<CreateResult> { at_step: false, creates: Some("/name") };
        /// Deletes the swarm of a name on this daemon only.
        discard = Discard(DiscardArgs) -> Reply<EmptyResult> { at_step: false };
        /// Submits, pauses, resumes, cancels or deletes an experiment.
        experiment = Experiment(ExperimentArgs) -> NodeReply<ExperimentResult> { at_step: false };
        /// Uploads a recording, and plays it as a swarm.
        replay = Replay(ReplayArgs) -> NodeReply<ReplayResult> {
            at_step: false, creates: Some("/open/name")
        };
        /// Begins, stops or deletes a recording in the daemon's data directory.
        record = Record(RecordArgs) -> NodeReply<Recording> { at_step: false };
    }
}

impl Role {
    /// Whether it may have a swarm or a daemon execute `verb`.
    pub fn may(self, verb: &str) -> bool {
        self >= Self::least(verb)
    }

    /// The least role that may have `verb` executed: an operator, if it is unknown.
    pub fn least(verb: &str) -> Role {
        let of_swarms = SwarmVerb::of(verb).map(SwarmVerb::definition);
        let known = of_swarms.or_else(|| NodeVerb::of(verb).map(NodeVerb::definition));
        known.map_or(Role::Operator, |it| it.role)
    }
}

/// The names of the verbs that a controller may send.
pub fn of_controllers() -> impl Iterator<Item = &'static str> {
    let definitions = SwarmVerb::DEFINITIONS.iter().chain(NodeVerb::DEFINITIONS);
    let of_them = definitions.filter(|it| it.role <= Role::Controller);
    of_them.map(|it| it.name)
}

/// Calls `visitor` with the type of the message of this name, if it is of a verb.
pub(crate) fn visit<V: Visitor>(message: &str, visitor: V) -> Option<V::Output> {
    let visited = SwarmVerb::visit(message, visitor);
    visited
        .or_else(|visitor| NodeVerb::visit(message, visitor))
        .ok()
}

/// Commands that a swarm gives itself because of its controllers and conditions, in its journal and its
/// events. No client can send them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnVerb {
    /// A controller missed its deadline.
    Deadline,
    /// A controller's token disappeared.
    Lost,
    /// Set-points of controllers in mode `free_running`.
    Control,
    /// A condition holds.
    Fired,
    /// A controller was idle for too long.
    Idle,
}

const OWN: [(OwnVerb, &str); 5] = [
    (OwnVerb::Deadline, "deadline"),
    (OwnVerb::Lost, "lost"),
    (OwnVerb::Control, "control"),
    (OwnVerb::Fired, "fired"),
    (OwnVerb::Idle, "idle"),
];

/// The names of the commands that a swarm gives itself.
pub const OWN_VERBS: [&str; OWN.len()] = {
    let mut names = [""; OWN.len()];
    let mut i = 0;
    while i < OWN.len() {
        names[i] = OWN[i].1;
        i += 1;
    }
    names
};

impl OwnVerb {
    /// The verb of this name.
    pub fn of(name: &str) -> Option<Self> {
        let mut named = OWN.into_iter().filter(|(_, it)| *it == name);
        named.next().map(|(verb, _)| verb)
    }
}

/// What is known of the verb of this name, of a swarm or a node.
pub fn definition(name: &str) -> Option<&'static Definition> {
    let mut definitions = SwarmVerb::DEFINITIONS.iter().chain(NodeVerb::DEFINITIONS);
    definitions.find(|it| it.name == name)
}

/// The name of a verb that a journal can have, of a client or of the swarm itself.
pub fn journaled(name: &str) -> Option<&'static str> {
    let mut names = SWARM_VERBS.into_iter().chain(OWN_VERBS);
    names.find(|it| *it == name)
}
