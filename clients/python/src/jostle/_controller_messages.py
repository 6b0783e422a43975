"""Messages to controllers, as msgspec structs."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from ._decode import convert, read_map, unreadable
from ._errors import Internal
from ._messages import Reply, StepResult
from ._repr import HtmlStruct
from ._state import State, read_columns

Mode = Literal["lockstep", "free_running"]
"""Whether the swarm steps when every controller has advanced, or runs by itself."""

OnTimeout = Literal["hold", "free", "pause"]
"""What happens to the individuals of a controller that is late."""


class Miss(HtmlStruct, frozen=True, kw_only=True):
    """A missed deadline.

    Attributes:
        controller: The controller that missed it.
        step: The step at which the swarm waited.
        misses: Number of misses in a row: with the third the controller has left.
    """

    controller: str
    step: int
    misses: int


class Departed(HtmlStruct, frozen=True, kw_only=True):
    """A controller that has left.

    Attributes:
        controller: Its name.
        why: `left`: it sent `leave`; `lost`: its liveliness token was undeclared; `late`: it missed
            three deadlines in a row, or sent nothing for `max_idle_secs`.
    """

    controller: str
    why: Literal["left", "lost", "late"]


class News(HtmlStruct, frozen=True, kw_only=True):
    """What happened since the last reply to a controller.

    Attributes:
        missed: Missed deadlines, also its own.
        left: Controllers that have left.
        removed: Ids of individuals of its own that were removed.
    """

    missed: list[Miss]
    left: list[Departed]
    removed: list[int]


class Joined(Reply, frozen=True, kw_only=True):
    """The reply to `join`.

    Attributes:
        ids: The ids of the individuals that the controller steers.
        news: What happened since it left, if it rejoins.
    """

    ids: list[int]
    news: News


class Advanced(StepResult, frozen=True, kw_only=True):
    """The reply to `Controller.advance`.

    Attributes:
        complete: Whether the swarm took all the steps that were requested. False if it was paused
            or reset before: by another client, for a late controller, or by a condition.
        news: What happened since the last reply to this controller.
        state: The state reached, if it was requested.
    """

    complete: bool
    news: News
    state: State | None = None


class Arrived(Advanced, frozen=True, kw_only=True):
    """The reply to `Controller.advance` with `state=True`."""

    state: State


class Puts(HtmlStruct, frozen=True, kw_only=True):
    """Numbers of the messages of `Controller.put`, by outcome.

    Attributes:
        applied: They were applied.
        stale: They were not newer than one before, or of another epoch.
        overtaken: A newer one arrived before the next step.
        refused: They were unreadable, out of range, not permitted, or for individuals of another
            controller.
    """

    applied: int
    stale: int
    overtaken: int
    refused: int


class ControllerSummary(HtmlStruct, frozen=True, kw_only=True):
    """A controller that has joined.

    Attributes:
        controller: Its name.
        mode: `lockstep` or `free_running`.
        ids: The ids of the individuals that it steers.
        deadline_secs: Seconds that others wait for it, or that its set-points apply.
        on_timeout: What happens to its individuals when it is late.
        driving: Whether it may set turning rates and speeds.
        target_step: The step that it has advanced to; None unless in lock-step.
        misses: Number of deadlines missed in a row.
        waited_secs: Seconds that others have waited for it; None if they do not.
        puts: The outcomes of its puts.
    """

    controller: str
    mode: Mode
    ids: list[int]
    deadline_secs: float
    on_timeout: OnTimeout
    driving: bool
    target_step: int | None = None
    misses: int
    waited_secs: float | None = None
    puts: Puts


class Controllers(Reply, frozen=True, kw_only=True):
    """The controllers that have joined a swarm, by name."""

    controllers: list[ControllerSummary]


class _Result(msgspec.Struct, kw_only=True):
    steps: int
    durable_step: int
    state_hash: str
    news: News


class _Envelope(Reply, frozen=True, kw_only=True):
    """The reply to `advance` as on the wire: decoding it directly is the fastest."""

    result: _Result


_decoder = msgspec.json.Decoder(_Envelope)


def read_advanced(payload: bytes, requested: int) -> Advanced:
    """Reads the reply to an `advance` of `requested` steps, and the state in it if it is CBOR.

    Raises:
        Internal: It is not as the contract defines.
    """
    if payload.startswith(b"{"):
        try:
            return Advanced(**_fields(_decoder.decode(payload), requested))
        except msgspec.DecodeError as error:
            raise unreadable(Advanced, error) from error
    fields = read_map(payload)
    envelope = convert(fields, _Envelope)
    state = fields["result"].get("state")
    if not isinstance(state, dict):
        raise Internal("the daemon's reply has no state")
    return Arrived(
        **_fields(envelope, requested), state=read_columns(state, envelope.result.state_hash)
    )


def with_state(advanced: Advanced, state: State) -> Arrived:
    """The same reply with its state."""
    return Arrived(**{**msgspec.structs.asdict(advanced), "state": state})


def _fields(envelope: _Envelope, requested: int) -> dict[str, Any]:
    return {
        "complete": envelope.result.steps >= requested,
        "swarm": envelope.swarm,
        "epoch": envelope.epoch,
        "step": envelope.step,
        "time": envelope.time,
        "phase": envelope.phase,
        "seq": envelope.seq,
        "steps": envelope.result.steps,
        "durable_step": envelope.result.durable_step,
        "state_hash": envelope.result.state_hash,
        "news": envelope.result.news,
    }
