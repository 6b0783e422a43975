"""The swarm of an environment: reset, advance and reward.

Directions are in the goal's frame: (1, 0) is along the goal, (0, 1) to its left.
"""

from __future__ import annotations

import contextlib
import copy
import math
import uuid
import weakref
from collections import deque
from collections.abc import Mapping
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from .._arguments import ids as ids_of
from .._client import Client, connect
from .._controller import Controller
from .._draw import Camera
from .._errors import (
    Conflict,
    IncorrectState,
    InvalidArgument,
    JostleError,
    NotFound,
    Unavailable,
    invalid,
)
from .._local import local
from .._state import State
from .._swarm import Swarm
from .._wire import Spec, Status
from ._checks import ResetNeeded, at_least_1, finite, positive
from ._picture import Pixels, paint

_CONTROLLER = "env"
# Publishing takes time, and usually no client subscribes.
_PUBLISH_EVERY = 50

# Seeds are below this.
_SEED_LIMIT = 2**53

# What is pickled.
_ARGUMENTS = frozenset(
    (
        *("n", "informed", "goal", "max_weight", "max_steps", "spec", "_steps_per_action"),
        *("_camera", "_steered", "_endpoint", "_is_closed"),
    )
)

_CLOSED = "this environment is closed: make another one"
_CHANGED = "another client changed the swarm: call `reset`"
_NOT_RESET = "no episode has begun: call `reset` first"
_IN_USE = "another thread steps this environment: give each thread one of its own"


