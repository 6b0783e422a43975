//! Every key that a daemon serves.

/// Something that stands on a key of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its key, below the prefix; `{swarm}`, `{node}`, `{controller}` and `{experiment}` stand for
    /// names.
    pub key: &'static str,
    /// How it is used.
    pub kind: ChannelKind,
    /// The parameters of a query's selector: each with what it is.
    pub parameters: &'static [(&'static str, &'static str)],
    /// What it is for, in a line.
    pub doc: &'static str,
}

/// How a key is used. Messages are named as in [`super::schemas`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    /// A query that changes something: its arguments, within `request` or alone, and its answer.
    Command(&'static str, &'static str),
}

/// The parameters of a page of a run's time series.
const PAGE_OF_RUN: &[(&str, &str)] = &[
    ("run", "the name of the run, as in the results"),
    (
        "after",
        "a whole number, 0 by default: the reply has only entries with higher numbers; the first \
         entry is number 1",
    ),
    (
        "limit",
        "a whole number from 1 to 40000, the default: the reply has at most this number of entries",
    ),
];

/// The same, and what an entry is of.
const PAGE_OF_SERIES: &[(&str, &str)] = &[
    PAGE_OF_RUN[0],
    PAGE_OF_RUN[1],
    PAGE_OF_RUN[2],
    (
        "of",
        "`individuals` for the trajectory of the run, in which an entry is an individual at a step; \
         left out for the measures",
    ),
];

const PAGE: &[(&str, &str)] = &[
    (
        "after",
        "a whole number, 0 by default: the reply has only entries with higher numbers",
    ),
    (
        "limit",
        "a whole number from 1 to 1000, 256 by default: the reply has at most this number of \
         entries",
    ),
];

const PAGE_OF_JOURNAL: &[(&str, &str)] = &[
    PAGE[0],
    PAGE[1],
    (
        "line",
        "a whole number, `next` of the page before: where in the journal this page begins",
    ),
    (
        "from_step",
        "a whole number: the reply has only commands applied at this step or later, of any epoch",
    ),
    (
        "to_step",
        "a whole number: the reply has only commands applied at this step or earlier",
    ),
    ("verb", "a verb: the reply has only these commands"),
    (
        "client",
        "the reply has only commands of this client, or of each client of this user",
    ),
];

const PAGE_OF_AUDIT: &[(&str, &str)] = &[
    PAGE[0],
    (
        "before",
        "a whole number: the reply has only lines with lower numbers, the newest of them",
    ),
    PAGE[1],
    ("user", "the reply has only commands of this user"),
    ("client", "the reply has only commands of this client"),
    ("verb", "the reply has only commands with this verb"),
    (
        "name",
        "the reply has only commands on the swarm, experiment or recording of this name",
    ),
    (
        "from_time",
        "seconds since 1970: the reply has only lines with a command at or after this time",
    ),
    (
        "to_time",
        "seconds since 1970: the reply has only lines with a command at or before this time",
    ),
];

