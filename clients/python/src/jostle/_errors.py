"""The one tree of errors: everything this package raises on purpose is a `JostleError`."""

from __future__ import annotations

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
        PermissionDenied,
        StorageFull,
        DeadlineExceeded,
        Faulted,
        Internal,
    )
}


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
    error = kind(said.message, details=said.details, step=said.step)
    error.code = said.code
    return error
