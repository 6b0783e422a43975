"""A controller: a client that steers individuals of a swarm."""

from __future__ import annotations

import contextlib
import itertools
import math
import threading
import time
import uuid
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, Self, SupportsIndex, Unpack, cast, overload

import msgspec
import zenoh
from numpy.typing import ArrayLike

from . import _cancel
from ._arguments import check_name, check_seconds, id_list, ids, numbers, to_json, whole
from ._commands import MAX_TIMEOUT_SECS
from ._controller_messages import Advanced, Arrived, read_advanced, with_state
from ._decode import read_reply
from ._errors import (
    Conflict,
    DeadlineExceeded,
    IncorrectState,
    InvalidArgument,
    JostleError,
    NotFound,
    invalid,
    late,
)
from ._options import Options
from ._session import Session
from ._state import State, fetch_state, read_state
from ._wire import ControllerList, ControllerSummary, JoinResult, Mode, News, Reply

# Advances that a crash of the daemon may take back. They are dropped when they are durable, a few
# milliseconds later, so that there are this many only if the daemon's disk is full.
_MAX_UNSAVED = 10_000
# The interval of checks whether a cancelled call has ended.
_POLL_INTERVAL_SECS = 0.002


@dataclass(frozen=True, slots=True)
class _Request:
    """An advance: its request id, the step it is for, its arguments as JSON, and their steps."""

    request_id: str
    step: int
    args: bytes
    steps: int


@dataclass(frozen=True, slots=True)
class _Unsaved:
    """An advance that is not durable yet, and its result."""

    request: _Request
    reached: int
    state_hash: str


