"""Gymnasium: one agent chooses whom to inform, and whither."""

from __future__ import annotations

from typing import Any, SupportsIndex

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from .._draw import Camera
from . import _views
from ._checks import check_render_mode, read_action
from ._picture import Pixels, paint
from ._world import World, draw_seed

Floats = NDArray[np.float32]


class ShepherdEnv(gymnasium.Env[Floats, Floats]):
    """A group seen from above, in which a few at a time can be told where to go.

        env = jostle.env.ShepherdEnv(n=50)
        observation, info = env.reset(seed=1)
        over = False
        while not over:
            observation, reward, _, over, info = env.step(env.action_space.sample())
        env.close()

    **Actions**, `Box(-1, 1, (4,))`, in the goal's frame: (1, 0) is along the goal, (0, 1) to its
    left. Two numbers are a place: (0, 0) is the group's centre, and (±1, ±1) are the corners of a
    square that reaches twice the group's spread each way; the `informed` individuals nearest to it
    are informed, and nobody else. Two are what they prefer, a vector whose length, at most 1, times
    `max_weight` is the weight; (0, 0) is to inform nobody.

    **Observations**, `Box(-1, 1, (82,))`, directions in the goal's frame:

    - 0, 1: the mean heading of the group, which is its velocity.
    - 2: its spread R, the root mean square of the distances from its centre: R / (√n + R).
    - 3, 4: whether it is long along the goal or across, and along which diagonal: cos 2φ and sin 2φ
      of the directions φ from its centre, averaged with the distance squared as weight.
    - 5, 6: how much headings point away from its centre, and how much they mill around it.
    - Then 3 for each of 5 · 5 cells of the square, rows from right to left of the goal, in each
      from behind to ahead: the share of the group there, those further out counted at the edge,
      and their mean heading.

    **Reward**: the drift, which is how fast the group's centre moved along the goal while the
    action held, in free speeds: at most 1.

    **Episodes** are truncated after `max_steps` actions, and never terminate. `info` has
    `state_hash`, `step`, `time`, `order`, and `drift` since the start.

    Args:
        n: The size of the group.
        informed: How many are informed at a time.
        goal: Where it is to go, radians.
        max_weight: The largest weight of a preference; attraction counts 1.
        steps_per_action: Time steps that an action holds.
        max_steps: Actions in an episode.
        render_mode: `"rgb_array"`, or None for no pictures.
        endpoint: Of a daemon to use, such as `tcp/127.0.0.1:7447`; None starts a private one, see
            `jostle.local`.
        spec: Other fields of `jostle.Spec`, such as `pi1=8.0`.

    Raises:
        InvalidArgument: An argument is wrong.
    """

    # Not a `ClassVar`, since the base class says it is none.
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
            endpoint=endpoint,
            spec=spec,
        )
        self.render_mode = check_render_mode(render_mode)
        self._camera = Camera()
        self._informed = np.empty(0, np.intp)
        self.observation_space = Box(-1.0, 1.0, (_views.ABOVE_SIZE,), np.float32)
        self.action_space = Box(-1.0, 1.0, (4,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begins an episode, of which `seed` determines everything but the actions.

        Args:
            seed: None goes on with what the seed before led to.
            options: There are none.

        Raises:
            IncorrectState: It is closed.
            Unavailable: The daemon does not start, or is gone.
        """
        super().reset(seed=seed)
        self._world.reset(draw_seed(self.np_random))
        self._informed = np.empty(0, np.intp)
        self._camera = Camera()
        return self._observe(), self._world.info()

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Informs those the action chooses, and has the swarm advance.

        Raises:
            IncorrectState: No episode has begun, or it is over.
            InvalidArgument: The action is no such vector.
            Unavailable: The daemon is gone.
        """
        world = self._world
        numbers = read_action("action", action, 4)
        chosen = _views.nearest(world.state, world.goal, numbers[:2], world.informed)
        # Whoever is told something else now, or nothing any more.
        told = np.union1d(self._informed, chosen)
        preference = np.where(np.isin(told, chosen)[:, None], numbers[2:], 0.0)
        drift = world.advance(told, preference)
        self._informed = chosen
        return self._observe(), drift, False, world.is_over, world.info()

    def render(self) -> Pixels | None:
        """The group now, as an array of shape (360, 520, 3); None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return paint(self._world.state, self._world.spec.pi1, self._camera)

    def close(self) -> None:
        """Ends the private daemon, or deletes the swarm; harmless when done already."""
        self._world.close()

    def _observe(self) -> Floats:
        return _views.above(self._world.state, self._world.goal)
