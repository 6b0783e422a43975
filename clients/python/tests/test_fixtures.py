"""One document for each message of the contract, read by the types of this package."""

from __future__ import annotations

import json
from dataclasses import fields as columns_of
from pathlib import Path
from typing import Any

import cbor2
import msgspec
import numpy as np
import pytest

import contract
import jostle
from jostle._attachment import read_attachment
from jostle._controller_messages import read_advanced
from jostle._decode import (
    read_batch,
    read_event,
    read_events,
    read_json,
    read_reply,
    read_scheduled,
)
from jostle._errors import read_error
from jostle._messages import SpecReply
from jostle._snapshot import read_snapshot
from jostle._state import read_state, read_step_reply

# Free-form objects of the caller or the daemon, to which nothing may be added.
FREE = {"args", "attraction", "choices", "default", "details", "schemas", "value"}

READABLE = [
    pytest.param(name, path, id=path.stem)
    for name, path in contract.fixtures("json")
    # A state is sent as CBOR, with what is attached to it; their JSON form is for people.
    if name in contract.READ.keys() - {"state", "attachment"} and path.stem != "advance.reply.state"
]


def read(name: str, payload: bytes) -> Any:
    """Reads a message as this package does."""
    kind = contract.READ[name]
    match name:
        case "advance.reply":
            return read_advanced(payload, 1)
        case "batch.reply":
            return read_batch(payload)
        case "error":
            error = read_error(payload)
            assert error is not None
            return {key: getattr(error, key) for key in ("code", "message", "details", "step")}
        case "event":
            return read_event(payload)
        case "events.reply":
            return read_events(payload)
        case "order":
            return read_json(payload, kind)
        case "scheduled.reply":
            return read_scheduled(payload)
        case "spec.reply":
            return read_json(payload, SpecReply)
    return read_reply(payload, kind)


def flat(name: str, message: dict[str, Any]) -> dict[str, Any]:
    """The fields of a message merged into one object, as in this package."""
    if name == "event":
        return {**message["event"], **{k: v for k, v in message.items() if k != "event"}}
    if name == "spec.reply" or "result" not in message:
        return message
    message = {**message["result"], **{k: v for k, v in message.items() if k != "result"}}
    if name == "step.reply":
        # It is sent as CBOR only, and read as a `State`.
        message.pop("state", None)
    if name == "events.reply":
        message["events"] = [flat("event", event) for event in message["events"]]
    if name == "batch.reply":
        message["results"] = [{"verb": one["verb"], **one["result"]} for one in message["results"]]
    return message


def arrived(message: Any, read: Any) -> list[str]:
    """The paths at which the object read differs from the message."""
    return [where for where, is_same in _compare("", message, read) if not is_same]


def _compare(where: str, message: Any, read: Any) -> list[tuple[str, bool]]:
    if isinstance(message, dict) and isinstance(read, dict):
        return [
            pair
            for key, value in message.items()
            for pair in _compare(f"{where}.{key}", value, read.get(key, "nothing"))
        ]
    if isinstance(message, list) and isinstance(read, list | tuple) and len(message) == len(read):
        return [
            pair
            for index, (left, right) in enumerate(zip(message, read, strict=True))
            for pair in _compare(f"{where}[{index}]", left, right)
        ]
    return [(where, message == read)]


def add_unknown(message: Any) -> Any:
    """The same message from a newer daemon, with additional fields everywhere."""
    if isinstance(message, list):
        return [add_unknown(item) for item in message]
    if not isinstance(message, dict):
        return message
    # The published measures are a map: their names are no fields.
    is_map = {"measures"} if isinstance(message.get("measures"), dict) else set()
    # A run's spec is handed on as it is.
    is_map |= {"spec"} if {"commands", "stop"} <= message.keys() else set()
    known = {k: v if k in FREE | is_map else add_unknown(v) for k, v in message.items()}
    return {**known, "colour": {"hue": [1, None, "red"]}}


@pytest.mark.parametrize(("name", "path"), READABLE)
def test_every_field_of_a_fixture_arrives(name: str, path: Path) -> None:
    payload = path.read_bytes()
    got = read(name, payload)
    assert arrived(flat(name, json.loads(payload)), msgspec.to_builtins(got)) == []


@pytest.mark.parametrize(("name", "path"), READABLE)
def test_fields_of_a_newer_daemon_are_ignored(name: str, path: Path) -> None:
    payload = path.read_bytes()
    more = json.dumps(add_unknown(json.loads(payload))).encode()
    assert len(more) > len(payload) // 2
    assert b"colour" in more
    assert read(name, more) == read(name, payload)


