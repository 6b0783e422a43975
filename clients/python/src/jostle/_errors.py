"""The one tree of errors: everything this package raises on purpose is a `JostleError`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import msgspec


class ErrorMessage(msgspec.Struct, frozen=True, kw_only=True):
    """An error as the wire has it: what an answer raises, and what an event tells as `error`.

    Attributes:
        code: The kind of error, such as `conflict`.
        message: For people: what is wrong and what to do.
        details: For programs, such as `field` and `range`; may be empty.
        step: The swarm's step when it happened; None if it was about no swarm.
    """

    code: str
    message: str
    details: dict[str, Any]
    step: int | None = None


class JostleError(Exception):
    """A request was refused, failed, or found nobody to answer it.

    Attributes:
        code: The wire's word for the kind of error; the same for every instance of a subclass.
        message: For people: what is wrong and what to do.
        details: For programs, such as `field` and `range`; may be empty.
        step: The swarm's step when it happened; None if it was about no swarm, or is not known.
    """

    code: str = "error"

    def __init__(
        self,
        message: str,
        *,
        details: Mapping[str, Any] | None = None,
        step: int | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.details: dict[str, Any] = dict(details or {})
        self.step = step


class NotFound(JostleError):
    """No such swarm, or no such individual, noun or verb."""

    code = "not_found"


class AlreadyExists(JostleError):
    """The name is taken by a swarm with another spec, or by any unless `exist_ok`."""

    code = "already_exists"


class InvalidArgument(JostleError):
    """The request is wrong, whatever the swarm's state; `details["field"]` says where."""

    code = "invalid_argument"


class IncorrectState(JostleError):
    """The request is right, but not in this phase."""

    code = "incorrect_state"


class ResourceExhausted(JostleError):
    """A limit of the daemon."""

    code = "resource_exhausted"


class Busy(JostleError):
    """Too much at once, and still so after asking again until the deadline."""

    code = "busy"


class Conflict(JostleError):
    """The swarm is not at the step or epoch that is expected, or a request's id is taken."""

    code = "conflict"


class Contested(JostleError):
    """Several daemons hold this name: all but one must be stopped or discard their swarm.

    `details["nodes"]` names the daemons.
    """

    code = "contested"


class PermissionDenied(JostleError):
    """Not with these rights; the daemon is there and does not answer."""

    code = "permission_denied"


class StorageFull(JostleError):
    """The daemon's disk is full."""

    code = "storage_full"


class DeadlineExceeded(JostleError):
    """Not done in time; the work goes on, `step` says how far it was."""

    code = "deadline_exceeded"


class Faulted(JostleError):
    """The swarm faulted meanwhile; it keeps its last good state."""

    code = "faulted"


class Internal(JostleError):
    """A defect of the daemon, or an answer that this package cannot read."""

    code = "internal"


class Unavailable(JostleError):
    """Nobody is there: no daemon answers, or it went away."""

    code = "unavailable"


_BY_CODE: dict[str, type[JostleError]] = {
    kind.code: kind
    for kind in (
        NotFound,
        AlreadyExists,
        InvalidArgument,
        IncorrectState,
        ResourceExhausted,
        Busy,
        Conflict,
        Contested,
        PermissionDenied,
        StorageFull,
        DeadlineExceeded,
        Faulted,
        Internal,
    )
}


# How the daemon says which JSON value it got instead of another.
_UNEXPECTED = re.compile(r"(?<=invalid type: )(null|boolean `(?:true|false)`)(?=, expected )")
_WORDS = {"null": "None", "true": "True", "false": "False"}


def _in_python(message: str, details: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The same with Python's words for JSON's: `None`, `True` and `False`.

    Only the daemon's description of a value and the permitted range are translated, not names or
    texts that the caller gave.
    """

    def translate(text: str) -> str:
        # What stands in quotes is a text.
        parts = re.split(r'("[^"]*")', text)
        words = re.compile(r"\b(null|true|false)\b")
        parts[::2] = [words.sub(lambda word: _WORDS[word[0]], part) for part in parts[::2]]
        return "".join(parts)

    message = _UNEXPECTED.sub(lambda it: translate(it[0]), message)
    expected = details.get("range")
    if isinstance(expected, str):
        details = {**details, "range": translate(expected)}
        message = message.replace(f": give {expected}", f": give {details['range']}")
    return message, details


def read_error(payload: bytes) -> JostleError | None:
    """Reads the error that a daemon sent; None if it is not one of a daemon's.

    A code this version does not know becomes a plain `JostleError` with that `code`, so that an
    older client can meet a newer daemon.
    """
    try:
        said = msgspec.json.decode(payload, type=ErrorMessage)
    except msgspec.DecodeError:
        return None
    kind = _BY_CODE.get(said.code, JostleError)
    message, details = _in_python(said.message, said.details)
    error = kind(message, details=details, step=said.step)
    error.code = said.code
    return error
