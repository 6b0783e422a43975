"""How what a daemon sends becomes structs."""

from __future__ import annotations

from typing import Any, TypeVar, cast

import cbor2
import msgspec

from ._errors import Internal
from ._events import Event, Events
from ._messages import BatchResult, Scheduled

T = TypeVar("T")


def read_reply(payload: bytes, kind: type[T]) -> T:
    """Reads an answer: the fields of its `result` and of the envelope around it, as one struct.

    Raises:
        Internal: It is not what the contract says.
    """
    return convert(_flat(read_json(payload, dict[str, Any]), "result"), kind)


def read_scheduled(payload: bytes) -> Scheduled | None:
    """Reads the answer to a command that waits for its step; None if it is another answer.

    Raises:
        Internal: It is not what the contract says.
    """
    # An answer with a state is CBOR. A command that waits has none yet.
    if not payload.startswith(b"{"):
        return None
    fields = _flat(read_json(payload, dict[str, Any]), "result")
    return convert(fields, Scheduled) if "applies_at_step" in fields else None


def read_batch(payload: bytes) -> BatchResult:
    """Reads what the changes of a `batch` came to.

    Raises:
        Internal: It is not what the contract says.
    """
    fields = _flat(read_json(payload, dict[str, Any]), "result")
    return convert({**fields, "results": _flat_each(fields.get("results"), "result")}, BatchResult)


def read_event(payload: bytes) -> Event:
    """Reads an event, what happened beside when it happened.

    Raises:
        Internal: It is not what the contract says.
    """
    return convert(_flat(read_json(payload, dict[str, Any]), "event"), Event)


def read_events(payload: bytes) -> Events:
    """Reads a page of events.

    Raises:
        Internal: It is not what the contract says.
    """
    fields = _flat(read_json(payload, dict[str, Any]), "result")
    return convert({**fields, "events": _flat_each(fields.get("events"), "event")}, Events)


def read_json(payload: bytes, kind: type[T]) -> T:
    """Reads JSON as `kind`.

    Raises:
        Internal: It is not what the contract says.
    """
    try:
        return msgspec.json.decode(payload, type=kind)
    except msgspec.DecodeError as error:
        raise unreadable(kind, error) from error


def read_map(payload: bytes) -> dict[str, Any]:
    """Reads a map of CBOR.

    Raises:
        Internal: It is none.
    """
    # Without a hook a tagged byte string comes as it is, with every version of cbor2.
    try:
        fields = cbor2.loads(payload)
    except (cbor2.CBORDecodeError, ValueError) as error:
        raise Internal(f"the daemon sent CBOR that cannot be read: {error}") from error
    if not isinstance(fields, dict):
        raise Internal("the daemon sent CBOR that is not a map")
    return cast("dict[str, Any]", fields)


def convert(fields: object, kind: type[T]) -> T:
    """Reads what was decoded already as `kind`.

    Raises:
        Internal: It is not what the contract says.
    """
    try:
        return msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        raise unreadable(kind, error) from error


def _flat(fields: dict[str, Any], name: str) -> dict[str, Any]:
    """Puts what is within the field `name` beside what is around it."""
    within = fields.pop(name, None)
    # Neither has a field of the other's; if one ever has, the one around it stands.
    return {**within, **fields} if isinstance(within, dict) else fields


def _flat_each(items: object, name: str) -> object:
    if not isinstance(items, list):
        return items
    return [_flat(item, name) if isinstance(item, dict) else item for item in items]


def unreadable(kind: type[object], error: Exception) -> Internal:
    """The error when what a daemon sent is no `kind`."""
    name = getattr(kind, "__name__", str(kind))
    return Internal(f"the daemon sent a {name} that cannot be read: {error}")
