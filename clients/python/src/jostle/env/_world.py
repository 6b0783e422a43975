"""A swarm that is reset and advanced, again and again, and what it earns: under both environments.

Whatever has a direction is told in the goal's frame: (1, 0) is along the goal, (0, 1) to its left.
"""

from __future__ import annotations

import contextlib
import math
import uuid
from collections.abc import Mapping
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from .._arguments import ids as ids_of
from .._client import Client, connect
from .._controller import Controller
from .._errors import (
    Conflict,
    IncorrectState,
    InvalidArgument,
    JostleError,
    NotFound,
    Unavailable,
)
from .._local import local
from .._spec import Spec
from .._state import State
from .._swarm import Swarm
from ._checks import at_least_1, finite, positive

_CONTROLLER = "env"
# Nobody watches the swarm of an environment, so that it need not be published often.
_PUBLISH_EVERY = 50

# A seed is a whole number below this.
_SEEDS = 2**53

_CLOSED = "this environment is closed: make another one"
_NOT_RESET = "no episode has begun: call `reset` first"


class World:
    """A swarm on a daemon, private unless an endpoint is given; it is there from `reset` on.

    Nothing is connected before, so that a process may be forked from one that made a `World`.

    Attributes:
        n: The size of the group.
        informed: How many of it are informed.
        goal: The direction in which the group is to go, radians.
        max_weight: The weight of a preference of length 1.
        max_steps: Actions in an episode.
        spec: What the swarm is made from.
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
        endpoint: str | None,
        spec: Mapping[str, Any],
    ) -> None:
        for field in ("n", "seed"):
            if field in spec:
                raise InvalidArgument(f"{field!r} is not part of `spec`", details={"field": field})
        try:
            self.spec = Spec(n=at_least_1("n", n), **{"publish_every": _PUBLISH_EVERY, **spec})
        except TypeError as error:
            raise InvalidArgument(f"no such argument, nor field of `Spec`: {error}") from error
        self.n = self.spec.n
        self.informed = at_least_1("informed", informed)
        if self.informed > self.n:
            raise InvalidArgument(
                f"{self.informed} informed of {self.n}", details={"field": "informed"}
            )
        self.goal = finite("goal", goal)
        self.max_weight = positive("max_weight", max_weight)
        self.max_steps = at_least_1("max_steps", max_steps)
        self._steps_per_action = at_least_1("steps_per_action", steps_per_action)
        # It joins for those that it may ever inform.
        self._steered = range(self.n if steers_all else self.informed)
        self._endpoint = endpoint
        self._is_closed = False
        self._client: Client | None = None
        self._swarm: Swarm | None = None
        self._controller: Controller | None = None
        self._state: State | None = None
        self._hash = ""
        self._began_at = 0.0
        self._actions = 0

    @property
    def state(self) -> State:
        """Where the episode is.

        Raises:
            IncorrectState: None has begun.
        """
        if self._state is None:
            raise IncorrectState(_NOT_RESET)
        return self._state

    @property
    def is_over(self) -> bool:
        """Whether the episode has had all its actions."""
        return self._actions >= self.max_steps

    def check_goes_on(self) -> None:
        """Goes no further unless an episode has begun and is not over.

        Raises:
            IncorrectState: It is so.
        """
        if self._is_closed:
            raise IncorrectState(_CLOSED)
        if self._state is None:
            raise IncorrectState(_NOT_RESET)
        if self.is_over:
            raise IncorrectState("the episode is over: call `reset`")

    def reset(self, seed: int) -> None:
        """Begins an episode; makes anew what is gone, a private daemon or the swarm.

        Raises:
            IncorrectState: The environment is closed.
            InvalidArgument: The daemon does not take the spec.
            Unavailable: The daemon does not start, or is gone.
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
        if self._swarm is None:
            self._swarm = self._create()
        if self._controller is None:
            self._controller = self._swarm.join(_CONTROLLER, select=ids_of(self._steered))
        self._hash = self._swarm.reset(seed).state_hash
        self._state = self._controller.sync()
        self._began_at = self._along(self._state)
        self._actions = 0

    def advance(self, ids: NDArray[np.intp], preference: NDArray[np.float64]) -> float:
        """Gives `ids` their preferences, shape (k, 2), and returns the drift while they had them.

        Raises:
            Conflict: Somebody else stepped or reset the swarm.
            IncorrectState: No episode has begun, or it is over.
            InvalidArgument: The daemon does not take so large a weight.
            Unavailable: The daemon is gone.
        """
        before = self.state
        self.check_goes_on()
        assert self._controller is not None
        direction, weight = self._set_points(preference)
        # Until it is answered nobody knows where the swarm is.
        self._state = None
        advanced = self._controller.advance(
            self._steps_per_action, ids=ids, direction=direction, weight=weight, state=True
        )
        after = advanced.state
        if advanced.steps < self._steps_per_action or after is None:
            raise Conflict("somebody else came between: call `reset`", step=advanced.step)
        self._state, self._hash = after, advanced.state_hash
        self._actions += 1
        return (self._along(after) - self._along(before)) / (after.time - before.time)

    def info(self) -> dict[str, Any]:
        """What is told beside an observation; a new dictionary."""
        state = self.state
        moved = self._along(state) - self._began_at
        return {
            "state_hash": self._hash,
            "step": state.step,
            "time": state.time,
            "order": state.order.order,
            "drift": moved / state.time if state.time else 0.0,
        }

    def close(self) -> None:
        """Deletes the swarm and ends the private daemon; harmless when done already."""
        self._is_closed = True
        self._release()

    def _release(self) -> None:
        self._state = None
        client, self._client = self._client, None
        swarm, self._swarm = self._swarm, None
        self._controller = None
        if client is None:
            return
        if swarm is not None and self._endpoint is not None:
            # A daemon that is gone has nothing left to delete.
            with contextlib.suppress(JostleError):
                swarm.delete()
        client.close()

    def _create(self) -> Swarm:
        if self._client is None:
            self._client = local() if self._endpoint is None else connect(self._endpoint)
        return self._client.create(f"env-{uuid.uuid4().hex}", self.spec)

    def _along(self, state: State) -> float:
        """How far along the goal the group's centre is."""
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
    """A swarm's seed."""
    return int(random.integers(_SEEDS))
