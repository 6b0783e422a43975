"""What the tests of the contract share: its files, and which type of this package reads which."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jostle
from jostle._arguments import AlongCount
from jostle._messages import SpecReply
from jostle._wire import (
    Audit,
    ControllerList,
    CreateResult,
    Events,
    ExperimentFile,
    ExperimentResult,
    Experiments,
    JoinResult,
    Journal,
    Measures,
    Parameters,
    RecordingPiece,
    RecordingResult,
    Recordings,
    ReplayResult,
    ResultsPage,
    Swarms,
)

PROTO = Path(__file__).resolve().parents[3] / "proto"


def payloads() -> dict[str, tuple[str, str]]:
    """Every message of the contract: the file and the name of its schema."""
    document = json.loads((PROTO / "asyncapi.json").read_text(encoding="utf-8"))
    found = {}
    for name, message in document["components"]["messages"].items():
        if "payload" in message:
            file, definition = message["payload"]["$ref"].split("#/$defs/")
            found[name] = (file, definition)
    return found


READ: dict[str, type[Any]] = {
    # Replies without a result.
    **{name: jostle.Reply for name, (_, it) in payloads().items() if it == "EmptyResultReply"},
    "advance.reply": jostle.Advanced,
    "attachment": jostle.Attachment,
    "when.reply": jostle.WhenResult,
    "batch.reply": jostle.BatchResult,
    "controllers.reply": ControllerList,
    "create.reply": CreateResult,
    "fork.reply": CreateResult,
    "error": jostle.ErrorMessage,
    "event": jostle.Event,
    "events.reply": Events,
    "experiment.progress": jostle.Progress,
    "experiment.reply": ExperimentResult,
    "experiment.results": ResultsPage,
    "inform.reply": jostle.IdsResult,
    "inject.reply": jostle.IdsResult,
    "join.reply": JoinResult,
    "journal.reply": Journal,
    "node.audit.reply": Audit,
    "node.experiments.reply": Experiments,
    "node.hello.reply": jostle.Hello,
    "node.metrics.reply": jostle.Metrics,
    "node.recordings.reply": Recordings,
    "node.recording.reply": RecordingPiece,
    "node.schema.reply": jostle.Schemas,
    "node.status.reply": jostle.NodeStatus,
    "node.swarms.reply": Swarms,
    "node.whoami.reply": jostle.WhoAmI,
    "measures.reply": Measures,
    "order": jostle.OrderSample,
    "parameters.reply": Parameters,
    "record.reply": RecordingResult,
    "remove.reply": jostle.IdsResult,
    "replay.reply": ReplayResult,
    "reset.reply": jostle.ResetResult,
    "restore.reply": CreateResult,
    "run.reply": jostle.RunResult,
    "scheduled.reply": jostle.Scheduled,
    "set.reply": jostle.SetResult,
    "spec.reply": SpecReply,
    "state": jostle.State,
    "status.reply": jostle.Status,
    "step.reply": jostle.StepResult,
    "uninform.reply": jostle.IdsResult,
    "verify.reply": jostle.Verified,
    "experiment.file.reply": ExperimentFile,
}
"""What a daemon sends."""

OPAQUE = {"snapshot.reply", "experiment.order", "experiment.series"}
"""What is sent for other daemons, of which a few fields are read; what is read as arrays."""

CHANGES: dict[str, type[Any]] = {
    "inform.args": jostle.Inform,
    "inject.args": jostle.Inject,
    "remove.args": jostle.Remove,
    "set.args": jostle.Set,
    "uninform.args": jostle.Uninform,
}
"""The commands that a `batch` can contain."""

OF_CONTROLLERS = {"advance": "advance", "control": "put", "leave": "leave"}
"""The verbs of a controller, and the names of the methods."""


def schemas() -> dict[str, dict[str, Any]]:
    """Every schema of the contract, by the name of its message."""
    found = {}
    for name, (file, definition) in payloads().items():
        defined = json.loads((PROTO / file).read_text(encoding="utf-8"))["$defs"]
        found[name] = {**defined[definition], "$defs": defined}
    return found


def fixtures(suffix: str) -> list[tuple[str, Path]]:
    """Every fixture of that suffix: the name of its message, and where it is."""
    names = schemas()
    found = []
    for path in sorted((PROTO / "fixtures").glob(f"*.{suffix}")):
        # Of a name such as `set.reply.make_room` the last part may be the variant.
        (name,) = {path.stem, path.stem.rpartition(".")[0]} & names.keys()
        found.append((name, path))
    return found


BY_HAND: dict[str, tuple[type[Any], set[str]]] = {
    "AdvanceResultReply": (jostle.Advanced, {"complete"}),
    "Foremost": (AlongCount, set()),
    "Pose": (jostle.Pose, set()),
    "Region": (jostle.Region, set()),
    "ScheduledReply": (jostle.Scheduled, {"outcome"}),
    "State": (
        jostle.State,
        {"attachment", "pi1", "received_unix_nanos", "skipped", "state_hash"},
    ),
}
"""The types of the contract of which the classes are written by hand, and what these have more."""


def definitions() -> dict[str, dict[str, Any]]:
    """Every type of the contract; what is both sent and received as it is received."""
    found: dict[str, dict[str, Any]] = {}
    for name in ("sent", "received"):
        document = json.loads((PROTO / "schema" / f"{name}.json").read_text(encoding="utf-8"))
        found |= document["$defs"]
    return found


def variants(name: str) -> dict[str, set[str]]:
    """The fields of each variant of a type, by its tag or its only field."""
    found = {}
    for variant in definitions()[name]["oneOf"]:
        fields = variant["properties"]
        (tag,) = [it["const"] for it in fields.values() if "const" in it] or fields
        found[tag] = {name for name, it in fields.items() if "const" not in it}
    return found


def fields(name: str) -> set[str]:
    """The fields of a type; those within `result` are its own."""
    properties = definitions()[name]["properties"]
    within = properties.get("result", {}).get("$ref")
    if within is None:
        return set(properties)
    return {*properties.keys() - {"result"}, *fields(within.removeprefix("#/$defs/"))}
