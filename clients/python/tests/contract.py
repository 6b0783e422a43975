"""What the tests of the contract share: its files, and which type of this package reads which."""

from __future__ import annotations

import inspect
import json
import types
import typing
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

import jostle
from jostle._audit import Audit
from jostle._controller_messages import Controllers, Joined
from jostle._events import Events, Journal
from jostle._messages import (
    CreateResult,
    ExperimentFile,
    Measures,
    Parameters,
    SpecReply,
)
from jostle._node import Swarms
from jostle._recordings import RecordingPiece, RecordingResult, Recordings
from jostle._replay import ReplayResult
from jostle._results import ExperimentResult, Experiments, ResultsPage

PROTO = Path(__file__).resolve().parents[3] / "proto"

READ: dict[str, type[Any]] = {
    "advance.reply": jostle.Advanced,
    "attachment": jostle.Attachment,
    "annotate.reply": jostle.Reply,
    "when.reply": jostle.WhenResult,
    "batch.reply": jostle.BatchResult,
    "controllers.reply": Controllers,
    "create.reply": CreateResult,
    "delete.reply": jostle.Reply,
    "discard.reply": jostle.Reply,
    "fork.reply": CreateResult,
    "error": jostle.ErrorMessage,
    "event": jostle.Event,
    "events.reply": Events,
    "experiment.progress": jostle.Progress,
    "experiment.reply": ExperimentResult,
    "experiment.results": ResultsPage,
    "inform.reply": jostle.IdsResult,
    "inject.reply": jostle.IdsResult,
    "join.reply": Joined,
    "journal.reply": Journal,
    "leave.reply": jostle.Reply,
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
    "pause.reply": jostle.Reply,
    "record.reply": RecordingResult,
    "remove.reply": jostle.IdsResult,
    "replay.reply": ReplayResult,
    "reset.reply": jostle.ResetResult,
    "restore.reply": CreateResult,
    "run.reply": jostle.RunResult,
    "scheduled.reply": jostle.Scheduled,
    "seek.reply": jostle.Reply,
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
    document = json.loads((PROTO / "asyncapi.json").read_text(encoding="utf-8"))
    found = {}
    for name, message in document["components"]["messages"].items():
        if "payload" in message:
            file, definition = message["payload"]["$ref"].split("#/$defs/")
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


# Fields of the contract for which this package has another interface.
ADDED = {
    ("event", "skipped"),  # Counted by the reader.
    ("events.reply.events[]", "skipped"),
    ("journal.reply.entries[]", "skipped"),
    ("state", "pi1"),  # From the status.
    ("state", "attachment"),  # Beside the payload.
    ("advance.reply.state", "attachment"),
    ("state", "received_unix_nanos"),  # Of this process.
    ("advance.reply.state", "received_unix_nanos"),
    ("advance.reply.state", "pi1"),
    ("advance.reply.state", "skipped"),
    ("advance.reply.state", "state_hash"),
    ("advance.reply", "complete"),  # From the steps of the request.
    ("state", "skipped"),
    ("scheduled.reply", "outcome"),  # Of a command that did not have to wait.
    ("state", "state_hash"),  # From the reply around the state.
}
ELSEWHERE = {
    ("step.reply", "state"),  # `Swarm.step(state=True)` returns it.
    ("batch.reply.results[]", "published_hz"),  # Only the reply of `set` has it.
}
# A dictionary, so that the kinds of other daemons can be read; and what `play` sends unchanged.
LOOSE = (".attraction", ".expanded.spec", ".commands[].args")


class Checker:
    """Compares a type with a schema and collects what does not agree."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.is_asked = name == "request" or name.endswith(".args")
        self.definitions = schemas()[name].get("$defs", {})
        self.problems: list[str] = []

    def resolve(self, schema: dict[str, Any]) -> dict[str, Any]:
        """The schema that a reference stands for."""
        while "$ref" in schema:
            schema = self.definitions[schema["$ref"].removeprefix("#/$defs/")]
        return schema

    def fields(
        self, schema: dict[str, Any], within: frozenset[str]
    ) -> dict[str, tuple[dict[str, Any], bool]]:
        """The fields of an object and whether each is required.

        Those of several variants, and those inside the fields `within`, count as the object's own.
        """
        schema = self.resolve(schema)
        variants = [self.fields(variant, within) for variant in schema.get("oneOf", [])]
        if variants:
            merged: dict[str, tuple[dict[str, Any], bool]] = {}
            for name in {name: None for variant in variants for name in variant}:
                having = [variant[name] for variant in variants if name in variant]
                always = len(having) == len(variants) and all(needed for _, needed in having)
                # Of several the one that may be null, as the field then is.
                merged[name] = (max(having, key=lambda it: self.kind(it[0])[1])[0], always)
                if len({self.kind(schema)[0] for schema, _ in having}) > 1:
                    self.problems.append(f"{name} is not of one type in all variants")
            return merged
        own = {
            name: (field, name in schema.get("required", []))
            for name, field in schema.get("properties", {}).items()
        }
        for name in within & own.keys():
            own |= self.fields(own.pop(name)[0], within)
        return own

    def kind(self, schema: dict[str, Any]) -> tuple[str | None, bool]:
        """Its type without `null`, and whether `null` is allowed; None is any type."""
        schema = self.resolve(schema)
        if "anyOf" in schema:
            (one,) = [s for s in schema["anyOf"] if s.get("type") != "null"]
            return self.kind(one)[0], len(schema["anyOf"]) == 2
        if "oneOf" in schema:
            (one,) = {variant["type"] for variant in schema["oneOf"]}
            return one, False
        types_ = schema.get("type")
        if types_ is None:
            return None, True
        if isinstance(types_, str):
            return types_, False
        (one,) = [kind for kind in types_ if kind != "null"]
        return one, "null" in types_

    def check_object(self, where: str, hint: Any, schema: dict[str, Any]) -> None:
        """Compares every field of a struct with one of the schema, and the reverse."""
        hints = typing.get_type_hints(hint)
        needed = needed_fields(hint)
        within = frozenset({"result", "event"} - needed.keys())
        fields = self.fields(schema, within)
        for name in fields.keys() - needed.keys():
            if (where, name) not in ELSEWHERE:
                self.problems.append(f"{where}.{name} has no field in {hint.__name__}")
        for name in needed.keys() - fields.keys():
            if (where, name) not in ADDED:
                self.problems.append(f"{hint.__name__}.{name} is nothing of {where}")
        for name in needed.keys() & fields.keys():
            field, is_required = fields[name]
            nullable = self.kind(field)[1] or (not is_required and "default" not in field)
            at = f"{where}.{name}"
            if needed[name] and not is_required:
                self.problems.append(f"{at} may be left out, but not in {hint.__name__}")
            may_default = not self.is_asked and (nullable or hint is jostle.Spec)
            if is_required and not needed[name] and not may_default:
                self.problems.append(f"{at} is required, but not in {hint.__name__}")
            absent = {type(None), msgspec.UnsetType}
            takes_none = bool(absent & {*typing.get_args(hints[name])}) or hints[name] is Any
            if takes_none != nullable:
                self.problems.append(f"{at}: None in the contract is {nullable}, not {takes_none}")
            self.check(at, hints[name], field)

    def is_map(self, hint: Any, schema: dict[str, Any]) -> bool:
        """Whether an object of arbitrary names has numbers or null, or counts, as in the type."""
        values = schema.get("additionalProperties", {})
        if values.get("type") == "integer":
            return bool(hint == dict[str, int])
        is_number = set(values.get("type", [])) == {"number", "null"}
        return is_number and hint == dict[str, float | None]

    def check(self, where: str, hint: Any, schema: dict[str, Any]) -> None:
        """Compares a value that is not None."""
        schema = self.resolve(schema)
        kind, _ = self.kind(schema)
        if kind is None or hint is Any:
            if kind is not None or hint is not Any:
                self.problems.append(f"{where} is {kind} and not {hint}")
            return
        if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
            hints = [
                one for one in typing.get_args(hint) if one not in (type(None), msgspec.UnsetType)
            ]
            if len(hints) > 1:
                self.check_union(where, hints, schema)
                return
            (hint,) = hints
        if "anyOf" in schema:
            (schema,) = [self.resolve(s) for s in schema["anyOf"] if s.get("type") != "null"]
        if kind == "array":
            self.check_array(where, hint, schema)
        elif kind == "object":
            if schema.keys() & {"properties", "oneOf"} and not where.endswith(LOOSE):
                self.check_object(where, hint, schema)
            elif hint != dict[str, Any] and not self.is_map(hint, schema):
                self.problems.append(f"{where} is an object and not {hint}")
        elif typing.get_origin(hint) is Literal:
            words = {variant["const"] for variant in schema.get("oneOf", [])}
            if words != set(typing.get_args(hint)):
                self.problems.append(f"{where} is one of {words} and not {hint}")
        elif hint is not {"string": str, "integer": int, "number": float, "boolean": bool}[kind]:
            self.problems.append(f"{where} is {kind} and not {hint}")

    def check_union(self, where: str, hints: list[Any], schema: dict[str, Any]) -> None:
        """Every variant is one of the types, by its tag or by its only field."""
        variants = {}
        for variant in schema["oneOf"]:
            (tag,) = {
                field.get("const", name)
                for name, field in variant["properties"].items()
                if "const" in field or len(variant["properties"]) == 1
            }
            variants[tag] = variant
        tagged: dict[str, Any] = {}
        for hint in hints:
            is_struct = isinstance(hint, type) and issubclass(hint, msgspec.Struct)
            tag = hint.__struct_config__.tag if is_struct else next(iter(hint.__annotations__))
            tagged[str(tag)] = hint
        if variants.keys() != tagged.keys():
            self.problems.append(f"{where} is one of {set(variants)} and not {set(tagged)}")
        for tag in variants.keys() & tagged.keys():
            variant = dict(variants[tag])
            variant["properties"] = {
                name: field for name, field in variant["properties"].items() if "const" not in field
            }
            self.check_object(f"{where}<{tag}>", tagged[tag], variant)

    def check_array(self, where: str, hint: Any, schema: dict[str, Any]) -> None:
        """Compares a list, a tuple or a column."""
        # From Python 3.12 on NumPy names its arrays, and the name stands for the array.
        named = getattr(typing.get_origin(hint), "__value__", None)
        hint = hint if named is None else named[typing.get_args(hint)]
        origin, args = typing.get_origin(hint), typing.get_args(hint)
        items = schema["items"]
        if origin is np.ndarray:
            dtype = typing.get_args(args[1])[0]
            expected = {"uint32": np.uint32, "double": np.float64}[items["format"]]
            if dtype is not expected:
                self.problems.append(f"{where} is a column of {expected} and not {dtype}")
        elif origin is tuple:
            if schema.get("minItems") != len(args) or schema.get("maxItems") != len(args):
                self.problems.append(f"{where} has not {len(args)} items")
            for arg in args:
                self.check(f"{where}[]", arg, items)
        elif isinstance(origin, type) and issubclass(list, origin):
            self.check(f"{where}[]", args[0], {} if items is True else items)
        else:
            self.problems.append(f"{where} is an array and not {hint}")


def needed_fields(hint: Any) -> dict[str, bool]:
    """The fields of a struct, dataclass or typed dictionary, and whether each must be given."""
    if typing.is_typeddict(hint):
        return {name: name in hint.__required_keys__ for name in hint.__annotations__}
    if issubclass(hint, msgspec.Struct):
        return {field.name: field.required for field in msgspec.structs.fields(hint)}
    parameters = inspect.signature(hint).parameters
    return {name: one.default is one.empty for name, one in parameters.items()}
