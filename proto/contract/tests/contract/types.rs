//! The Rust type of every message.

use jostle_proto::verbs::{
    AdvanceArgs, AdvanceResult, AnnotateArgs, BatchArgs, BatchResult, Control, CreateArgs,
    CreateResult, DeleteArgs, DiscardArgs, EmptyResult, ForkArgs, IdsResult, InformArgs,
    InjectArgs, JoinArgs, JoinResult, LeaveArgs, PauseArgs, RemoveArgs, ResetArgs, ResetResult,
    RestoreArgs, RunArgs, RunResult, Scheduled, SetArgs, SetResult, StepArgs, StepResult,
    UninformArgs, WhenArgs, WhenResult,
};
use jostle_proto::{
    Arguments, Attachment, Audit, ControllerList, Error, Event, Events, ExperimentArgs,
    ExperimentFile, ExperimentResult, Experiments, Hello, Journal, Lenient, Measures, Metrics,
    NodeReply, NodeStatus, OrderPage, OrderSample, Parameters, Progress, RecordArgs, Recording,
    RecordingPiece, Recordings, ReplayArgs, ReplayResult, Reply, Request, ResultsPage, Schemas,
    SeekArgs, SeriesPage, Snapshot, Spec, State, Status, Swarms, Verified, WhoAmI,
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
        "error" => received::<Error>(text),
        "scheduled.reply" => received::<Reply<Scheduled>>(text),
        "state" => received::<State>(text),
        "attachment" => received::<Attachment>(text),
        "order" => received::<OrderSample>(text),
        "event" => received::<Event>(text),
        "status.reply" => received::<Reply<Status>>(text),
        "spec.reply" => received::<Reply<Lenient<Spec>>>(text),
        "parameters.reply" => received::<Reply<Parameters>>(text),
        "measures.reply" => received::<Reply<Measures>>(text),
        "events.reply" => received::<Reply<Events>>(text),
        "journal.reply" => received::<Reply<Journal>>(text),
        "snapshot.reply" => received::<Reply<Snapshot>>(text),
        "verify.reply" => received::<Reply<Verified>>(text),
        "experiment.file.reply" => received::<Reply<ExperimentFile>>(text),
        "create.args" => arguments::<CreateArgs>(text),
        "fork.args" => arguments::<ForkArgs>(text),
        "restore.args" => arguments::<RestoreArgs>(text),
        "create.reply" | "fork.reply" | "restore.reply" => received::<Reply<CreateResult>>(text),
        "discard.args" => arguments::<DiscardArgs>(text),
        "delete.args" => arguments::<DeleteArgs>(text),
        "controllers.reply" => received::<Reply<ControllerList>>(text),
        "join.args" => arguments::<JoinArgs>(text),
        "join.reply" => received::<Reply<JoinResult>>(text),
        "advance.args" => arguments::<AdvanceArgs>(text),
        "advance.reply" => received::<Reply<AdvanceResult>>(text),
        "leave.args" => arguments::<LeaveArgs>(text),
        "annotate.args" => arguments::<AnnotateArgs>(text),
        "control.args" => arguments::<Control>(text),
        "seek.args" => arguments::<SeekArgs>(text),
        "when.args" => arguments::<WhenArgs>(text),
        "replay.args" => arguments::<ReplayArgs>(text),
        "replay.reply" => received::<NodeReply<ReplayResult>>(text),
        "delete.reply" | "discard.reply" | "pause.reply" | "leave.reply" | "annotate.reply"
        | "seek.reply" => received::<Reply<EmptyResult>>(text),
        "when.reply" => received::<Reply<WhenResult>>(text),
        "run.args" => arguments::<RunArgs>(text),
        "run.reply" => received::<Reply<RunResult>>(text),
        "pause.args" => arguments::<PauseArgs>(text),
        "step.args" => arguments::<StepArgs>(text),
        "step.reply" => received::<Reply<StepResult>>(text),
        "reset.args" => arguments::<ResetArgs>(text),
        "reset.reply" => received::<Reply<ResetResult>>(text),
        "set.args" => arguments::<SetArgs>(text),
        "set.reply" => received::<Reply<SetResult>>(text),
        "inform.args" => arguments::<InformArgs>(text),
        "uninform.args" => arguments::<UninformArgs>(text),
        "inject.args" => arguments::<InjectArgs>(text),
        "remove.args" => arguments::<RemoveArgs>(text),
        "inform.reply" | "uninform.reply" | "inject.reply" | "remove.reply" => {
            received::<Reply<IdsResult>>(text)
        }
        "batch.args" => arguments::<BatchArgs>(text),
        "batch.reply" => received::<Reply<BatchResult>>(text),
        "node.hello.reply" => received::<NodeReply<Hello>>(text),
        "node.whoami.reply" => received::<NodeReply<WhoAmI>>(text),
        "node.status.reply" => received::<NodeReply<NodeStatus>>(text),
        "node.swarms.reply" => received::<NodeReply<Swarms>>(text),
        "node.schema.reply" => received::<NodeReply<Schemas>>(text),
        "node.metrics.reply" => received::<NodeReply<Metrics>>(text),
        "node.experiments.reply" => received::<NodeReply<Experiments>>(text),
        "node.audit.reply" => received::<NodeReply<Audit>>(text),
        "node.recordings.reply" => received::<NodeReply<Recordings>>(text),
        "node.recording.reply" => received::<NodeReply<RecordingPiece>>(text),
        "record.args" => arguments::<RecordArgs>(text),
        "record.reply" => received::<NodeReply<Recording>>(text),
        "experiment.args" => arguments::<ExperimentArgs>(text),
        "experiment.reply" => received::<NodeReply<ExperimentResult>>(text),
        "experiment.progress" => received::<Progress>(text),
        "experiment.results" => received::<ResultsPage>(text),
        "experiment.order" => received::<OrderPage>(text),
        "experiment.series" => received::<SeriesPage>(text),
        other => panic!("{other} has no type here"),
    }
}

/// Reads arguments as a daemon does.
fn arguments<T: Arguments + Serialize>(text: &str) -> Result<String, String> {
    let request = Request::from_json(text.as_bytes()).map_err(|it| it.to_string())?;
    let args: T = request.args().map_err(|it| it.to_string())?;
    written(&args)
}

/// Reads a reply or a sample as a client does.
fn received<T: DeserializeOwned + Serialize>(text: &str) -> Result<String, String> {
    let message: T = serde_json::from_str(text).map_err(|it| it.to_string())?;
    written(&message)
}

fn written(message: &impl Serialize) -> Result<String, String> {
    serde_json::to_string_pretty(message).map_err(|it| it.to_string())
}
