"""What controllers are told, as msgspec structs."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from ._errors import Internal
from ._messages import Phase, Reply, StepResult
from ._reading import convert, read_map, unreadable
from ._show import Shown
from ._state import State, read_columns

Mode = Literal["lockstep", "free_running"]
"""How a controller takes part: the swarm steps when all have advanced, or runs by itself."""

OnTimeout = Literal["hold", "free", "pause"]
"""What becomes of the individuals of a controller that is late."""


class Miss(Shown, frozen=True, kw_only=True):
    """A deadline that fired.

    Attributes:
        controller: Whose.
        step: The step at which the swarm waited.
        misses: How many it has missed in a row: with the third it has left.
    """

    controller: str
    step: int
    misses: int


class Departed(Shown, frozen=True, kw_only=True):
    """A controller that has left.

    Attributes:
        controller: Which.
        why: It said so, its liveliness token went, or it missed three deadlines in a row.
    """

    controller: str
    why: Literal["left", "lost", "late"]


class News(Shown, frozen=True, kw_only=True):
    """What a controller is told beside the step reached: what came about since it last was.

    Attributes:
        missed: Deadlines that fired, its own too.
        left: Controllers that have left.
        removed: Individuals of its own that were removed.
    """

    missed: list[Miss]
    left: list[Departed]
    removed: list[int]


class Joined(Reply, frozen=True, kw_only=True):
    """What `join` did.

    Attributes:
        ids: Whom the controller steers, by id.
        news: What came about since it was last there, if it comes back.
    """

    ids: list[int]
    news: News


class Advanced(StepResult, frozen=True, kw_only=True):
    """Where a swarm has come to with the advance of a controller.

    Attributes:
        news: What came about since this controller was last told.
        state: The state reached, if it was asked for.
    """

    news: News
    state: State | None = None


class Arrived(Advanced, frozen=True, kw_only=True):
    """Where a swarm has come to, with the state reached."""

    state: State


class Puts(Shown, frozen=True, kw_only=True):
    """What became of the set-points that a controller put while the swarm ran.

    Attributes:
        applied: Applied.
        stale: Not newer than one before, or of another epoch.
        overtaken: By a newer one before the next step.
        refused: Unreadable, out of range, not permitted, or about individuals that are not its
            own.
    """

    applied: int
    stale: int
    overtaken: int
    refused: int


class ControllerSummary(Shown, frozen=True, kw_only=True):
    """A controller that has joined.

    Attributes:
        controller: Its name.
        mode: How it takes part.
        ids: Whom it steers.
        deadline_secs: How long others wait for it, or how long its set-points hold.
        on_timeout: What becomes of its individuals when it is late.
        driving: Whether it may drive its individuals directly.
        target_step: The step that it has advanced to; None unless in lock-step.
        misses: Deadlines missed in a row.
        waited_secs: For how long others have waited for it; None if they do not.
        puts: What became of its puts.
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
    """All that have joined a swarm, by name."""

    controllers: list[ControllerSummary]


class _Result(msgspec.Struct, kw_only=True):
    steps: int
    durable_step: int
    state_hash: str
    news: News


class _Envelope(msgspec.Struct, kw_only=True):
    """An answer to `advance` as it crosses the wire: read as it is, it costs the least."""

    swarm: str
    epoch: int
    step: int
    time: float
    phase: Phase
    seq: int
    result: _Result


_decoder = msgspec.json.Decoder(_Envelope)


def read_advanced(payload: bytes) -> Advanced:
    """Reads the answer to `advance`, with the state within it if it is CBOR.

    Raises:
        Internal: It is not what the contract says.
    """
    if payload.startswith(b"{"):
        try:
            return Advanced(**_fields(_decoder.decode(payload)))
        except msgspec.DecodeError as error:
            raise unreadable(Advanced, error) from error
    fields = read_map(payload)
    told = convert(fields, _Envelope)
    state = fields["result"].get("state")
    if not isinstance(state, dict):
        raise Internal("the daemon's answer holds no state")
    return Arrived(**_fields(told), state=read_columns(state, told.result.state_hash))


def with_state(advanced: Advanced, state: State) -> Arrived:
    """The same answer with its state."""
    fields = {name: getattr(advanced, name) for name in advanced.__struct_fields__}
    return Arrived(**{**fields, "state": state})


def _fields(told: _Envelope) -> dict[str, Any]:
    return {
        "swarm": told.swarm,
        "epoch": told.epoch,
        "step": told.step,
        "time": told.time,
        "phase": told.phase,
        "seq": told.seq,
        "steps": told.result.steps,
        "durable_step": told.result.durable_step,
        "state_hash": told.result.state_hash,
        "news": told.result.news,
    }
