"""States: columns of numbers as NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import cbor2
import msgspec
import numpy as np
from numpy.typing import NDArray

from ._errors import Conflict, Internal
from ._messages import Certificate, Order, OrderSample, Phase, Status, StepResult
from ._reading import convert, read_map, read_reply

# How often a state is fetched anew because commands came between.
_MOST_TRIES = 10

ORIGIN_UNIT = 1024.0
"""An origin counts in units of so many body sizes."""

# RFC 8746: what a byte string with this tag holds, as NumPy writes it.
_U32 = (70, np.dtype("<u4"))
_F64 = (86, np.dtype("<f8"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class State:
    """A swarm at one step: n individuals as columns, ordered by id.

    The columns are views of the message they came in, so they cannot be written to; copy one to
    change it. States compare by identity.

    Attributes:
        swarm: The swarm's name.
        epoch: Grows whenever `step` does not continue what was published before.
        frame: Counts the published states.
        step: The number of steps since the start.
        time: `step · dt`.
        phase: What the swarm is doing.
        origin: Two integers: where `x` and `y` are counted from, in units of 1024 body sizes.
        id: Shape (n,), uint32; never used twice.
        x: Shape (n,), body sizes, relative to the origin.
        y: Shape (n,), body sizes, relative to the origin.
        alpha: Shape (n,), headings in radians, counter-clockwise from +x, never wrapped.
        weight: Shape (n,), of the preferred directions; 0 for the uninformed.
        direction: Shape (n,), preferred directions in radians; 0 for the uninformed.
        order: Order and drift.
        certificate: How exact this state is.
        state_hash: BLAKE3 in hexadecimal, on a state that `step` returned; else None.
        skipped: In `for state in swarm.states()`: how many published states lie between the one
            before and this, because the loop was slower than they came or they were lost.
        pi1: Length over width of a body, as far as is known; pictures are drawn with it.
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

    @property
    def n(self) -> int:
        """The size of the group."""
        return len(self.id)

    @property
    def position(self) -> NDArray[np.float64]:
        """Absolute positions, shape (n, 2), body sizes; a new array.

        Far from home they are coarser than `x` and `y`, which is what the origin is for.
        """
        return np.column_stack((self.x, self.y)) + ORIGIN_UNIT * np.array(self.origin, float)

    @property
    def informed(self) -> NDArray[np.bool_]:
        """Who has a direction of its own, shape (n,)."""
        return self.weight > 0.0

    def _repr_html_(self) -> str:
        # It is made from a state.
        from ._draw import draw

        return draw(self)

    def __repr__(self) -> str:
        return (
            f"State({self.swarm!r}, epoch={self.epoch}, step={self.step}, time={self.time:g}, "
            f"phase={self.phase!r}, n={self.n}, order={self.order.order:.3f})"
        )


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """All of a state but its columns."""

    swarm: str
    epoch: int
    frame: int
    step: int
    time: float
    phase: Phase
    origin: tuple[int, int]
    order: Order
    certificate: Certificate
    # A daemon may come to say it.
    pi1: float | None = None


def read_state(payload: bytes) -> State:
    """Reads a state from CBOR.

    Raises:
        Internal: It is not what the contract says.
    """
    return read_columns(read_map(payload))


def read_step_reply(payload: bytes) -> tuple[StepResult, State | None]:
    """Reads the answer to `step`, and the state within it.

    The state is None where the daemon remembered the answer without it: the answer is then JSON.

    Raises:
        Internal: It is not what the contract says.
    """
    if payload.startswith(b"{"):
        return read_reply(payload, StepResult), None
    fields = read_map(payload)
    within = fields.pop("result", None)
    if not isinstance(within, dict) or not isinstance(within.get("state"), dict):
        raise Internal("the daemon's answer holds no state")
    result = convert({**within, **fields}, StepResult)
    return result, read_columns(within["state"], result.state_hash)


def fetch_state(get: Callable[[str], bytes], result: StepResult) -> State:
    """Queries the state that a remembered reply omits, if the swarm is still at it.

    Args:
        get: Queries the swarm, as `Questions._get`.
        result: The reply.

    Raises:
        Conflict: The swarm has changed since.
        Internal: It is not what the contract says.
    """
    # Where no command came between two statuses, the state between them is theirs.
    for _ in range(_MOST_TRIES):
        before = read_reply(get("get/status"), Status)
        state = read_state(get("state"))
        status = read_reply(get("get/status"), Status)
        if before.seq == status.seq:
            break
    is_same = before.seq == status.seq and state.step == status.step == result.step
    if not is_same or status.state_hash != result.state_hash:
        raise Conflict(
            f"the command was carried out and led to step {result.step}, but its reply with the "
            f"state was lost, and the swarm is at step {status.step} now or was changed",
            step=status.step,
        )
    return replace(state, state_hash=result.state_hash)


def read_columns(fields: Mapping[str, Any], state_hash: str | None = None) -> State:
    """Makes a state of what was decoded already; `state_hash` is from the answer around it.

    Raises:
        Internal: It is not what the contract says.
    """
    head = convert(fields, _Head)
    state = State(
        swarm=head.swarm,
        epoch=head.epoch,
        frame=head.frame,
        step=head.step,
        time=head.time,
        phase=head.phase,
        origin=head.origin,
        id=_column(fields, "id", *_U32),
        x=_column(fields, "x", *_F64),
        y=_column(fields, "y", *_F64),
        alpha=_column(fields, "alpha", *_F64),
        weight=_column(fields, "weight", *_F64),
        direction=_column(fields, "direction", *_F64),
        order=head.order,
        certificate=head.certificate,
        state_hash=state_hash,
        pi1=head.pi1,
    )
    lengths = {len(c) for c in (state.x, state.y, state.alpha, state.weight, state.direction)}
    if lengths != {state.n}:
        raise Internal(f"the daemon sent a state whose columns have lengths {sorted(lengths)}")
    return state


def _column(fields: Mapping[str, Any], name: str, tag: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    column = fields.get(name)
    if not isinstance(column, cbor2.CBORTag) or column.tag != tag:
        raise Internal(f"the daemon sent a state whose {name!r} is no typed array of tag {tag}")
    try:
        return np.frombuffer(column.value, dtype)
    except (TypeError, ValueError) as error:
        raise Internal(f"the daemon sent a state whose {name!r} is cut short: {error}") from error


S = TypeVar("S", bound=State | OrderSample)


class FrameReader(Generic[S]):
    """Lets nothing through that is older than what went before, and counts what was skipped.

    `first` is asked what there is now, and `mark` notes how many frames were skipped before one.
    """

    def __init__(
        self,
        read: Callable[[bytes], S],
        first: Callable[[], S | None],
        mark: Callable[[S, int], S],
    ) -> None:
        self._read = read
        self._ask_first = first
        self._mark = mark
        self._position: tuple[int, int, int] | None = None

    def first(self) -> list[S]:
        """The frame there is now, if one is to come before those published."""
        frame = self._ask_first()
        return [] if frame is None else self._admit(frame)

    def read(self, payload: bytes) -> list[S]:
        """The frame in `payload`, unless a newer one has been seen."""
        return self._admit(self._read(payload))

    def look(self) -> list[S]:
        """Nothing: a frame that was lost is as good as one that was skipped."""
        return []

    def _admit(self, frame: S) -> list[S]:
        position = (frame.epoch, frame.step, frame.frame)
        if self._position is not None and position <= self._position:
            return []
        skipped = 0 if self._position is None else frame.frame - self._position[2] - 1
        self._position = position
        return [self._mark(frame, max(0, skipped))]