/// Every key a daemon serves.
pub const CHANNELS: &[Channel] = &{
    use ChannelKind::{ClientToken, Command, Get, Published, PublishedAndQueried, Put, Token};
    const fn plain(key: &'static str, kind: ChannelKind, doc: &'static str) -> Channel {
        Channel {
            key,
            kind,
            parameters: &[],
            doc,
        }
    }
    [
        Channel {
            key: "{swarm}/state",
            kind: PublishedAndQueried("state"),
            parameters: &[("format", "`json` or `cbor`, the default")],
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
            parameters: &[(
                "names",
                "the measures, separated by commas, such as `order,clusters.count(0.1)`; by \
                 default all that need no earlier state",
            )],
            doc: "Measures of the newest state, by name.",
        },
        Channel {
            key: "{swarm}/get/events",
            kind: Get("events.reply"),
            parameters: PAGE,
            doc: "The events after the one with a given number.",
        },
        Channel {
            key: "{swarm}/get/journal",
            kind: Get("journal.reply"),
            parameters: PAGE_OF_JOURNAL,
            doc: "The applied commands, from the stored journal. A page reads at most 10,000 lines of \
                  it.",
        },
        plain(
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
            parameters: &[(
                "timeout_secs",
                "a number above 0, at most 3600, 60 by default: the replay ends after this time, and \
                 the reply is `deadline_exceeded`",
            )],
        },
        Channel {
            key: "{swarm}/get/experiment",
            kind: Get("experiment.file.reply"),
            doc: "The commands applied since the swarm's start, as the file of an experiment. Its run \
                  ends with the swarm's hash.",
            parameters: &[
                (
                    "replicates",
                    "a whole number: the file has so many runs, with other seeds than the swarm",
                ),
                (
                    "setpoints",
                    "the name of a file, of letters, digits, `.`, `-` and `_`: the file of the \
                     experiment names this CSV, which `setpoints` of the reply contains, instead of \
                     containing it",
                ),
            ],
        },
        Channel {
            key: "{swarm}/get/wait",
            kind: Get("status.reply"),
            parameters: &[
                (
                    "step",
                    "a whole number: the reply is sent when the swarm reaches this step",
                ),
                (
                    "phase",
                    "`paused`, `running` or `faulted`: the reply is sent when the swarm is in \
                     this phase",
                ),
                (
                    "event",
                    "the name of a condition, given to `when` as `event`: the reply is sent once it \
                     has held, or if the swarm has faulted; it is `not_found` if no such condition \
                     waits and none of the newest commands is that it held",
                ),
                (
                    "condition",
                    "a condition, such as `order > 0.9 for 20`: the reply is sent when it holds, in the \
                     present state or after a later step, or if the swarm has faulted",
                ),
                (
                    "id",
                    "with `condition`: the id of the wait, which has the form of a name. The client holds \
                     the token of this id; a query that repeats the id and the condition continues the wait. \
                     Over HTTP the connection holds the wait, and the id may be left out",
                ),
                (
                    "timeout_secs",
                    "a number above 0, at most 30: the reply is `deadline_exceeded` after this \
                     time, or earlier if more than 1024 requests wait for the swarm",
                ),
            ],
            doc: "The status, when the swarm reaches a step or a phase, or a condition holds or has held; \
                 requires one of `step`, `phase`, `condition` and `event`.",
        },
        plain(
            "{swarm}/cmd/delete",
            Command("delete.args", "delete.reply"),
            "Deletes the swarm.",
        ),
        plain(
            "{swarm}/cmd/run",
            Command("run.args", "run.reply"),
            "Steps at a rate.",
        ),
        plain(
            "{swarm}/cmd/pause",
            Command("pause.args", "pause.reply"),
            "Pauses.",
        ),
        plain(
            "{swarm}/cmd/step",
            Command("step.args", "step.reply"),
            "Takes steps.",
        ),
        plain(
            "{swarm}/cmd/reset",
            Command("reset.args", "reset.reply"),
            "Restarts from the spec.",
        ),
        plain(
            "{swarm}/cmd/set",
            Command("set.args", "set.reply"),
            "Changes parameters.",
        ),
        plain(
            "{swarm}/cmd/inform",
            Command("inform.args", "inform.reply"),
            "Gives individuals a direction of their own.",
        ),
        plain(
            "{swarm}/cmd/uninform",
            Command("uninform.args", "uninform.reply"),
            "Takes individuals' direction away.",
        ),
        plain(
            "{swarm}/cmd/inject",
            Command("inject.args", "inject.reply"),
            "Adds individuals.",
        ),
        plain(
            "{swarm}/cmd/remove",
            Command("remove.args", "remove.reply"),
            "Removes individuals.",
        ),
        plain(
            "{swarm}/cmd/batch",
            Command("batch.args", "batch.reply"),
            "Applies several changes at one step, or none.",
        ),
        plain(
            "{swarm}/cmd/fork",
            Command("fork.args", "fork.reply"),
            "Creates a paused copy of this swarm, of its present state or that at an earlier \
             step.",
        ),
        plain(
            "{swarm}/cmd/join",
            Command("join.args", "join.reply"),
            "Registers a controller, and claims its individuals.",
        ),
        plain(
            "{swarm}/cmd/advance",
            Command("advance.args", "advance.reply"),
            "Permits steps; the swarm takes them when all its controllers in lock-step have \
             permitted them.",
        ),
        plain(
            "{swarm}/cmd/leave",
            Command("leave.args", "leave.reply"),
            "Removes a controller.",
        ),
        plain(
            "{swarm}/cmd/annotate",
            Command("annotate.args", "annotate.reply"),
            "Writes a note into the journal and the events; the state is unchanged.",
        ),
        plain(
            "{swarm}/cmd/seek",
            Command("seek.args", "seek.reply"),
            "Moves a playback to another frame.",
        ),
        plain(
            "{swarm}/cmd/when",
            Command("when.args", "when.reply"),
            "Pauses the swarm, changes it or publishes an event once a condition holds.",
        ),
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
            "@node/{node}/cmd/create",
            Command("create.args", "create.reply"),
            "Creates a swarm, paused.",
        ),
        plain(
            "@node/{node}/cmd/restore",
            Command("restore.args", "restore.reply"),
            "Creates a swarm from a snapshot, paused.",
        ),
        plain(
            "@node/{node}/cmd/discard",
            Command("discard.args", "discard.reply"),
            "Deletes the swarm of a name on this daemon only.",
        ),
        plain(
            "@node/{node}/get/experiments",
            Get("node.experiments.reply"),
            "Every experiment of the daemon, and its progress.",
        ),
        plain(
            "@node/{node}/cmd/experiment",
            Command("experiment.args", "experiment.reply"),
            "Submits, pauses, resumes, cancels or deletes an experiment.",
        ),
        plain(
            "@node/{node}/cmd/replay",
            Command("replay.args", "replay.reply"),
            "Uploads a recording, and plays it as a swarm.",
        ),
        Channel {
            key: "@node/{node}/get/audit",
            kind: Get("node.audit.reply"),
            parameters: PAGE_OF_AUDIT,
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
            parameters: &[
                ("name", "the recording"),
                (
                    "part",
                    "a whole number, 0 by default: the number of a complete part",
                ),
                (
                    "offset",
                    "a whole number, 0 by default: the byte at which the piece begins",
                ),
            ],
            doc: "A piece of a recording. Requires an operator, and a key without wildcards.",
        },
        plain(
            "@node/{node}/cmd/record",
            Command("record.args", "record.reply"),
            "Begins, stops or deletes a recording in the daemon's data directory.",
        ),
        plain(
            "@node/{node}/experiment/{experiment}/progress",
            PublishedAndQueried("experiment.progress"),
            "The progress of an experiment, at most twice a second while it changes.",
        ),
        Channel {
            key: "@node/{node}/experiment/{experiment}/results",
            kind: Get("experiment.results"),
            parameters: PAGE,
            doc: "The rows of the finished runs of an experiment. Rows are numbered from 1 in the \
                 order of the plan.",
        },
        Channel {
            key: "@node/{node}/experiment/{experiment}/order",
            kind: Get("experiment.order"),
            parameters: PAGE_OF_RUN,
            doc: "The order of one run over time, if the experiment measures it, as CBOR.",
        },
        Channel {
            key: "@node/{node}/experiment/{experiment}/series",
            kind: Get("experiment.series"),
            parameters: PAGE_OF_SERIES,
            doc: "The chosen measures of one run over time, if the experiment has `series_every`, as \
                  CBOR; or its trajectory, if the experiment has `record_every`.",
        },
    ]
};