class World:
    """A swarm on a daemon, private unless an endpoint is given; `reset` creates it.

    It does not connect before, so that a process that has made a `World` may be forked. A pickled
    one has its arguments and no episode. A deep copy, or `fork`, has the episode: its swarm is a
    fork on the same daemon, which exists until it or the one that it was copied from is closed.

    Attributes:
        n: The size of the group.
        informed: Number of informed individuals.
        goal: The direction in which the group is to go, radians.
        max_weight: The weight of a preference of length 1.
        max_steps: Number of actions of an episode.
        spec: The spec of the swarm.
    """

    def __init__(
        self,
        n: SupportsIndex,
        informed: SupportsIndex,
        *,
        steers_all: bool,
        goal: float,
        max_weight: float,
        steps_per_action: SupportsIndex,
        max_steps: SupportsIndex,
        render_mode: str | None,
        endpoint: str | None,
        spec: Mapping[str, Any],
    ) -> None:
        for field in ("n", "seed"):
            if field in spec:
                raise invalid(field, f"{field!r} is not part of `spec`")
        try:
            self.spec = Spec(n=at_least_1("n", n), **{"publish_every": _PUBLISH_EVERY, **spec})
        except TypeError as error:
            raise InvalidArgument(f"no such argument, nor field of `Spec`: {error}") from error
        self.n = self.spec.n
        self.informed = at_least_1("informed", informed)
        if self.informed > self.n:
            raise invalid("informed", f"{self.informed} informed of {self.n}")
        self.goal = finite("goal", goal)
        self.max_weight = positive("max_weight", max_weight)
        self.max_steps = at_least_1("max_steps", max_steps)
        self._steps_per_action = at_least_1("steps_per_action", steps_per_action)
        if render_mode not in (None, "rgb_array"):
            raise invalid(
                "render_mode", f"`render_mode` is {render_mode!r}: use 'rgb_array' or None"
            )
        self._camera = None if render_mode is None else Camera()
        # The individuals that it may inform.
        self._steered = range(self.n if steers_all else self.informed)
        self._endpoint = endpoint
        self._is_closed = False
        self._detach()

    def _detach(self) -> None:
        """Sets everything that another process cannot have."""
        self._name = f"env-{uuid.uuid4().hex}"
        self._client: Client | None = None
        self._swarm: Swarm | None = None
        self._controller: Controller | None = None
        self._state: State | None = None
        self._hash = ""
        self._began_at = 0.0
        self._actions = 0
        self._is_advancing = False
        if self._camera is not None:
            self._camera = Camera()
        # The one that this was forked from, whose client it uses.
        self._parent: World | None = None
        # Those that were forked from this one.
        self._copies: weakref.WeakSet[World] = weakref.WeakSet()
        # The swarms of copies that nothing references; one for all copies of copies.
        self._dropped: deque[str] = deque()
        self._at_drop: weakref.finalize[[str], World] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name in _ARGUMENTS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._detach()

    def __deepcopy__(self, memo: object) -> World:
        return self.fork()

    @property
    def has_begun(self) -> bool:
        """Whether there is an episode."""
        return self._state is not None

    @property
    def state(self) -> State:
        """The present state.

        Raises:
            IncorrectState: The environment is closed, or another thread steps it.
            ResetNeeded: No episode has begun.
        """
        if self._is_closed:
            raise IncorrectState(_CLOSED)
        if self._is_advancing:
            raise IncorrectState(_IN_USE)
        if self._state is None:
            raise ResetNeeded(_NOT_RESET)
        return self._state

    @property
    def is_over(self) -> bool:
        """Whether the episode has ended."""
        return self._actions >= self.max_steps

    def check_in_progress(self) -> None:
        """Checks that an episode has begun and has not ended.

        Raises:
            IncorrectState: The environment is closed, or another thread steps it.
            ResetNeeded: It has not begun, or has ended.
        """
        _ = self.state
        if self.is_over:
            raise ResetNeeded("the episode is over: call `reset`")

    def reset(self, seed: int) -> None:
        """Begins an episode; creates the swarm or the private daemon again if it is missing.

        Raises:
            IncorrectState: The environment is closed.
            InvalidArgument: The daemon rejects the spec.
            Unavailable: The daemon does not start, or is disconnected.
        """
        if self._is_closed:
            raise IncorrectState(_CLOSED)
        self._state = None
        try:
            self._begin(seed)
        except NotFound:
            self._swarm = self._controller = None
            self._begin(seed)
        except Unavailable:
            if self._endpoint is not None or self._client is None:
                raise
            self._release()
            self._begin(seed)

    def _begin(self, seed: int) -> None:
        self._delete_dropped()
        if self._swarm is None:
            self._swarm = self._create()
        if self._controller is None:
            self._controller = self._join(self._swarm)
        self._hash = self._swarm.reset(seed).state_hash
        self._state = self._controller.sync()
        self._began_at = self._along(self._state)
        self._actions = 0
        self._is_advancing = False
        if self._camera is not None:
            self._camera = Camera()

    def fork(self) -> World:
        """A copy with the same present and, by the same actions, the same future.

        Without an episode it has the arguments only.

        Raises:
            Conflict: Another client changed the swarm.
            IncorrectState: The environment is closed.
            Unavailable: The daemon is disconnected.
        """
        if self._is_closed:
            raise IncorrectState(_CLOSED)
        copied = World.__new__(World)
        copied.__setstate__(self.__getstate__())
        if self._swarm is None or self._state is None:
            return copied
        self._delete_dropped()
        swarm = self._swarm.fork(copied._name)
        try:
            controller = self._join(swarm)
            self._check_unchanged(swarm.status())
        except BaseException:
            with contextlib.suppress(JostleError):
                swarm.delete()
            raise
        copied._parent, copied._client, copied._dropped = self, self._client, self._dropped
        copied._swarm, copied._controller = swarm, controller
        copied._state, copied._hash = self._state, self._hash
        copied._began_at, copied._actions = self._began_at, self._actions
        copied._camera = copy.deepcopy(self._camera)
        self._copies.add(copied)
        # Nothing is sent while objects are collected.
        copied._at_drop = weakref.finalize(copied, self._dropped.append, copied._name)
        copied._at_drop.atexit = False
        return copied

    def advance(self, ids: NDArray[np.intp], preference: NDArray[np.float64]) -> float:
        """Sets the preferences of `ids`, shape (k, 2), advances, and returns the drift meanwhile.

        Raises:
            Conflict: Another client stepped or reset the swarm.
            IncorrectState: No episode has begun, or it has ended.
            InvalidArgument: The daemon rejects the weight.
            Unavailable: The daemon is disconnected.
        """
        before = self.state
        self.check_in_progress()
        assert self._controller is not None
        direction, weight = self._set_points(preference)
        # Without a reply the state is unknown.
        self._state = None
        self._is_advancing = True
        try:
            advanced = self._controller.advance(
                self._steps_per_action, ids=ids, direction=direction, weight=weight, state=True
            )
        finally:
            self._is_advancing = False
        after = advanced.state
        if not advanced.complete:
            raise Conflict(_CHANGED, step=advanced.step)
        self._state, self._hash = after, advanced.state_hash
        self._actions += 1
        return (self._along(after) - self._along(before)) / (after.time - before.time)

    def info(self) -> dict[str, Any]:
        """The `info` of an observation; a new dictionary."""
        state = self.state
        moved = self._along(state) - self._began_at
        return {
            "state_hash": self._hash,
            "step": state.step,
            "time": state.time,
            "order": state.order.order,
            "drift": moved / state.time if state.time else 0.0,
        }

    def render(self) -> Pixels | None:
        """A picture of the group; None without a `render_mode`."""
        return None if self._camera is None else paint(self.state, self.spec.pi1, self._camera)

    def close(self) -> None:
        """Deletes the swarm and stops the private daemon; a second call does nothing."""
        self._is_closed = True
        self._release()

    def _release(self) -> None:
        # A private daemon ends with all of its swarms.
        is_daemon_ours = self._parent is None and self._endpoint is None
        for copied in list(self._copies):
            copied._is_closed = True
            if is_daemon_ours and copied._client is self._client:
                copied._forget()
            else:
                copied._release()
        client, swarm = self._client, self._swarm
        parent = self._parent
        if client is not None and not is_daemon_ours:
            # The daemon may be disconnected.
            with contextlib.suppress(JostleError):
                if swarm is not None:
                    swarm.delete()
            with contextlib.suppress(JostleError):
                self._delete_dropped()
        self._forget()
        if client is not None and parent is None:
            client.close()

    def _forget(self) -> None:
        """Forgets the swarm, and those that were forked from it."""
        for copied in list(self._copies):
            copied._is_closed = True
            copied._forget()
        self._client = self._swarm = self._controller = self._state = self._parent = None
        if self._at_drop is not None:
            self._at_drop.detach()
        self._copies.clear()
        self._dropped = deque()

    def _check_unchanged(self, copied: Status) -> None:
        if copied.state_hash != self._hash:
            raise Conflict(_CHANGED, step=copied.step)

    def _delete_dropped(self) -> None:
        """Deletes the swarms of copies that were not closed, and that nothing references."""
        while self._client is not None and self._dropped:
            with contextlib.suppress(NotFound):
                self._client.swarm(self._dropped[0]).delete()
            self._dropped.popleft()

    def _create(self) -> Swarm:
        if self._client is None:
            self._client = local() if self._endpoint is None else connect(self._endpoint)
        return self._client.create(self._name, self.spec)

    def _join(self, swarm: Swarm) -> Controller:
        return swarm.join(_CONTROLLER, select=ids_of(self._steered))

    def _along(self, state: State) -> float:
        """The position of the group's centroid along the goal, body sizes."""
        x, y = state.position.mean(axis=0)
        return float(x) * math.cos(self.goal) + float(y) * math.sin(self.goal)

    def _set_points(
        self, preference: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Directions and weights of preferences in the goal's frame."""
        length = np.minimum(np.hypot(preference[:, 0], preference[:, 1]), 1.0)
        direction = self.goal + np.arctan2(preference[:, 1], preference[:, 0])
        weight: NDArray[np.float64] = length * self.max_weight
        return np.where(length > 0.0, direction, 0.0), weight


def draw_seed(random: np.random.Generator) -> int:
    """A seed of a swarm."""
    return int(random.integers(_SEED_LIMIT))
