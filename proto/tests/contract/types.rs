//! The Rust type of every message.

use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, AnnotateArgs, BatchArgs, BatchResult, Control, CreateArgs,
    CreateResult, DeleteArgs, DiscardArgs, EmptyResult, ForkArgs, IdsResult, InformArgs,
    InjectArgs, JoinArgs, JoinResult, LeaveArgs, PauseArgs, RemoveArgs, ResetArgs, ResetResult,
    RestoreArgs, RunArgs, RunResult, Scheduled, SetArgs, SetResult, StepArgs, StepResult,
    UninformArgs,
};
use jostle_proto::{
    Arguments, ControllerList, Error, Event, Events, ExperimentArgs, ExperimentResult, Experiments,
    Hello, Journal, Lenient, Metrics, NodeReply, NodeStatus, OrderPage, OrderSample, Parameters,
    Progress, RecordArgs, Recording, RecordingPiece, Recordings, ReplayArgs, ReplayResult, Reply,
    Request, ResultsPage, Schemas, SeekArgs, Snapshot, Spec, State, Status, Swarms, Verified,
    WhoAmI,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Reads a message into its type and writes it back.
pub fn written_back(message: &str, text: &str) -> Result<Value, String> {
    let text = written_back_as_text(message, text)?;
    serde_json::from_str(&text).map_err(|it| it.to_string())
}

/// Reads a message into its type and writes it back as text, in the order of the type's fields.
pub fn written_back_as_text(message: &str, text: &str) -> Result<String, String> {
    match message {
        "request" => {
            let request = Request::from_json(text.as_bytes()).map_err(|it| it.to_string())?;
            written(&request)
        }
        "error" => told::<Error>(text),
        "scheduled.reply" => told::<Reply<Scheduled>>(text),
        "state" => told::<State>(text),
        "order" => told::<OrderSample>(text),
        "event" => told::<Event>(text),
        "status.reply" => told::<Reply<Status>>(text),
        "spec.reply" => told::<Reply<Lenient<Spec>>>(text),
        "parameters.reply" => told::<Reply<Parameters>>(text),
        "events.reply" => told::<Reply<Events>>(text),
        "journal.reply" => told::<Reply<Journal>>(text),
        "snapshot.reply" => told::<Reply<Snapshot>>(text),
        "verify.reply" => told::<Reply<Verified>>(text),
        "create.args" => asked::<CreateArgs>(text),
        "fork.args" => asked::<ForkArgs>(text),
        "restore.args" => asked::<RestoreArgs>(text),
        "create.reply" | "fork.reply" | "restore.reply" => told::<Reply<CreateResult>>(text),
        "discard.args" => asked::<DiscardArgs>(text),
        "delete.args" => asked::<DeleteArgs>(text),
        "controllers.reply" => told::<Reply<ControllerList>>(text),
        "join.args" => asked::<JoinArgs>(text),
        "join.reply" => told::<Reply<JoinResult>>(text),
        "advance.args" => asked::<AdvanceArgs>(text),
        "advance.reply" => told::<Reply<AdvanceResult>>(text),
        "leave.args" => asked::<LeaveArgs>(text),
        "annotate.args" => asked::<AnnotateArgs>(text),
        "control.args" => asked::<Control>(text),
        "seek.args" => asked::<SeekArgs>(text),
        "replay.args" => asked::<ReplayArgs>(text),
        "replay.reply" => told::<NodeReply<ReplayResult>>(text),
        "delete.reply" | "discard.reply" | "pause.reply" | "leave.reply" | "annotate.reply"
        | "seek.reply" => told::<Reply<EmptyResult>>(text),
        "run.args" => asked::<RunArgs>(text),
        "run.reply" => told::<Reply<RunResult>>(text),
        "pause.args" => asked::<PauseArgs>(text),
        "step.args" => asked::<StepArgs>(text),
        "step.reply" => told::<Reply<StepResult>>(text),
        "reset.args" => asked::<ResetArgs>(text),
        "reset.reply" => told::<Reply<ResetResult>>(text),
        "set.args" => asked::<SetArgs>(text),
        "set.reply" => told::<Reply<SetResult>>(text),
        "inform.args" => asked::<InformArgs>(text),
        "uninform.args" => asked::<UninformArgs>(text),
        "inject.args" => asked::<InjectArgs>(text),
        "remove.args" => asked::<RemoveArgs>(text),
        "inform.reply" | "uninform.reply" | "inject.reply" | "remove.reply" => {
            told::<Reply<IdsResult>>(text)
        }
        "batch.args" => asked::<BatchArgs>(text),
        "batch.reply" => told::<Reply<BatchResult>>(text),
        "node.hello.reply" => told::<NodeReply<Hello>>(text),
        "node.whoami.reply" => told::<NodeReply<WhoAmI>>(text),
        "node.status.reply" => told::<NodeReply<NodeStatus>>(text),
        "node.swarms.reply" => told::<NodeReply<Swarms>>(text),
        "node.schema.reply" => told::<NodeReply<Schemas>>(text),
        "node.metrics.reply" => told::<NodeReply<Metrics>>(text),
        "node.experiments.reply" => told::<NodeReply<Experiments>>(text),
        "node.recordings.reply" => told::<NodeReply<Recordings>>(text),
        "node.recording.reply" => told::<NodeReply<RecordingPiece>>(text),
        "record.args" => asked::<RecordArgs>(text),
        "record.reply" => told::<NodeReply<Recording>>(text),
        "experiment.args" => asked::<ExperimentArgs>(text),
        "experiment.reply" => told::<NodeReply<ExperimentResult>>(text),
        "experiment.progress" => told::<Progress>(text),
        "experiment.results" => told::<ResultsPage>(text),
        "experiment.order" => told::<OrderPage>(text),
        other => panic!("{other} has no type here"),
    }
}

/// As a daemon reads arguments.
fn asked<T: Arguments + Serialize>(text: &str) -> Result<String, String> {
    let request = Request::from_json(text.as_bytes()).map_err(|it| it.to_string())?;
    let args: T = request.args().map_err(|it| it.to_string())?;
    written(&args)
}

/// As a client reads an answer or a sample.
fn told<T: DeserializeOwned + Serialize>(text: &str) -> Result<String, String> {
    let message: T = serde_json::from_str(text).map_err(|it| it.to_string())?;
    written(&message)
}

fn written(message: &impl Serialize) -> Result<String, String> {
    serde_json::to_string_pretty(message).map_err(|it| it.to_string())
}
