"""Decodes the messages of a daemon into structs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import cbor2
import msgspec

from ._errors import Internal
from ._messages import Scheduled
from ._wire import BatchResult, Event, Events

T = TypeVar("T")

# Every function here raises `Internal` if the message is not as the contract defines.


def read_reply(payload: bytes, kind: type[T]) -> T:
    """Reads a reply: the fields of its `result` and of the envelope around it, as one struct."""
    return convert(_flat(_object(payload), "result"), kind)


def read_scheduled(payload: bytes) -> Scheduled[Any] | None:
    """Reads the reply to a command that waits for its step; None if it is another reply."""
    # A reply with a state is CBOR. A command that waits has none.
    if not payload.startswith(b"{"):
        return None
    fields = _flat(_object(payload), "result")
    return convert(fields, Scheduled) if "applies_at_step" in fields else None


def read_batch(payload: bytes) -> BatchResult:
    """Reads the reply to a `batch`."""
    fields = _flat(_object(payload), "result")
    return convert({**fields, "results": _flat_each(fields.get("results"), "result")}, BatchResult)


def read_event(payload: bytes) -> Event:
    """Reads an event: its own fields and those of the envelope around it, as one struct."""
    return convert(_flat(_object(payload), "event"), Event)


def read_events(payload: bytes) -> Events:
    """Reads a page of events."""
    fields = _flat(_object(payload), "result")
    return convert({**fields, "events": _flat_each(fields.get("events"), "event")}, Events)


def read_json(payload: bytes, kind: type[T]) -> T:
    """Reads JSON as `kind`."""
    try:
        return msgspec.json.decode(payload, type=kind)
    except msgspec.DecodeError as error:
        raise unreadable(kind, error) from error


def read_map(payload: bytes) -> dict[str, Any]:
    """Reads a CBOR map."""
    # Without a hook every version of cbor2 returns a tagged byte string as it is.
    try:
        fields = cbor2.loads(payload)
    except (cbor2.CBORDecodeError, ValueError) as error:
        raise Internal(f"the daemon sent CBOR that cannot be read: {error}") from error
    if not isinstance(fields, dict):
        raise Internal("the daemon sent CBOR that is not a map")
    return cast("dict[str, Any]", fields)


def convert(fields: object, kind: type[T], dec_hook: Callable[[Any, Any], Any] | None = None) -> T:
    """Converts decoded fields to `kind`."""
    try:
        return msgspec.convert(fields, kind, dec_hook=dec_hook)
    except msgspec.ValidationError as error:
        raise unreadable(kind, error) from error


def unreadable(kind: type[object], error: Exception) -> Internal:
    """The error for a message that is not a `kind`."""
    name = getattr(kind, "__name__", str(kind))
    return Internal(f"the daemon sent a {name} that cannot be read: {error}")


def _object(payload: bytes) -> dict[str, Any]:
    return read_json(payload, dict[str, Any])


def _flat(fields: dict[str, Any], name: str) -> dict[str, Any]:
    """Moves the fields within the field `name` beside those around it."""
    within = fields.pop(name, None)
    # They have no name in common; if they had, the field around would be kept.
    return {**within, **fields} if isinstance(within, dict) else fields


def _flat_each(items: object, name: str) -> object:
    if not isinstance(items, list):
        return items
    return [_flat(item, name) if isinstance(item, dict) else item for item in items]
