//! Every key that a daemon serves.

use std::sync::LazyLock;

use super::selectors::{self, QueryParameter};
use crate::verbs::{Definition, NodeVerb, SwarmVerb};

/// Something that stands on a key of the bus.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// Its key, below the prefix; `{swarm}`, `{node}`, `{controller}` and `{experiment}` stand for
    /// names.
    pub key: &'static str,
    /// How it is used.
    pub kind: ChannelKind,
    /// Whether a query whose key has wildcards is answered. It is not if the reply takes long, is large or
    /// is for operators, which a query for `**` does not intend.
    pub answers_wildcards: bool,
    /// The parameters of a query's selector.
    pub parameters: &'static [QueryParameter],
    /// What it is for, in a line.
    pub doc: &'static str,
}

/// How a key is used. A message is named as in [`super::messages`].
#[derive(Clone, Copy, Debug)]
pub enum ChannelKind {
    /// The daemon publishes this message.
    Published(&'static str),
    /// The daemon publishes this message, and answers a query with the newest.
    PublishedAndQueried(&'static str),
    /// A liveliness token of the daemon's: no payload.
    Token,
    /// A client puts this message.
    Put(&'static str),
    /// A liveliness token of a client's: no payload.
    ClientToken,
    /// A query that changes nothing, answered with this message.
    Get(&'static str),
    /// A query that changes something: its arguments are within `request` or alone.
    Command(&'static Definition),
}

use ChannelKind::{ClientToken, Get, Published, PublishedAndQueried, Put, Token};

const fn plain(key: &'static str, kind: ChannelKind, doc: &'static str) -> Channel {
    Channel {
        key,
        kind,
        answers_wildcards: true,
        parameters: &[],
        doc,
    }
}

/// One that a query with wildcards does not reach.
const fn alone(key: &'static str, kind: ChannelKind, doc: &'static str) -> Channel {
    Channel {
        answers_wildcards: false,
        ..plain(key, kind, doc)
    }
}

/// What a swarm publishes and answers.
const OF_A_SWARM: &[Channel] = &[
    Channel {
        key: "{swarm}/state",
        kind: PublishedAndQueried("state"),
        answers_wildcards: true,
        parameters: selectors::STATE,
        doc: "The newest state, as a CBOR map of typed arrays. A published one has an \
              `attachment`, a reply has none.",
    },
    plain(
        "{swarm}/order",
        Published("order"),
        "Order and drift beside each state.",
    ),
    plain(
        "{swarm}/event",
        Published("event"),
        "The events of the swarm, numbered. An advanced subscriber that joins late gets the \
         last 64.",
    ),
    plain(
        "{swarm}/alive/{node}",
        Token,
        "Exists while the swarm exists.",
    ),
    plain(
        "{swarm}/claim/{node}/{instance}/{standing}",
        Token,
        "Held by a daemon that has a swarm of this name, and serves it unless it is `waiting`.",
    ),
    plain(
        "{swarm}/get/status",
        Get("status.reply"),
        "The status of the swarm.",
    ),
    plain(
        "{swarm}/get/controllers",
        Get("controllers.reply"),
        "The joined controllers: their individuals, misses and puts.",
    ),
    plain(
        "{swarm}/get/spec",
        Get("spec.reply"),
        "The spec of the swarm.",
    ),
    plain(
        "{swarm}/get/parameters",
        Get("parameters.reply"),
        "Every parameter: value, range, unit, default, whether it may change.",
    ),
    Channel {
        key: "{swarm}/get/measures",
        kind: Get("measures.reply"),
        answers_wildcards: true,
        parameters: selectors::MEASURES,
        doc: "Measures of the newest state, by name.",
    },
    Channel {
        key: "{swarm}/get/events",
        kind: Get("events.reply"),
        answers_wildcards: true,
        parameters: selectors::PAGE,
        doc: "The events after the one with a given number.",
    },
    Channel {
        key: "{swarm}/get/journal",
        kind: Get("journal.reply"),
        answers_wildcards: true,
        parameters: selectors::PAGE_OF_JOURNAL,
        doc: "The applied commands, from the stored journal. A page reads at most 10,000 lines of \
              it.",
    },
    alone(
        "{swarm}/get/snapshot",
        Get("snapshot.reply"),
        "Everything that the swarm's next steps depend on, as CBOR. A daemon of the same \
         model version can restore it.",
    ),
    Channel {
        key: "{swarm}/get/verify",
        kind: Get("verify.reply"),
        doc: "Whether a replay of the swarm's journal gives the same hashes. The reply takes as \
              long as the replay.",
        answers_wildcards: false,
        parameters: selectors::VERIFY,
    },
    Channel {
        key: "{swarm}/get/experiment",
        kind: Get("experiment.file.reply"),
        doc: "The commands applied since the swarm's start, as the file of an experiment. Its run \
              ends with the swarm's hash.",
        answers_wildcards: false,
        parameters: selectors::EXPORT,
    },
    Channel {
        key: "{swarm}/get/wait",
        kind: Get("status.reply"),
        answers_wildcards: false,
        parameters: selectors::WAIT,
        doc: "The status, when the swarm reaches a step or a phase, or a condition holds or has held; \
             requires one of `step`, `phase`, `condition` and `event`.",
    },
];

/// What the clients of a swarm put and hold.
const OF_CLIENTS: &[Channel] = &[
    plain(
        "{swarm}/ctl/{controller}",
        Put("control.args"),
        "Set-points of a controller that joined in mode `free_running`; newer ones replace \
         older ones.",
    ),
    plain(
        "{swarm}/ctl/{controller}/alive",
        ClientToken,
        "Held by a controller; if it disappears, the daemon removes the controller.",
    ),
    plain(
        "{swarm}/wait/{id}/alive",
        ClientToken,
        "Held by a client that waits for a condition with this `id`; 2 s after it disappears, the wait \
         ends.",
    ),
];

/// What a daemon answers.
const OF_A_NODE: &[Channel] = &[
    plain("@node/{node}/alive", Token, "Exists while the daemon runs."),
    plain(
        "@node/{node}/claim/{instance}/{standing}",
        Token,
        "Held by a daemon of this name.",
    ),
    plain(
        "@node/{node}/get/hello",
        Get("node.hello.reply"),
        "The version of the daemon, and its limits.",
    ),
    plain(
        "@node/{node}/get/whoami",
        Get("node.whoami.reply"),
        "The user whose token the request carries, and the verbs that this user may send.",
    ),
    plain(
        "@node/{node}/get/status",
        Get("node.status.reply"),
        "The status of the daemon.",
    ),
    plain(
        "@node/{node}/get/swarms",
        Get("node.swarms.reply"),
        "Every swarm that the daemon hosts.",
    ),
    plain(
        "@node/{node}/get/schema",
        Get("node.schema.reply"),
        "The JSON Schema of every message.",
    ),
    plain(
        "@node/{node}/get/metrics",
        Get("node.metrics.reply"),
        "Metrics of the daemon and its swarms.",
    ),
    plain(
        "@node/{node}/get/experiments",
        Get("node.experiments.reply"),
        "Every experiment of the daemon, and its progress.",
    ),
    Channel {
        key: "@node/{node}/get/audit",
        kind: Get("node.audit.reply"),
        answers_wildcards: false,
        parameters: selectors::PAGE_OF_AUDIT,
        doc: "Who sent which commands, and with what outcome. Requires an operator, and a key \
              without wildcards.",
    },
    plain(
        "@node/{node}/get/recordings",
        Get("node.recordings.reply"),
        "Every recording of the daemon, and its status.",
    ),
    Channel {
        key: "@node/{node}/get/recording",
        kind: Get("node.recording.reply"),
        answers_wildcards: false,
        parameters: selectors::RECORDING,
        doc: "A piece of a recording. Requires an operator, and a key without wildcards.",
    },
];

/// What a daemon publishes and answers about an experiment.
const OF_AN_EXPERIMENT: &[Channel] = &[
    plain(
        "@node/{node}/experiment/{experiment}/progress",
        PublishedAndQueried("experiment.progress"),
        "The progress of an experiment, at most twice a second while it changes.",
    ),
    Channel {
        key: "@node/{node}/experiment/{experiment}/results",
        kind: Get("experiment.results"),
        answers_wildcards: false,
        parameters: selectors::PAGE,
        doc: "The rows of the finished runs of an experiment. Rows are numbered from 1 in the \
             order of the plan.",
    },
    Channel {
        key: "@node/{node}/experiment/{experiment}/order",
        kind: Get("experiment.order"),
        answers_wildcards: false,
        parameters: selectors::PAGE_OF_RUN,
        doc: "The order of one run over time, if the experiment measures it, as CBOR.",
    },
    Channel {
        key: "@node/{node}/experiment/{experiment}/series",
        kind: Get("experiment.series"),
        answers_wildcards: false,
        parameters: selectors::PAGE_OF_SERIES,
        doc: "The chosen measures of one run over time, if the experiment has `series_every`, as \
              CBOR; or its trajectory, if the experiment has `record_every`.",
    },
];

/// Every key a daemon serves.
pub static CHANNELS: LazyLock<Vec<Channel>> = LazyLock::new(|| {
    let commands = |definitions: &'static [Definition]| {
        let definitions = definitions.iter();
        definitions.map(|it| plain(it.key, ChannelKind::Command(it), it.doc))
    };
    let given = |channels: &'static [Channel]| channels.iter().copied();
    given(OF_A_SWARM)
        .chain(commands(SwarmVerb::DEFINITIONS))
        .chain(given(OF_CLIENTS))
        .chain(given(OF_A_NODE))
        .chain(commands(NodeVerb::DEFINITIONS))
        .chain(given(OF_AN_EXPERIMENT))
        .collect()
});