@pytest.mark.parametrize(("name", "path"), READABLE)
def test_a_truncated_fixture_is_an_error(name: str, path: Path) -> None:
    payload = path.read_bytes().rstrip()
    for cut in (1, len(payload) // 2, len(payload) - 1):
        if name == "error":
            assert read_error(payload[:cut]) is None
            continue
        with pytest.raises(jostle.Internal):
            read(name, payload[:cut])


def test_every_message_and_every_error_has_a_fixture() -> None:
    seen = {name for suffix in ("json", "cbor") for name, _ in contract.fixtures(suffix)}
    assert seen == contract.schemas().keys()
    errors = [path for name, path in contract.fixtures("json") if name == "error"]
    codes = {json.loads(path.read_bytes())["code"] for path in errors}
    assert codes == {
        kind.code for kind in jostle.JostleError.__subclasses__() if kind is not jostle.Unavailable
    }


@pytest.mark.parametrize(
    "path", [path for name, path in contract.fixtures("json") if name == "error"]
)
def test_every_error_of_the_contract_is_raised_as_its_class(path: Path) -> None:
    error = read_error(path.read_bytes())
    assert type(error) is not jostle.JostleError
    assert error is not None
    assert error.code == type(error).code == path.stem.removeprefix("error.")


def plain(state: jostle.State) -> dict[str, Any]:
    """A state as plain values."""
    values = {column.name: getattr(state, column.name) for column in columns_of(state)}
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else msgspec.to_builtins(value)
        for name, value in values.items()
    }


def test_a_state_is_the_same_in_cbor_and_in_json() -> None:
    folder = contract.PROTO / "fixtures"
    message = json.loads((folder / "state.json").read_bytes())
    payload = (folder / "state.cbor").read_bytes()
    assert arrived(message, plain(read_state(payload))) == []
    more = add_unknown(cbor2.loads(payload))
    assert plain(read_state(cbor2.dumps(more))) == plain(read_state(payload))


def test_what_is_attached_is_the_same_in_cbor_and_in_json() -> None:
    folder = contract.PROTO / "fixtures"
    message = json.loads((folder / "attachment.json").read_bytes())
    payload = (folder / "attachment.cbor").read_bytes()
    assert msgspec.to_builtins(read_attachment(payload)) == message
    more = add_unknown(cbor2.loads(payload))
    # Names of controllers are no fields.
    more["sequences"] = message["sequences"]
    assert read_attachment(cbor2.dumps(more)) == read_attachment(payload)
    for wrong in (payload[:-1], b"", cbor2.dumps([]), cbor2.dumps({"sequences": 3})):
        assert read_attachment(wrong) is None


def test_a_snapshot_is_the_same_after_a_round_trip() -> None:
    folder = contract.PROTO / "fixtures"
    message = json.loads((folder / "snapshot.reply.json").read_bytes())["result"]
    payload = (folder / "snapshot.reply.cbor").read_bytes()
    snapshot = read_snapshot(payload)
    assert cbor2.loads(snapshot.data) == cbor2.loads(payload)["result"]
    names = ("swarm", "epoch", "step", "seq", "state_hash", "model_version")
    assert {name: getattr(snapshot, name) for name in names} == {n: message[n] for n in names}
    assert snapshot.n == len(message["id"])
    assert jostle.Snapshot.from_bytes(snapshot.data) == snapshot
    more = add_unknown(cbor2.loads(payload))
    assert b"colour" in read_snapshot(cbor2.dumps(more)).data
    with pytest.raises(jostle.InvalidArgument):
        jostle.Snapshot.from_bytes(snapshot.data[:-1])
    with pytest.raises(jostle.Internal):
        read_snapshot(payload[:-1])


def test_every_field_of_a_reply_with_a_state_arrives() -> None:
    folder = contract.PROTO / "fixtures"
    message = json.loads((folder / "step.reply.state.json").read_bytes())
    result, state = read_step_reply((folder / "step.reply.state.cbor").read_bytes())
    assert state is not None
    assert arrived(message["result"]["state"], plain(state)) == []
    assert arrived(flat("step.reply", message), msgspec.to_builtins(result)) == []
    assert state.state_hash == message["result"]["state_hash"]


def test_every_field_of_an_exchange_with_a_state_arrives() -> None:
    folder = contract.PROTO / "fixtures"
    message = json.loads((folder / "advance.reply.state.json").read_bytes())
    cbor = json.loads((folder / "advance.reply.state.json").read_bytes())
    kinds = dict.fromkeys(("x", "y", "alpha", "weight", "direction"), (86, "<f8"))
    for name, (tag, dtype) in {"id": (70, "<u4"), **kinds}.items():
        column = np.array(cbor["result"]["state"][name], dtype)
        cbor["result"]["state"][name] = cbor2.CBORTag(tag, column.tobytes())
    advanced = read_advanced(cbor2.dumps(cbor), 1)
    assert advanced.state is not None
    state = message["result"].pop("state")
    assert arrived(state, plain(advanced.state)) == []
    fields = {name: getattr(advanced, name) for name in advanced.__struct_fields__}
    fields["news"] = msgspec.to_builtins(advanced.news)
    assert arrived(flat("advance.reply", message), fields) == []
    assert advanced.state.state_hash == advanced.state_hash
    cbor["result"].pop("state")
    for cut in (cbor2.dumps(cbor), cbor2.dumps(cbor)[:-1]):
        with pytest.raises(jostle.Internal):
            read_advanced(cut, 1)
