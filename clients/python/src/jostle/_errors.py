"""The errors of this package, all subclasses of `JostleError`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import msgspec

from ._wire import ErrorMessage


class JostleError(Exception):
    """A request was rejected, failed, or had no reply; the base class of all errors.

        try:
            swarm.set(pi1=0.5)
        except jostle.InvalidArgument as error:
            print(error.details["field"], error.details["range"])

    Attributes:
        code: The code of the error on the wire; the same for every instance of a subclass.
        message: For people: what is wrong, and the remedy.
        details: For programs, such as `field` and `range`; may be empty.
        step: The swarm's step at that time; None if it concerns no swarm, or is not known.
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
    """There is no such swarm, individual, noun or verb."""

    code = "not_found"


class AlreadyExists(JostleError):
    """The name is taken by a swarm with another spec, or by any unless `exist_ok`."""

    code = "already_exists"


class InvalidArgument(JostleError, ValueError):
    """An argument is invalid in every state of the swarm; `details["field"]` names it.

    Also a `ValueError`.
    """

    code = "invalid_argument"


class IncorrectState(JostleError):
    """The request is valid, but not in the swarm's present phase or state."""

    code = "incorrect_state"


class ResourceExhausted(JostleError):
    """A limit of the daemon is reached."""

    code = "resource_exhausted"


class Busy(JostleError):
    """The daemon executed nothing at any attempt to send the request until its timeout.

    It was overloaded. If `details["reason"]` is "recovering", it has not yet recovered its swarms
    after a start; `details["swarms_left"]` is their number.
    """

    code = "busy"


class Conflict(JostleError):
    """The swarm is not at the expected step or epoch, or the id is that of another request.

    Or another version of the model, `details["model_version"]`, computed the steps or the runs.
    """

    code = "conflict"


class Contested(JostleError):
    """Several daemons have a swarm of this name: stop all but one, or `discard` their swarms.

    `details["nodes"]` names the daemons.
    """

    code = "contested"


class PermissionDenied(JostleError):
    """The daemon is connected and does not permit the request to this client."""

    code = "permission_denied"


class StorageFull(JostleError):
    """The daemon's disk is full."""

    code = "storage_full"


class DeadlineExceeded(JostleError, TimeoutError):
    """The request takes longer than its timeout; it continues, and `step` is its progress.

    Also a `TimeoutError`, without an `errno`.
    """

    code = "deadline_exceeded"


class Faulted(JostleError):
    """The swarm faulted during the request; it keeps its last good state."""

    code = "faulted"


class Internal(JostleError):
    """A defect of the daemon, or a message that this package cannot read."""

    code = "internal"


class Unavailable(JostleError, ConnectionError):
    """No daemon has answered within the timeout, or it ended while it executed a command.

    Also a `ConnectionError`, without an `errno`.
    """

    code = "unavailable"


# The daemon sends every one but `Unavailable`, which only this package raises.
_BY_CODE = {kind.code: kind for kind in JostleError.__subclasses__() if kind is not Unavailable}


def late(what: str, seconds: float, remedy: str, error: DeadlineExceeded) -> DeadlineExceeded:
    """The daemon's error with the caller's timeout: it may be for the last of several attempts."""
    message = f"{what} within {seconds:g} s: {remedy}"
    details = {**error.details, "after_secs": seconds}
    return DeadlineExceeded(message, details=details, step=error.step)


def invalid(field: str, message: str) -> InvalidArgument:
    """The error for an argument; `details["field"]` names it."""
    return InvalidArgument(message, details={"field": field})


# How the daemon describes a JSON value of the wrong type.
_UNEXPECTED = re.compile(r"(?<=invalid type: )(null|boolean `(?:true|false)`)(?=, expected )")
_WORDS = {"null": "None", "true": "True", "false": "False"}


# Requests and fields of the wire in the daemon's remedies, and their names in this package.
_REMEDIES = {
    "the node's get/swarms lists what there is": "`client.swarms()` lists them",
    "the node's get/experiments lists the experiments": "`client.experiments()` lists them",
    "the node's get/recordings lists the recordings": "`client.recordings()` lists them",
    "`jostle when NAME` lists them, and `jostle when NAME --cancel ID` removes one": (
        "`Swarm.status().conditions` lists them, and `Swarm.when(cancel=True, id=...)` removes one"
    ),
    "`jostle status` lists them": "`Swarm.status().waits` lists them",
    "`jostle when NAME` lists those that do": "`Swarm.status().conditions` lists those that do",
    "set exist_ok to use it": "pass `exist_ok=True` to use it",
    "set make_room to": "pass `make_room=True` to",
    "or set `again` if": "or pass `again=True` if",
    "`jostle experiment run --again FILE` executes": "`submit` with `again=True` executes",
    "join with `driving`": "join with `driving=True`",
    "look at get/journal": "look at `Swarm.journal`",
}


def _in_python(message: str, details: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Replaces JSON's `null`, `true` and `false`, and requests of the wire, by Python's words.

    Only the daemon's description of a value and the permitted range are translated, not names or
    texts of the caller.
    """

    def translate(text: str) -> str:
        # Quoted parts are texts.
        parts = re.split(r'("[^"]*")', text)
        words = re.compile(r"\b(null|true|false)\b")
        parts[::2] = [words.sub(lambda word: _WORDS[word[0]], part) for part in parts[::2]]
        return "".join(parts)

    message = _UNEXPECTED.sub(lambda it: translate(it[0]), message)
    # The end of a run, which may have been given as a time.
    message = re.sub(
        r"^until_step (\d+) is in the past", r"the end, step \1, is in the past", message
    )
    for remedy, here in _REMEDIES.items():
        message = message.replace(remedy, here)
    expected = details.get("range")
    if isinstance(expected, str):
        details = {**details, "range": translate(expected)}
        message = message.replace(f": give {expected}", f": give {details['range']}")
    return message, details


def read_error(payload: bytes) -> JostleError | None:
    """Reads the error of a daemon; None if the payload is not one.

    An unknown code becomes a `JostleError` with that `code`: the daemon may be newer.
    """
    try:
        sent = msgspec.json.decode(payload, type=ErrorMessage)
    except msgspec.DecodeError:
        return None
    kind = _BY_CODE.get(sent.code, JostleError)
    message, details = _in_python(sent.message, sent.details)
    error = kind(message, details=details, step=sent.step)
    error.code = sent.code
    return error