class Controller:
    """A controller that has joined a swarm; `Swarm.join` makes one.

        with swarm.join("ada", jostle.ids([0, 1])) as ada:
            for heading in np.linspace(0.0, np.pi, 100):
                state = ada.advance(direction=heading, state=True).state

    Leaving its `with` block leaves the swarm. One thread or task at a time may use it: `advance`,
    `put` and `sync` raise `IncorrectState` while another one of them is executed; `cancel` and
    `leave` end it. It holds a liveliness token while it has joined: when its process ends or its
    connection breaks, the daemon removes it, and the other controllers continue.

    In lock-step every `advance` is executed once and is for one step, `step`. After a restart of
    the daemon `advance` continues: the client sends the advances again that a crash took back.
    After a missed deadline `advance` raises `Conflict` or `NotFound`, and `sync` resumes.
    """

    def __init__(
        self, session: Session, swarm: str, name: str, terms: dict[str, Any], options: Options
    ) -> None:
        self._session = session
        self._swarm = swarm
        self._name = check_name("controller", name)
        self._terms = terms
        self._token: zenoh.LivelinessToken | None = None
        self._ids: list[int] = []
        # Request ids are a random series and a number, so that no other controller has the same.
        self._series = uuid.uuid4().hex
        self._numbers = itertools.count(1)
        # A controller that rejoins under the same name must begin with a higher number.
        self._sequence = time.time_ns() // 1000
        self._unacknowledged: _Request | None = None
        self._unsaved: deque[_Unsaved] = deque(maxlen=_MAX_UNSAVED)
        self._step = 0
        # Held by the call that is executed, and the event that is set if that call was cancelled.
        self._lock = threading.Lock()
        self._cancelled: threading.Event | None = None
        session.controllers.add(self)
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
        """The ids of the individuals that it steers, ascending; a new list."""
        return list(self._ids)

    @property
    def step(self) -> int:
        """The step that the next `advance` is for."""
        return self._step

    @property
    def epoch(self) -> int:
        """The epoch in the last reply."""
        return self._epoch

    @property
    def news(self) -> News:
        """Missed deadlines, departures and removed individuals in the last reply."""
        return self._news

    def __repr__(self) -> str:
        return f"Controller({self._name!r} of {self._swarm!r} at {self._session.endpoint})"

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
        """Advances the swarm, and returns when every controller in lock-step has advanced.

            state = ada.advance(direction=[0.0, 0.5], weight=2.0, state=True).state

        Args:
            steps: Number of steps: 1 to 10⁹; one exchange for all of them.
            ids: The individuals that the set-points are for, shape (m,); None is all that it
                steers, in the order of `ids`.
            direction: Preferred directions from the next step on, shape (m,) or one for all,
                radians, counter-clockwise from +x. None changes no set-point.
            weight: Weights of the directions beside attraction, eq. (4), shape (m,) or one for all:
                0 is uninformed; None is `pi2`.
            turn: Beyond the paper, requires `driving`: turning rates in place of the model's,
                radians per time unit, shape (m,) or one for all; the daemon limits them to
                `pi3 * (1 + largest weight)`. NaN is the model's.
            speed: Beyond the paper, requires `driving`: factors of the free speed, 0 to 1, shape
                (m,) or one for all. NaN is the model's.
            state: Return the state reached, as `state` of the result.
            timeout: Seconds it may take; None is an hour, since the other controllers have
                deadlines. A daemon that does not reply has two more seconds, and the client's
                `timeout` to reconnect.

        Returns:
            The step reached: `steps` further, unless a `pause` or a `reset` ended it before; then
            `complete` is False.

        Raises:
            Conflict: The swarm is not at `step`: it stepped without this controller, or was reset.
                The error's `step` is the swarm's; nothing has changed, and `sync` resumes. Or it
                still takes the steps of an earlier advance: `cancel` ends them. Or, with
                `state`: the advance was executed, but the reply was lost, the daemon sent it again
                without its state (it stores replies of at most 4 KiB), and the swarm had changed.
            DeadlineExceeded: Other controllers or the steps take longer than `timeout`. The advance
                remains, and the same call waits for it; `cancel` gives it up. A different one
                replaces it while the swarm waits for another controller, and raises `Conflict`
                while the swarm steps.
            IncorrectState: It joined in mode `free_running`, which uses `put`; or another thread
                uses it.
            InvalidArgument: A number is out of range, or an individual is not its own. Without
                `ids`, individuals that another client removed are left out; `news` reports them.
            NotFound: It has left, since its connection broke or it was late (see the message);
                `sync` rejoins.
            Unavailable: The daemon is not back within the client's `timeout`. A call with the same
                arguments resumes.
        """
        with self._alone():
            return self._advance_alone(
                steps, ids, direction, weight, turn, speed, state=state, timeout=timeout
            )

    def _advance_alone(
        self,
        steps: SupportsIndex,
        ids: Iterable[SupportsIndex] | None,
        direction: ArrayLike | None,
        weight: ArrayLike | None,
        turn: ArrayLike | None,
        speed: ArrayLike | None,
        *,
        state: bool,
        timeout: float | None,
    ) -> Advanced:
        self._check_mode("lockstep", "`put`")
        args: dict[str, Any] = {"controller": self._name}
        count = whole("steps", steps)
        if count != 1:
            args["steps"] = count
        if direction is not None:
            args["set"] = self._set_points(ids, direction, weight, turn, speed)
        elif not (ids is None and weight is None and turn is None and speed is None):
            raise invalid(
                "set.direction",
                "`ids`, `weight`, `turn` and `speed` have no effect without a `direction`",
            )
        if state:
            args["return"] = "state"
        seconds = MAX_TIMEOUT_SECS if timeout is None else check_seconds("timeout", timeout)
        try:
            request, advanced = self._advance(args, seconds)
        except InvalidArgument as error:
            if not _is_not_claimed(error):
                raise
            if ids is not None:
                raise InvalidArgument(
                    f"{error.message}; if it was removed, `sync()` updates `ids`",
                    details=error.details,
                    step=error.step,
                ) from error
            # Another client has removed individuals: the rejected advance has changed nothing.
            self._leave_out_removed(args)
            request, advanced = self._advance(args, seconds)
        self._unacknowledged = None
        self._update(advanced)
        self._step = advanced.step
        while self._unsaved and self._unsaved[0].reached <= advanced.durable_step:
            self._unsaved.popleft()
        if advanced.steps > 0 and advanced.step > advanced.durable_step:
            self._unsaved.append(_Unsaved(request, advanced.step, advanced.state_hash))
        if state and advanced.state is None:
            # The reply was lost, and the one that the daemon stored has no state. In lock-step the
            # swarm waits for this controller.
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
    ) -> int:
        """Publishes set-points for a running swarm, if it joined in mode `free_running`.

            ada.put(direction=0.5, weight=2.0)

        They apply from the swarm's next step on, unless newer ones arrive before. There is no
        reply: `Puts` in `Swarm.controllers` counts the outcomes.

        Args:
            ids: The individuals, shape (m,); None is all that it steers, in the order of `ids`.
            direction: Preferred directions, shape (m,) or one for all, radians,
                counter-clockwise from +x.
            weight: Weights of the directions beside attraction, shape (m,) or one for all: 0 is
                uninformed; None is `pi2`.
            turn: Turning rates, see `advance`.
            speed: Factors of the free speed, see `advance`.

        Returns:
            The number of these set-points. A published state that contains them has it in
            `State.sequences`, until newer ones are in a state.

        Raises:
            IncorrectState: It joined in lock-step, which uses `advance`, has left, or another
                thread uses it.
            InvalidArgument: They are not numbers, or not as many as individuals.
            Unavailable: The client is closed.
        """
        self._check_mode("free_running", "`advance`")
        if self._token is None:
            raise IncorrectState(f"controller {self._name!r} has left: `sync()` rejoins")
        with self._alone():
            self._sequence += 1
            set_points = self._set_points(ids, direction, weight, turn, speed)
            payload = to_json({"sequence": self._sequence, "set": set_points})
            self._session.put(self._session.swarm_key(self._swarm, f"ctl/{self._name}"), payload)
            return self._sequence

    def sync(self) -> State:
        """Resumes after a `Conflict` or a `NotFound`, and returns the present state.

        If it has left, it rejoins on the same terms and steers those of its individuals that
        exist. The next advance is for the step of the returned state.

        Raises:
            Conflict: Another controller steers one of them.
            IncorrectState: Another thread uses it.
            NotFound: There is no such swarm.
        """
        with self._alone():
            return self._sync()

    def _sync(self) -> State:
        mine = self._listed()
        state = read_state(self._get("state"))
        if mine is not None:
            self._ids = mine.ids
        else:
            existing = set(state.id.tolist())
            select = ids(one for one in self._ids if one in existing)
            self._join({**self._terms, "select": select, "again": True}, {})
            state = read_state(self._get("state"))
        self._unacknowledged = None
        self._unsaved.clear()
        self._step, self._epoch = state.step, state.epoch
        return state

    def cancel(self) -> State:
        """Gives up the advance that has no reply, and returns the present state.

        The swarm takes no further steps for that advance, and waits for this controller again; the
        steps that it has taken and the set-points remain. Without such an advance it is `sync`.

        Raises:
            NotFound: There is no such swarm.
        """
        listed = read_reply(self._get("get/controllers"), ControllerList)
        mine = next((one for one in listed.controllers if one.controller == self._name), None)
        target = None if mine is None else mine.target_step
        is_pending = target is not None and target > listed.step
        if mine is not None and (is_pending or self._unacknowledged is not None):
            # A controller that joins again keeps its individuals, and has not advanced.
            terms = {name: value for name, value in self._terms.items() if name != "select"}
            self._join({**terms, "again": True}, {})
        return self._sync()

    def leave(self, **options: Unpack[Options]) -> Reply:
        """Leaves the swarm. Its individuals are uninformed, unless `on_timeout` is `hold`.

        Args:
            options: See `Options`.

        Raises:
            NotFound: It has left already.
        """
        try:
            args = {"controller": self._name}
            return self._session.swarm_command(self._swarm, "leave", args, Reply, **options)
        finally:
            self._drop_token()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        # It may have left already; and an error of the block is not replaced by one of leaving.
        with contextlib.suppress(NotFound if error is None else JostleError):
            if self._token is not None:
                self.leave()

    def _join(self, terms: dict[str, Any], options: Options) -> None:
        if self._token is None:
            key = self._session.swarm_key(self._swarm, f"ctl/{self._name}/alive")
            self._token = self._session.declare_token(key)
        args = {"controller": self._name, **terms}
        joined = self._session.swarm_command(self._swarm, "join", args, JoinResult, **options)
        self._ids, self._step = joined.ids, joined.step
        self._update(joined)

    def _drop_token(self) -> None:
        token, self._token = self._token, None
        if token is not None:
            # A closed session has undeclared the token.
            with contextlib.suppress(zenoh.ZError):
                token.undeclare()

    def _update(self, reply: JoinResult | Advanced) -> None:
        self._news, self._epoch = reply.news, reply.epoch
        if reply.news.removed:
            gone = set(reply.news.removed)
            self._ids = [one for one in self._ids if one not in gone]

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Lets one call at a time into its body, since calls read and write the step.

        A call that was cancelled ends soon: the next one waits for it.

        Raises:
            IncorrectState: Another call is executed.
        """
        while not self._lock.acquire(blocking=False):
            if self._cancelled is None or not self._cancelled.is_set():
                raise IncorrectState(
                    f"controller {self._name!r} is used by another thread or task: let that end, "
                    "or join one controller for each"
                )
            _cancel.sleep(_POLL_INTERVAL_SECS)
        canceller = _cancel.current.get()
        self._cancelled = None if canceller is None else canceller.event
        try:
            yield
        finally:
            # The event stays until the next call: without it, that call would not wait.
            self._lock.release()

    def _check_mode(self, mode: Mode, other: str) -> None:
        joined: Mode = self._terms["mode"]
        if joined != mode:
            raise IncorrectState(
                f"controller {self._name!r} joined in mode {joined}: use {other}, or join in mode "
                f"{mode}"
            )

    def _advance(self, args: dict[str, Any], seconds: float) -> tuple[_Request, Advanced]:
        """Sends an advance for the present step; returns it and its reply."""
        request = self._unacknowledged
        # A call that repeats an advance without a reply repeats its request id.
        payload = msgspec.json.encode(args)
        if request is None or (request.step, request.args) != (self._step, payload):
            request_id = f"{self._series}-{next(self._numbers)}"
            request = self._unacknowledged = _Request(
                request_id, self._step, payload, args.get("steps", 1)
            )
        try:
            return request, self._execute(request, seconds)
        except DeadlineExceeded as error:
            remedy = "the advance remains, and the same call waits for it"
            raise late("not advanced", seconds, remedy, error) from error

    def _leave_out_removed(self, args: dict[str, Any]) -> None:
        """Leaves the individuals that the controller does not steer any more out of set-points."""
        mine = self._listed()
        kept = set() if mine is None else set(mine.ids)
        points: dict[str, list[Any]] = args.pop("set")
        keeps = [one in kept for one in points["ids"]]
        if any(keeps):
            args["set"] = {
                name: list(itertools.compress(column, keeps)) for name, column in points.items()
            }

    def _listed(self) -> ControllerSummary | None:
        """The daemon's record of this controller; None if it has left."""
        listed = read_reply(self._get("get/controllers"), ControllerList).controllers
        return next((one for one in listed if one.controller == self._name), None)

    def _explain(self, error: Conflict) -> None:
        """Raises the error of an advance for another step than the swarm's, with its remedy.

        Raises:
            Conflict: It is that error.
        """
        if error.details.get("field") not in ("expect_step", "controller"):
            return
        try:
            mine = self._listed()
        except JostleError:
            mine = None
        target = None if mine is None else mine.target_step
        if target is not None and error.step is not None and target > error.step:
            message = (
                f"the swarm is at step {error.step} and steps to {target}, as an earlier advance "
                "permits: `cancel()` ends that, and resumes"
            )
        else:
            message = (
                f"the swarm is at step {error.step}, not {self._step}: it was reset, or stepped "
                "without this controller, which missed a deadline or whose name another process "
                "has taken; `sync()` resumes"
            )
        raise Conflict(message, details=error.details, step=error.step) from error

    def _execute(self, request: _Request, seconds: float) -> Advanced:
        """Sends an advance until it is replied to, also by a restarted daemon.

        That is safe with any daemon: another one has no controller of this name, and rejects it.
        """
        is_behind = False
        # The daemon that received the unsaved advances again: once is enough.
        resent_to: frozenset[str] | None = None
        while True:
            try:
                if is_behind:
                    is_behind = False
                    self._catch_up(seconds)
                return self._send(request, seconds)
            except Conflict as error:
                is_behind = error.step is not None and error.step < self._step
                daemon = self._session.connected()
                if not is_behind or not self._unsaved or daemon == resent_to:
                    self._explain(error)
                    raise
                resent_to = daemon

    def _catch_up(self, seconds: float) -> None:
        """Sends the unsaved advances again after a crash of the daemon.

        The daemon executes those that the crash took back, and repeats its reply to the others.
        All are kept until they are durable, since the daemon may crash again.
        """
        for before in list(self._unsaved):
            advanced = self._send(before.request, seconds)
            if advanced.state_hash != before.state_hash:
                self._unsaved.clear()
                raise Conflict(
                    "the daemon was restarted, and the other controllers do not repeat their "
                    f"advances: step {before.reached} has another state now. Call `sync` to resume",
                    step=advanced.step,
                )

    def _send(self, request: _Request, seconds: float) -> Advanced:
        payload = self._session.command(
            self._session.swarm_key(self._swarm, "cmd/advance"),
            msgspec.Raw(request.args),
            swarm=self._swarm,
            expect_step=request.step,
            timeout=seconds,
            request_id=request.request_id,
            is_safe=True,
        )
        return read_advanced(payload, request.steps)

    def _set_points(
        self,
        ids: Iterable[SupportsIndex] | None,
        direction: ArrayLike,
        weight: ArrayLike | None,
        turn: ArrayLike | None,
        speed: ArrayLike | None,
    ) -> dict[str, Any]:
        chosen = self._ids if ids is None else id_list("set.ids", ids)
        if ids is not None and not chosen:
            raise invalid("set.ids", "`ids` is empty: leave it out for all that it steers")
        points: dict[str, Any] = {
            "ids": chosen,
            "direction": _column("direction", direction, len(chosen)),
        }
        if weight is not None:
            points["weight"] = _column("weight", weight, len(chosen))
        for name, driven in (("turn", turn), ("speed", speed)):
            if driven is not None:
                column = _column(name, driven, len(chosen), may_be_nan=True)
                points[name] = [None if math.isnan(value) else value for value in column]
        return points

    def _get(self, rest: str) -> bytes:
        return self._session.get(self._session.swarm_key(self._swarm, rest), swarm=self._swarm)


def _is_not_claimed(error: InvalidArgument) -> bool:
    """Whether set-points were for an individual that no controller steers."""
    details = error.details
    return "controller" in details and details["controller"] is None


def _column(name: str, values: ArrayLike, length: int, *, may_be_nan: bool = False) -> list[float]:
    """A number for each of `length` individuals.

    Raises:
        InvalidArgument: They are not finite numbers, or not as many.
    """
    field = f"set.{name}"
    column = numbers(name, values, field)
    if column.ndim > 0 and column.shape != (length,):
        raise invalid(
            field,
            f"{name} has shape {column.shape}, not ({length},) as there are ids, nor is it one "
            "number",
        )
    points = cast("list[float]", column.tolist() if column.ndim > 0 else [float(column)] * length)
    # For a few numbers this is faster than NumPy.
    is_fine = all(map(math.isfinite, points))
    if not is_fine and (not may_be_nan or any(map(math.isinf, points))):
        raise invalid(field, f"{name} holds a number that is not finite")
    return points
