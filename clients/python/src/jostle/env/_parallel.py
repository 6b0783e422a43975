"""PettingZoo: every informed individual is an agent."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self, SupportsIndex

import numpy as np
import pettingzoo
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray

from .._draw import Camera
from .._errors import InvalidArgument
from . import _views
from ._checks import at_least_1, check_render_mode, positive, read_action
from ._picture import Pixels, paint
from ._world import World, draw_seed

Floats = NDArray[np.float32]


class ParallelEnv(pettingzoo.ParallelEnv[str, Floats, Floats]):
    """Informed individuals in a group that knows nothing; together they are to make it drift.

        env = jostle.env.ParallelEnv(n=50, informed=5)
        observations, infos = env.reset(seed=1)
        while env.agents:
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            observations, rewards, terminations, truncations, infos = env.step(actions)
        env.close()

    **Agents** `informed_0`, `informed_1`, … are the individuals 0, 1, …; a start is drawn anew from
    the seed for each episode, so that any are as good as any others. All act at once and the swarm
    advances in one exchange.

    **Actions**, `Box(-1, 1, (2,))`: its preference as a vector in the goal's frame: (1, 0) is along
    the goal, (0, 1) to its left. The vector's length, at most 1, times `max_weight` is the weight;
    (0, 0) is to prefer nothing. A preferred direction is one in the plane and stays where it is
    while the body turns, and this vector is the term that it adds to the turning; so an action
    means the same whichever way the individual heads, and goals may be added to each other.

    **Observations**, `Box(-1, 1, (9 + 4 · neighbours,))`, directions in the goal's frame:

    - 0, 1: its heading.
    - 2, 3: where the group's centre is: d / (√n + d) for a distance d.
    - 4, 5: the mean heading of the group, which is its velocity.
    - 6, 7: the mean of the unit vectors to all the others, which attracts it by the default law.
    - 8: how crowded it is: c / (1 + c) with c others within one body size.
    - Then 4 for each of the nearest in sight, the nearest first: where it is, in units of `sight`,
      and its heading; zeros where there is none.

    `state()` is what `ShepherdEnv` observes, for a critic of all agents.

    **Rewards**, the same for all: the drift, which is how fast the group's centre moved along the
    goal while the actions held, in free speeds: at most 1.

    **Episodes** are truncated after `max_steps` actions, and never terminate. `infos` has, for each
    agent, `state_hash`, `step`, `time`, `order`, and `drift` since the start.

    Args:
        n: The size of the group.
        informed: How many of it are agents.
        goal: Where it is to go, radians.
        max_weight: The largest weight of a preference; attraction counts 1.
        steps_per_action: Time steps that an action holds.
        max_steps: Actions in an episode.
        neighbours: How many neighbours are perceived.
        sight: How far neighbours are perceived, body sizes.
        render_mode: `"rgb_array"`, or None for no pictures.
        endpoint: Of a daemon to use, such as `tcp/127.0.0.1:7447`; None starts a private one, see
            `jostle.local`.
        spec: Other fields of `jostle.Spec`, such as `pi1=8.0`.

    Raises:
        InvalidArgument: An argument is wrong.
    """

    # Not a `ClassVar`, since the base class says it is none.
    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "jostle_informed_v0",
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "is_parallelizable": True,
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
        neighbours: SupportsIndex = 6,
        sight: float = 3.0,
        render_mode: str | None = None,
        endpoint: str | None = None,
        **spec: Any,
    ) -> None:
        self._world = World(
            n,
            informed,
            steers_all=False,
            goal=goal,
            max_weight=max_weight,
            steps_per_action=steps_per_action,
            max_steps=max_steps,
            endpoint=endpoint,
            spec=spec,
        )
        self._who = np.arange(self._world.informed)
        self._neighbours = at_least_1("neighbours", neighbours)
        self._sight = positive("sight", sight)
        self.render_mode = check_render_mode(render_mode)
        self._camera = Camera()
        self._random, _ = seeding.np_random()
        self.possible_agents = [f"informed_{index}" for index in self._who]
        self.agents: list[str] = []
        size = _views.OWN_SIZE + _views.NEIGHBOUR_SIZE * self._neighbours
        self.observation_spaces: dict[str, Space[Floats]] = {
            agent: Box(-1.0, 1.0, (size,), np.float32) for agent in self.possible_agents
        }
        self.state_space = Box(-1.0, 1.0, (_views.ABOVE_SIZE,), np.float32)
        self.action_spaces: dict[str, Space[Floats]] = {
            agent: Box(-1.0, 1.0, (2,), np.float32) for agent in self.possible_agents
        }

    def observation_space(self, agent: str) -> Space[Floats]:
        """What an agent may perceive."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Floats]:
        """What an agent may do."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, dict[str, Any]]]:
        """Begins an episode, of which `seed` determines everything but the actions.

        Args:
            seed: None goes on with what the seed before led to.
            options: There are none.

        Raises:
            IncorrectState: It is closed.
            Unavailable: The daemon does not start, or is gone.
        """
        if seed is not None:
            self._random, _ = seeding.np_random(seed)
        self._world.reset(draw_seed(self._random))
        self.agents = list(self.possible_agents)
        self._camera = Camera()
        return self._observe(), self._infos()

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[
        dict[str, Floats],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Has every agent act, and the swarm advance.

        Raises:
            IncorrectState: No episode has begun, or it is over.
            InvalidArgument: An agent's action is missing or wrong.
            Unavailable: The daemon is gone.
        """
        self._world.check_goes_on()
        agents = list(self.possible_agents)
        if missing := [agent for agent in agents if agent not in actions]:
            raise InvalidArgument(f"no action for {', '.join(missing)}")
        preference = np.array([read_action(agent, actions[agent], 2) for agent in agents])
        drift = self._world.advance(self._who, preference)
        is_over = self._world.is_over
        if is_over:
            self.agents = []
        return (
            self._observe(),
            dict.fromkeys(agents, drift),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, is_over),
            self._infos(),
        )

    def state(self) -> Floats:
        """The group from above, which is what `ShepherdEnv` observes: for a critic of all."""
        return _views.above(self._world.state, self._world.goal)

    def render(self) -> Pixels | None:
        """The group now, as an array of shape (360, 520, 3); None without a `render_mode`."""
        if self.render_mode is None:
            return None
        return paint(self._world.state, self._world.spec.pi1, self._camera)

    def close(self) -> None:
        """Ends the private daemon, or deletes the swarm; harmless when done already."""
        self.agents = []
        self._world.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"ParallelEnv(n={self._world.n}, informed={self._world.informed})"

    def _observe(self) -> dict[str, Floats]:
        world = self._world
        views = _views.within(world.state, self._who, world.goal, self._neighbours, self._sight)
        # Each has a copy of its own, since agents keep what they are given.
        return {agent: view.copy() for agent, view in zip(self.possible_agents, views, strict=True)}

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {agent: self._world.info() for agent in self.possible_agents}
