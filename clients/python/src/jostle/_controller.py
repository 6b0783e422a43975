"""A controller: a program that steers some individuals of a swarm, in lock-step or beside it."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
import uuid
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self, SupportsIndex, Unpack, cast, overload

import msgspec
import numpy as np
import zenoh
from numpy.typing import ArrayLike

from ._arguments import Select, check_name, check_seconds, ids, to_json, whole
from ._commands import PATIENT_SECS, Options
from ._errors import (
    Conflict,
    InvalidArgument,
    JostleError,
    NotFound,
    PermissionDenied,
    Unavailable,
)
from ._exchange import (
    Advanced,
    Arrived,
    Controllers,
    Joined,
    Mode,
    News,
    OnTimeout,
    read_advanced,
    with_state,
)
from ._link import Link
from ._messages import Reply
from ._patience import Patience
from ._reading import read_reply
from ._state import State, fetch_state, read_state

# What a daemon that crashed may have forgotten. Of what it has on the disk nothing is kept, and it
# is some milliseconds behind, so that there are so many only if the disk is full.
_MOST_ANSWERED = 10_000


@dataclass(frozen=True, slots=True)
class _Request:
    """An advance: what it is called, the step it is made for, and what it asks."""

    request_id: str
    step: int
    args: bytes


@dataclass(frozen=True, slots=True)
class _Answered:
    """An advance that a crash of the daemon may still take back, and where it led."""

    request: _Request
    reached: int
    state_hash: str


class Controller:
    """A controller that has joined a swarm; `Swarm.join` makes one.

    Leaving its `with` block has it leave. It is for one thread at a time. Its liveliness token
    stands from before it joins until it leaves: when its process ends or its link is cut, the
    daemon notices, and the others go on without it.

    In lock-step every `advance` is carried out once and made for a certain step, `step`. When the
    daemon is started again it goes on as if nothing had been: what a crash took back is advanced
    anew, as it was. When it has been late or has left, `advance` raises `Conflict` or `NotFound`,
    and `sync` gets it in line again.
    """

    def __init__(
        self, link: Link, swarm: str, name: str, terms: dict[str, Any], options: Options
    ) -> None:
        self._link = link
        self._swarm = swarm
        self._name = check_name("controller", name)
        self._terms = terms
        self._token: zenoh.LivelinessToken | None = None
        self._ids: list[int] = []
        # What it sends bears the numbers of one series, and is apart from that of any other.
        self._series = uuid.uuid4().hex
        self._numbers = itertools.count(1)
        # One that comes back under the same name goes on from a higher number.
        self._sequence = time.time_ns() // 1000
        self._unanswered: _Request | None = None
        self._answered: deque[_Answered] = deque(maxlen=_MOST_ANSWERED)
        self._step = 0
        link.controllers.add(self)
        try:
            self._join(terms, options)
        except BaseException:
            self._drop_token()
            raise

    @property
    def name(self) -> str:
        """Its name."""
        return self._name

    @property
    def swarm(self) -> str:
        """The name of the swarm that it steers."""
        return self._swarm

    @property
    def ids(self) -> list[int]:
        """Whom it steers, ascending; a new list."""
        return list(self._ids)

    @property
    def step(self) -> int:
        """The step that it takes the swarm to be at, and makes its next advance for."""
        return self._step

    @property
    def epoch(self) -> int:
        """The epoch it last heard of."""
        return self._epoch

    @property
    def news(self) -> News:
        """What it was last told beside the step: who was late, who has left, who was removed."""
        return self._news

    def __repr__(self) -> str:
        return f"Controller({self._name!r} of {self._swarm!r} at {self._link.endpoint})"

    @overload
    def advance(
        self,
        steps: SupportsIndex = 1,
        *,
        ids: Iterable[SupportsIndex] | None = None,
        direction: ArrayLike | None = None,
        weight: ArrayLike | None = None,
        turn: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        state: Literal[True],
        timeout: float | None = None,
    ) -> Arrived: ...
    @overload
    def advance(
        self,
        steps: SupportsIndex = 1,
        *,
        ids: Iterable[SupportsIndex] | None = None,
        direction: ArrayLike | None = None,
        weight: ArrayLike | None = None,
        turn: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        state: bool = False,
        timeout: float | None = None,
    ) -> Advanced: ...
    def advance(
        self,
        steps: SupportsIndex = 1,
        *,
        ids: Iterable[SupportsIndex] | None = None,
        direction: ArrayLike | None = None,
        weight: ArrayLike | None = None,
        turn: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        state: bool = False,
        timeout: float | None = None,
    ) -> Advanced:
        """Lets the swarm step, and returns when it has: when every other controller let it too.

        Args:
            steps: How many: 1 to 10⁹; one exchange for all of them.
            ids: Whom `direction` is for; None is all that it steers, in the order of `ids`.
            direction: Preferred directions from the next step on, shape (m,) or one for all,
                radians, counter-clockwise from +x. None, and whoever is not named: as before.
            weight: How much each counts beside attraction, shape (m,) or one for all: 0 is
                uninformed; None is `pi2`.
            turn: Beyond the paper, if it joined with `driving`: turning rates in place of the
                model's, shape (m,) or one for all, at most the fastest free one; NaN is as by
                itself.
            speed: The same with factors of the free speed, 0 to 1.
            state: Have the state reached in the answer, as its `state`.
            timeout: Seconds it may take; None is an hour, since the others have deadlines. A
                daemon that does not answer at all has two more, and the client's `timeout` to come
                back.

        Returns:
            Where it arrived: that many steps on, unless another command came between.

        Raises:
            Conflict: The swarm is not at `step`: it went on without this controller, or was
                reset. The error's `step` is the right one; nothing has changed, and `sync` gets
                in line again. With `state` also when the reply was lost, the daemon sent it again
                without the state (more than 4 KiB are not remembered), and the swarm had changed;
                the advance was carried out then.
            DeadlineExceeded: The others take longer than `timeout`; the advance stands.
            InvalidArgument: A number is out of range, or somebody is not its own.
            NotFound: It has left: its link was cut or it was late, as the message says. `sync`
                joins again.
            Unavailable: The daemon does not come back within the client's `timeout`. Called
                again with the same arguments it goes on where it was.
        """
        args: dict[str, Any] = {"controller": self._name}
        if steps != 1:
            args["steps"] = whole("steps", steps)
        if direction is not None:
            args["set"] = self._set_points(ids, direction, weight, turn, speed)
        elif not (ids is None and weight is None and turn is None and speed is None):
            raise InvalidArgument(
                "`ids`, `weight`, `turn` and `speed` say nothing without a `direction`",
                details={"field": "set.direction"},
            )
        if state:
            args["return"] = "state"
        seconds = PATIENT_SECS if timeout is None else check_seconds("timeout", timeout)
        request = self._unanswered
        # What was not answered and is asked for again is the same exchange.
        payload = msgspec.json.encode(args)
        if request is None or (request.step, request.args) != (self._step, payload):
            request_id = f"{self._series}-{next(self._numbers)}"
            request = self._unanswered = _Request(request_id, self._step, payload)
        advanced = self._carry_out(request, seconds)
        self._unanswered = None
        self._heard(advanced)
        self._step = advanced.step
        while self._answered and self._answered[0].reached <= advanced.durable_step:
            self._answered.popleft()
        if advanced.steps > 0 and advanced.step > advanced.durable_step:
            self._answered.append(_Answered(request, advanced.step, advanced.state_hash))
        if state and advanced.state is None:
            # The reply was lost, and the one that the daemon remembered has no state. In lock-step
            # the swarm waits for this controller.
            return with_state(advanced, fetch_state(self._get, advanced))
        return advanced

    def put(
        self,
        *,
        ids: Iterable[SupportsIndex] | None = None,
        direction: ArrayLike,
        weight: ArrayLike | None = None,
        turn: ArrayLike | None = None,
        speed: ArrayLike | None = None,
    ) -> None:
        """Puts set-points for a swarm that runs, if it joined in mode `free_running`.

        They apply at the swarm's next step, unless newer ones come before. There is no answer:
        `Swarm.controllers` counts what became of them.

        Args:
            ids: Whom; None is all that it steers, in the order of `ids`.
            direction: Preferred directions, shape (m,) or one for all, radians,
                counter-clockwise from +x.
            weight: How much each counts beside attraction, shape (m,) or one for all: 0 is
                uninformed; None is `pi2`.
            turn: Turning rates, see `advance`.
            speed: Factors of the free speed, see `advance`.

        Raises:
            InvalidArgument: They are no numbers, or not as many as individuals.
            Unavailable: The client is closed.
        """
        self._sequence += 1
        set_points = self._set_points(ids, direction, weight, turn, speed)
        payload = to_json({"sequence": self._sequence, "set": set_points})
        self._link.put(self._link.swarm_key(self._swarm, f"ctl/{self._name}"), payload)

    def sync(self) -> State:
        """Gets in line again after a `Conflict` or a `NotFound`, and returns the state as it is.

        If it has left it joins again, on the same terms, to steer whom it did and who is still
        there. Its next advance is made for the step of that state.

        Raises:
            Conflict: Another controller steers one of them by now.
            NotFound: The swarm is gone.
        """
        listed = read_reply(self._get("get/controllers"), Controllers).controllers
        mine = [one for one in listed if one.controller == self._name]
        state = read_state(self._get("state"))
        if mine:
            self._ids = mine[0].ids
        else:
            there = set(state.id.tolist())
            select = ids(one for one in self._ids if one in there)
            self._join({**self._terms, "select": select, "again": True}, {})
            state = read_state(self._get("state"))
        self._unanswered = None
        self._answered.clear()
        self._step, self._epoch = state.step, state.epoch
        return state

    def leave(self, **options: Unpack[Options]) -> Reply:
        """Leaves. Whom it steered is uninformed, unless it joined to `hold` them.

        Args:
            options: See `Options`.

        Raises:
            NotFound: It has left already.
        """
        try:
            payload = self._link.command(
                self._link.swarm_key(self._swarm, "cmd/leave"),
                {"controller": self._name},
                swarm=self._swarm,
                **options,
            )
        finally:
            self._drop_token()
        return read_reply(payload, Reply)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # Who has left already is out, and what went wrong before says more than what does now.
        with contextlib.suppress(NotFound if error is None else JostleError):
            if self._token is not None:
                self.leave()

    def _join(self, terms: dict[str, Any], options: Options) -> None:
        if self._token is None:
            key = self._link.swarm_key(self._swarm, f"ctl/{self._name}/alive")
            self._token = self._link.declare_token(key)
        payload = self._link.command(
            self._link.swarm_key(self._swarm, "cmd/join"),
            {"controller": self._name, **terms},
            swarm=self._swarm,
            **options,
        )
        joined = read_reply(payload, Joined)
        self._ids, self._step = joined.ids, joined.step
        self._heard(joined)

    def _drop_token(self) -> None:
        token, self._token = self._token, None
        if token is not None:
            # With the session the token is gone already.
            with contextlib.suppress(zenoh.ZError):
                token.undeclare()

    def _heard(self, told: Joined | Advanced) -> None:
        self._news, self._epoch = told.news, told.epoch
        if told.news.removed:
            gone = set(told.news.removed)
            self._ids = [one for one in self._ids if one not in gone]

    def _carry_out(self, request: _Request, seconds: float) -> Advanced:
        """Sends an advance until it is answered, also by a daemon that was started again.

        That is safe with any daemon: another one knows no controller of this name, and refuses.
        """
        patience: Patience | None = None
        is_behind = False
        # Each daemon needs to be told only once of what the one before was told.
        told: frozenset[str] | None = None
        while True:
            try:
                if is_behind:
                    is_behind = False
                    self._catch_up(seconds)
                return self._send(request, seconds)
            except Conflict as error:
                is_behind = error.step is not None and error.step < self._step
                daemon = self._link.connected()
                if not is_behind or not self._answered or daemon == told:
                    raise
                told, patience = daemon, None
            except (Unavailable, NotFound, PermissionDenied) as error:
                is_silence = isinstance(error, Unavailable) or error.details.get("is_silence")
                if not is_silence or not self._link.is_open():
                    raise
                # So it sounds while a daemon is being started again.
                told = None
                patience = patience or Patience(time.monotonic(), seconds, self._link.timeout)
                patience.pause(error)

    def _catch_up(self, seconds: float) -> None:
        """Advances anew what a crash took back.

        What it did not take back is not carried out again, but answered as it was. All of it is
        kept until it is on the disk, as the next crash may come before that.
        """
        for before in list(self._answered):
            advanced = self._send(before.request, seconds)
            if advanced.state_hash != before.state_hash:
                self._answered.clear()
                raise Conflict(
                    "the daemon was started again, and with what the others do now step "
                    f"{before.reached} is not as it was: `sync` gets in line again",
                    step=advanced.step,
                )

    def _send(self, request: _Request, seconds: float) -> Advanced:
        payload = self._link.command(
            self._link.swarm_key(self._swarm, "cmd/advance"),
            msgspec.Raw(request.args),
            swarm=self._swarm,
            expect_step=request.step,
            timeout=seconds,
            request_id=request.request_id,
        )
        return read_advanced(payload)

    def _set_points(
        self,
        ids: Iterable[SupportsIndex] | None,
        direction: ArrayLike,
        weight: ArrayLike | None,
        turn: ArrayLike | None,
        speed: ArrayLike | None,
    ) -> dict[str, Any]:
        whom = self._ids if ids is None else [whole("set.ids", one) for one in ids]
        points: dict[str, Any] = {
            "ids": whom,
            "direction": _column("direction", direction, len(whom)),
        }
        if weight is not None:
            points["weight"] = _column("weight", weight, len(whom))
        for name, driven in (("turn", turn), ("speed", speed)):
            if driven is not None:
                column = _column(name, driven, len(whom), may_be_nan=True)
                points[name] = [None if math.isnan(value) else value for value in column]
        return points

    def _get(self, rest: str) -> bytes:
        return self._link.get(self._link.swarm_key(self._swarm, rest), swarm=self._swarm)


def terms(
    select: Select | None,
    mode: Mode,
    deadline: float,
    on_timeout: OnTimeout,
    driving: bool,
    again: bool,
) -> dict[str, Any]:
    """What a controller joins with, as the wire has it."""
    terms: dict[str, Any] = {
        "mode": mode,
        "deadline_secs": check_seconds("deadline", deadline),
        "on_timeout": on_timeout,
        "driving": driving,
        "again": again,
    }
    return terms if select is None else {"select": select, **terms}


def _column(name: str, values: ArrayLike, length: int, *, may_be_nan: bool = False) -> list[float]:
    """One number for each of so many individuals.

    Raises:
        InvalidArgument: They are no finite numbers, or not so many.
    """
    field = {"field": f"set.{name}"}
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"{name} is no column of numbers: {error}", details=field) from error
    if column.ndim > 0 and column.shape != (length,):
        raise InvalidArgument(
            f"{name} has shape {column.shape}, not ({length},) as there are ids, nor is it one "
            "number",
            details=field,
        )
    numbers = cast("list[float]", column.tolist() if column.ndim > 0 else [float(column)] * length)
    # For as few as one controller steers this is faster than NumPy's.
    is_fine = all(map(math.isfinite, numbers))
    if not is_fine and (not may_be_nan or any(map(math.isinf, numbers))):
        raise InvalidArgument(f"{name} holds a number that is not finite", details=field)
    return numbers
