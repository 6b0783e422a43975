"""States of a swarm, with columns as NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Generic, TypeVar

import cbor2
import numpy as np
from numpy.typing import NDArray

from ._attachment import Arrival, read_attachment, time_of
from ._decode import convert, read_map, read_reply
from ._draw import Camera, draw
from ._errors import Conflict, Internal
from ._wire import Attachment, Certificate, Order, OrderSample, Phase, Status, StepResult

# How often a state is queried again because another command was applied meanwhile.
_MAX_ATTEMPTS = 10

_AGREED = 0.995
"""The strength from which on the informed agree, as far as two decimals show."""

ORIGIN_UNIT = 1024.0
"""The unit of an origin, body sizes."""

# RFC 8746: the tag of a byte string with the elements of a column, and their type.
_TYPED_ARRAYS: dict[Any, tuple[int, np.dtype[Any]]] = {
    NDArray[np.uint32]: (70, np.dtype("<u4")),
    NDArray[np.float64]: (86, np.dtype("<f8")),
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class State:
    """The state of a swarm at one step: n individuals as columns, ordered by id.

        state = swarm.state()
        speed = np.column_stack((np.cos(state.alpha), np.sin(state.alpha))).mean(axis=0)

    The columns are read-only views of the message; copy one to change it. States compare by
    identity.

    Attributes:
        swarm: The swarm's name.
        epoch: Increases when `step` does not continue what was published before.
        frame: Number of published states.
        step: Number of steps since the start.
        time: `step · dt`, body sizes over free speed.
        phase: The phase of the swarm.
        origin: Two integers: the point that `x` and `y` are relative to, in units of 1024 body
            sizes.
        id: Shape (n,), uint32; an id is never reused.
        x: Shape (n,), body sizes, relative to the origin.
        y: Shape (n,), body sizes, relative to the origin.
        alpha: Shape (n,), headings in radians, counter-clockwise from +x, never wrapped.
        weight: Shape (n,), weights of the preferred directions; 0 for the uninformed.
        direction: Shape (n,), preferred directions in radians; 0 for the uninformed.
        order: Order and drift.
        certificate: The accuracy of the state.
        state_hash: BLAKE3 in hexadecimal, of a state that `step` returned; else None.
        skipped: In `for state in swarm.states()`: number of published states between the previous
            one and this, which the loop was too slow for or which were lost.
        pi1: Length over width of a body; None if it is not known. Pictures show it.
        attachment: The times of a state that a stream received, and the set-points in it; None of
            any other state, and from an older daemon. `stepped_at`, `published_at` and `sequences`
            are its contents.
        received_unix_nanos: When this process received it from a stream, nanoseconds since 1970,
            UTC; None of any other state.
    """

    swarm: str
    epoch: int
    frame: int
    step: int
    time: float
    phase: Phase
    origin: tuple[int, int]
    id: NDArray[np.uint32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    alpha: NDArray[np.float64]
    weight: NDArray[np.float64]
    direction: NDArray[np.float64]
    order: Order
    certificate: Certificate
    state_hash: str | None = None
    skipped: int = 0
    pi1: float | None = None
    attachment: Attachment | None = None
    received_unix_nanos: int | None = None

    @property
    def stepped_at(self) -> datetime | None:
        """When the step that led here was taken, by the daemon's clock: an aware datetime, UTC.

        None if that is not known: in a state that was queried or that a command returned, before
        the first step, after a reset or a restart of the daemon until the next one, and in a
        playback.
        """
        return None if self.attachment is None else time_of(self.attachment.stepped_unix_nanos)

    @property
    def published_at(self) -> datetime | None:
        """When the daemon published it, by its clock: an aware datetime, UTC.

        None in a state that was queried or that a command returned, and from an older daemon.
        """
        return None if self.attachment is None else time_of(self.attachment.published_unix_nanos)

    @property
    def latency(self) -> float | None:
        """Seconds from its publication until this process received it; None as `published_at`.

        It includes the difference of the clocks of two machines, and may then be negative.
        """
        published = None if self.attachment is None else self.attachment.published_unix_nanos
        received = self.received_unix_nanos
        return None if published is None or received is None else (received - published) / 1e9

    @property
    def sequences(self) -> Mapping[str, int]:
        """The numbers of the newest set-points in it, by controller, as `Controller.put` returned.

        Empty of controllers in lock-step, and where `published_at` is None.
        """
        return {} if self.attachment is None else self.attachment.sequences

    @property
    def n(self) -> int:
        """The size of the group."""
        return len(self.id)

    @property
    def position(self) -> NDArray[np.float64]:
        """Absolute positions, shape (n, 2), body sizes; a new array.

        Far from (0, 0) they are less precise than `x` and `y`.
        """
        return np.column_stack((self.x, self.y)) + ORIGIN_UNIT * np.array(self.origin, float)

    @property
    def informed(self) -> NDArray[np.bool_]:
        """Which individuals are informed, shape (n,), bool."""
        return self.weight > 0.0

    def _repr_html_(self) -> str:
        return draw_state(self)

    def __repr__(self) -> str:
        return (
            f"State({self.swarm!r}, epoch={self.epoch}, step={self.step}, time={self.time:g}, "
            f"phase={self.phase!r}, n={self.n}, order={self.order.order:.3f})"
        )


def _drift(order: Order) -> str:
    """The drift and its direction, and how far the informed agree unless they do."""
    text = ""
    if order.drift is not None and order.direction is not None:
        text = f", drift {order.drift:+z.2f} along {order.direction:z.2f} rad"
    strength = order.direction_strength
    if strength is not None and strength < _AGREED:
        text += f", the informed disagree: strength {strength:.2f}"
    return text


def draw_state(state: State, camera: Camera | None = None) -> str:
    """A picture of a state as HTML; `camera` follows the group."""
    informed = int(state.informed.sum())
    caption = [
        f"{state.swarm}, {state.phase}",
        f"step {state.step}, t = {state.time:g}",
        f"{state.n} individual{'s' if state.n > 1 else ''}"
        + (f", {informed} informed" if informed else ""),
        f"order {state.order.order:.2f}" + _drift(state.order),
    ]
    columns = (state.position, state.alpha, state.informed, state.direction)
    return draw(*columns, state.pi1, " · ".join(caption), camera)


def read_state(payload: bytes) -> State:
    """Reads a state from CBOR.

    Raises:
        Internal: It is not as the contract defines.
    """
    return read_columns(read_map(payload))


def read_step_reply(payload: bytes) -> tuple[StepResult, State | None]:
    """Reads the reply to `step`, and the state in it.

    The state is None if the daemon stored the reply without it: the reply is then JSON.

    Raises:
        Internal: It is not as the contract defines.
    """
    if payload.startswith(b"{"):
        return read_reply(payload, StepResult), None
    fields = read_map(payload)
    within = fields.pop("result", None)
    if not isinstance(within, dict) or not isinstance(within.get("state"), dict):
        raise Internal("the daemon's reply has no state")
    result = convert({**within, **fields}, StepResult)
    return result, read_columns(within["state"], result.state_hash)


def fetch_state(get: Callable[[str], bytes], result: StepResult) -> State:
    """Queries the state that a stored reply omits, if the swarm is still in it.

    Args:
        get: Queries the swarm, see `Queries._get`.
        result: The reply.

    Raises:
        Conflict: The swarm has changed since.
        Internal: It is not as the contract defines.
    """
    # If no command was applied between two statuses, the state between them is theirs.
    for _ in range(_MAX_ATTEMPTS):
        before = read_reply(get("get/status"), Status)
        state = read_state(get("state"))
        status = read_reply(get("get/status"), Status)
        if before.seq == status.seq:
            break
    is_same = before.seq == status.seq and state.step == status.step == result.step
    if not is_same or status.state_hash != result.state_hash:
        raise Conflict(
            f"the command was executed and led to step {result.step}, but its reply with the "
            f"state was lost, and the swarm has changed since: it is at step {status.step}",
            step=status.step,
        )
    return replace(state, state_hash=result.state_hash)


def read_columns(fields: Mapping[str, Any], state_hash: str | None = None) -> State:
    """Makes a state of decoded fields; `state_hash` is from the reply around it.

    Raises:
        Internal: It is not as the contract defines.
    """
    own = {"state_hash": state_hash, "skipped": 0, "attachment": None, "received_unix_nanos": None}
    state = convert({**fields, **own}, State, _column)
    columns = (state.id, state.x, state.y, state.alpha, state.weight, state.direction)
    lengths = {len(column) for column in columns}
    if len(lengths) > 1:
        raise Internal(f"the daemon sent a state whose columns have lengths {sorted(lengths)}")
    return state


def _column(kind: Any, column: object) -> NDArray[Any]:
    tag, dtype = _TYPED_ARRAYS[kind]
    if not isinstance(column, cbor2.CBORTag) or column.tag != tag:
        raise ValueError(f"not a typed array of tag {tag}")
    return np.frombuffer(column.value, dtype)


S = TypeVar("S", bound=State | OrderSample)


class FrameReader(Generic[S]):
    """Drops messages that are older than the previous one, and counts skipped frames.

    `first` queries the present frame.
    """

    def __init__(self, read: Callable[[bytes], S], first: Callable[[], S | None]) -> None:
        self._read = read
        self._query_first = first
        self._position: tuple[int, int, int] | None = None

    def first(self) -> list[S]:
        """The present frame, if there is one before those that are published."""
        frame = self._query_first()
        return [] if frame is None else self._admit(frame)

    def read(self, payload: bytes, arrival: Arrival | None = None, /) -> list[S]:
        """The frame in `payload`, unless a newer one was read."""
        return self._admit(self._read(payload), arrival)

    def poll(self) -> list[S]:
        """Nothing: a lost frame counts as skipped."""
        return []

    def refresh(self) -> list[S]:
        """The present frame, if there is one before those that are published, and it is new."""
        frame = self._query_first()
        # An earlier frame is one of another swarm of that name.
        if self._position is not None and (
            frame is None or (frame.epoch, frame.step) < self._position[:2]
        ):
            self._position = None
        return [] if frame is None else self._admit(frame)

    def _admit(self, frame: S, arrival: Arrival | None = None) -> list[S]:
        position = (frame.epoch, frame.step, frame.frame)
        if self._position is not None and position <= self._position:
            # Published before the first queried state was taken: received, thus not skipped.
            self._position = (*self._position[:2], max(frame.frame, self._position[2]))
            return []
        skipped = 0 if self._position is None else frame.frame - self._position[2] - 1
        self._position = position
        if isinstance(frame, State):
            received = {} if arrival is None else _of_arrival(arrival)
            return [replace(frame, skipped=max(0, skipped), **received)]
        return [frame]


def _of_arrival(arrival: Arrival) -> dict[str, Any]:
    """The fields of a state that a stream received."""
    return {
        "attachment": read_attachment(arrival.attachment),
        "received_unix_nanos": arrival.unix_nanos,
    }
