//! The types of the messages, for whatever is done with each: its schema, reading it, writing it.

use schemars::{JsonSchema, Schema};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::schema::{received, sent};
use crate::visitor::Visitor;
use crate::walk::{Arguments, Lenient};
use crate::{
    Attachment, Audit, ControllerList, Error, Event, Events, ExperimentFile, Experiments, Hello,
    Journal, Measures, Metrics, NodeReply, NodeStatus, OrderPage, OrderSample, Parameters,
    Progress, RecordingPiece, Recordings, Reply, Request, ResultsPage, Schemas, SeriesPage,
    Snapshot, Spec, State, Status, Swarms, Verified, WhoAmI, verbs,
};

/// The envelope of requests.
pub(crate) const REQUEST: &str = "request";

/// Calls `visitor` with the type of the message of this name; `None` if there is no such message.
pub fn visit<V: Visitor>(message: &str, visitor: V) -> Option<V::Output> {
    Some(match message {
        REQUEST => visitor.request(),
        "error" => visitor.sent::<Error>(),
        "scheduled.reply" => visitor.sent::<Reply<verbs::Scheduled>>(),
        "state" => visitor.sent::<State>(),
        "attachment" => visitor.sent::<Attachment>(),
        "order" => visitor.sent::<OrderSample>(),
        "event" => visitor.sent::<Event>(),
        "control.args" => visitor.received::<verbs::Control>(),
        "status.reply" => visitor.sent::<Reply<Status>>(),
        "spec.reply" => visitor.sent::<Reply<Lenient<Spec>>>(),
        "parameters.reply" => visitor.sent::<Reply<Parameters>>(),
        "measures.reply" => visitor.sent::<Reply<Measures>>(),
        "events.reply" => visitor.sent::<Reply<Events>>(),
        "journal.reply" => visitor.sent::<Reply<Journal>>(),
        "snapshot.reply" => visitor.sent::<Reply<Snapshot>>(),
        "verify.reply" => visitor.sent::<Reply<Verified>>(),
        "experiment.file.reply" => visitor.sent::<Reply<ExperimentFile>>(),
        "controllers.reply" => visitor.sent::<Reply<ControllerList>>(),
        "node.hello.reply" => visitor.sent::<NodeReply<Hello>>(),
        "node.whoami.reply" => visitor.sent::<NodeReply<WhoAmI>>(),
        "node.status.reply" => visitor.sent::<NodeReply<NodeStatus>>(),
        "node.swarms.reply" => visitor.sent::<NodeReply<Swarms>>(),
        "node.schema.reply" => visitor.sent::<NodeReply<Schemas>>(),
        "node.metrics.reply" => visitor.sent::<NodeReply<Metrics>>(),
        "node.experiments.reply" => visitor.sent::<NodeReply<Experiments>>(),
        "node.audit.reply" => visitor.sent::<NodeReply<Audit>>(),
        "node.recordings.reply" => visitor.sent::<NodeReply<Recordings>>(),
        "node.recording.reply" => visitor.sent::<NodeReply<RecordingPiece>>(),
        "experiment.progress" => visitor.sent::<Progress>(),
        "experiment.results" => visitor.sent::<ResultsPage>(),
        "experiment.order" => visitor.sent::<OrderPage>(),
        "experiment.series" => visitor.sent::<SeriesPage>(),
        of_a_verb => return verbs::visit(of_a_verb, visitor),
    })
}

/// Whether a daemon receives the message of this name; it sends all others.
pub fn is_received(message: &str) -> bool {
    message == REQUEST || message.ends_with(".args")
}

/// Makes the JSON Schema of a message.
pub(crate) struct SchemaOf;

impl Visitor for SchemaOf {
    type Output = Schema;

    fn request(self) -> Schema {
        received::<Request>()
    }

    fn received<T: Arguments + Serialize>(self) -> Schema {
        received::<T>()
    }

    fn sent<T: JsonSchema + DeserializeOwned + Serialize>(self) -> Schema {
        sent::<T>()
    }
}
