"""The environment for Gymnasium: one agent selects whom to inform, and of which direction."""

from __future__ import annotations

import copy
from typing import Any, Self, SupportsIndex

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from . import _views
from ._checks import check_options, read_action
from ._picture import Pixels
from ._world import World, draw_seed

Floats = NDArray[np.float32]


class ShepherdEnv(gymnasium.Env[Floats, Floats]):
    """A group seen from above; the agent informs a few individuals at a time.

        env = jostle.env.ShepherdEnv(n=50)
        observation, info = env.reset(seed=1)
        over = False
        while not over:
            observation, reward, _, over, info = env.step(env.action_space.sample())
        env.close()

    **Actions**, `Box(-1, 1, (4,))`, in the goal's frame: (1, 0) is along the goal, (0, 1) to its
    left. Two numbers are a place: (0, 0) is the group's centroid, and (±1, ±1) are the corners of a
    square that reaches twice the group's spread in each direction; the `informed` individuals
    nearest to it are informed, and no others. Two are their preference, a vector whose length, at
    most 1, times `max_weight` is the weight; (0, 0) informs none.

    **Observations**, `Box(-1, 1, (82,))`, directions in the goal's frame:

    - 0, 1: the mean heading of the group, which is its velocity.
    - 2: its spread R, the root mean square of the distances from its centroid: R / (√n + R).
    - 3, 4: its elongation along the goal and along the diagonal: the means of cos 2φ and sin 2φ of
      the directions φ from its centroid, weighted by the distance squared.
    - 5, 6: the mean radial and tangential components of the headings about its centroid.
    - Then 3 for each of 5 · 5 cells of the square, rows from right to left of the goal, in each
      from behind to ahead: the share of the group in the cell, with individuals outside the square
      counted in the nearest cell, and their mean heading.

    **Reward**: the drift, which is how fast the group's centre moved along the goal while the
    action held, in free speeds: at most 1.

    **Episodes** are truncated after `max_steps` actions, and never terminate. `info` has
    `state_hash`, `step`, `time`, `order`, and `drift` since the start.

    Args:
        n: The size of the group.
        informed: Number of individuals that are informed at a time.
        goal: The direction in which it is to go, radians, counter-clockwise from +x.
        max_weight: The largest weight of a preference; attraction counts 1.
        steps_per_action: Number of time steps of an action.
        max_steps: Number of actions of an episode.
        render_mode: `"rgb_array"`, or None for no pictures.
        endpoint: The endpoint of a daemon, such as `tcp/127.0.0.1:7447`; None starts a private one,
            see `jostle.local`.
        spec: Other fields of `jostle.Spec`, such as `pi1=8.0`.

    Raises:
        InvalidArgument: An argument is out of range.
    """

    # Not a `ClassVar`, since it is none in the base class.
    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        n: SupportsIndex = 50,
        informed: SupportsIndex = 5,
        *,
        goal: float = 0.0,
        max_weight: float = 2.0,
        steps_per_action: SupportsIndex = 50,
        max_steps: SupportsIndex = 100,
        render_mode: str | None = None,
        endpoint: str | None = None,
        **spec: Any,
    ) -> None:
        self._world = World(
            n,
            informed,
            steers_all=True,
            goal=goal,
            max_weight=max_weight,
            steps_per_action=steps_per_action,
            max_steps=max_steps,
            render_mode=render_mode,
            endpoint=endpoint,
            spec=spec,
        )
        self.render_mode = render_mode
        self._informed = np.empty(0, np.intp)
        self.observation_space = Box(-1.0, 1.0, (_views.ABOVE_SIZE,), np.float32)
        self.action_space = Box(-1.0, 1.0, (4,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begins an episode; `seed` determines everything except the actions.

        Args:
            seed: The seed; None draws one from the generator of the last seed.
            options: There are none.

        Raises:
            IncorrectState: The environment is closed.
            InvalidArgument: An option is given.
            Unavailable: The daemon does not start, or is disconnected.
        """
        check_options(options)
        super().reset(seed=seed)
        self._world.reset(draw_seed(self.np_random))
        self._informed = np.empty(0, np.intp)
        return self._observe(), self._world.info()

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Informs the individuals that the action selects, and advances the swarm.

        Args:
            action: The place and the preference, shape (4,).

        Raises:
            IncorrectState: The environment is closed; or, as gymnasium's `ResetNeeded`, no episode
                has begun, or it has ended.
            InvalidArgument: The action has another shape, or is not finite.
            Unavailable: The daemon is disconnected.
        """
        world = self._world
        numbers = read_action("action", action, 4)
        chosen = _views.nearest(world.state, world.goal, numbers[:2], world.informed)
        # Individuals that were informed before and are not chosen now get weight 0.
        changed = np.union1d(self._informed, chosen)
        preference = np.where(np.isin(changed, chosen)[:, None], numbers[2:], 0.0)
        drift = world.advance(changed, preference)
        self._informed = chosen
        return self._observe(), drift, False, world.is_over, world.info()

    def render(self) -> Pixels | None:
        """A picture of the group, shape (360, 520, 3), uint8; None without a `render_mode`."""
        return self._world.render()

    def fork(self) -> Self:
        """A copy that is where this one is: the same actions lead both to the same states.

            best = max(plans, key=lambda plan: value_of(env.fork(), plan))

        `copy.deepcopy` does the same. The copy's swarm is a fork on the same daemon. `close` of the
        copy or of this environment deletes it; a copy that is not closed and not referenced is
        deleted at the next `fork` or `reset` of this one. Before the first `reset` the copy is a
        new environment with the same arguments, as a pickled one always is.

        Raises:
            Conflict: Another client changed the swarm.
            IncorrectState: The environment is closed.
            ResourceExhausted: The daemon has as many swarms as its `max_swarms`.
            Unavailable: The daemon is disconnected.
        """
        return copy.deepcopy(self)

    def close(self) -> None:
        """Stops the private daemon, or deletes the swarm, with all copies.

        A second call does nothing.
        """
        self._world.close()

    def _observe(self) -> Floats:
        return _views.above(self._world.state, self._world.goal)
