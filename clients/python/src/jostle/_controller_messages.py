"""Messages to controllers, as msgspec structs."""

from __future__ import annotations

from typing import Any

import msgspec

from ._decode import convert, read_map, unreadable
from ._errors import Internal
from ._state import State, read_columns
from ._wire import News, Reply, StepResult


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
