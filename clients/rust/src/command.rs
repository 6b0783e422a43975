//! The commands to a swarm: their verbs, arguments and results.

use jostle_proto::SeekArgs;
use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, AnnotateArgs, BatchArgs, BatchResult, CreateResult, DeleteArgs,
    EmptyResult, ForkArgs, IdsResult, InformArgs, InjectArgs, JoinArgs, JoinResult, LeaveArgs,
    PauseArgs, RemoveArgs, ResetArgs, ResetResult, RunArgs, RunResult, SetArgs, SetResult,
    StepArgs, StepResult, UninformArgs, WhenArgs, WhenResult,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The arguments of a command to a swarm.
pub trait Command: Serialize + Sync {
    /// The verb.
    const VERB: &'static str;
    /// The result in the reply.
    type Result: DeserializeOwned;
}

macro_rules! commands {
    ($($verb:literal: $args:ty => $result:ty,)*) => {
        $(impl Command for $args {
            const VERB: &'static str = $verb;
            type Result = $result;
        })*
    };
}

commands! {
    "run": RunArgs => RunResult,
    "pause": PauseArgs => EmptyResult,
    "step": StepArgs => StepResult,
    "inform": InformArgs => IdsResult,
    "uninform": UninformArgs => IdsResult,
    "inject": InjectArgs => IdsResult,
    "remove": RemoveArgs => IdsResult,
    "set": SetArgs => SetResult,
    "batch": BatchArgs => BatchResult,
    "join": JoinArgs => JoinResult,
    "advance": AdvanceArgs => AdvanceResult,
    "leave": LeaveArgs => EmptyResult,
    "annotate": AnnotateArgs => EmptyResult,
    "when": WhenArgs => WhenResult,
    "reset": ResetArgs => ResetResult,
    "delete": DeleteArgs => EmptyResult,
    "fork": ForkArgs => CreateResult,
    "seek": SeekArgs => EmptyResult,
}
