"""The environment for PettingZoo: every informed individual is an agent."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Self, SupportsIndex

import numpy as np
import pettingzoo
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray

from .._errors import InvalidArgument
from . import _views
from ._checks import at_least_1, check_options, positive, read_action
from ._picture import Pixels
from ._world import World, draw_seed

Floats = NDArray[np.float32]


class ParallelEnv(pettingzoo.ParallelEnv[str, Floats, Floats]):
    """Informed individuals in an uninformed group; together they are to make it drift.

        env = jostle.env.ParallelEnv(n=50, informed=5)
        observations, infos = env.reset(seed=1)
        while env.agents:
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            observations, rewards, terminations, truncations, infos = env.step(actions)
        env.close()

    **Agents** `informed_0`, `informed_1`, … are the individuals 0, 1, …; each episode draws a new
    start from the seed, so that it does not matter which individuals they are. All act at once, and
    the swarm advances in one exchange.

    **Actions**, `Box(-1, 1, (2,))`: the agent's preference as a vector in the goal's frame: (1, 0)
    is along the goal, (0, 1) to its left. The vector's length, at most 1, times `max_weight` is the
    weight; (0, 0) is no preference. The vector is fixed in the plane while the body turns, so an
    action means the same for every heading, and preferences can be added.

    **Observations**, `Box(-1, 1, (9 + 4 · neighbours,))`, directions in the goal's frame:

    - 0, 1: the agent's heading.
    - 2, 3: the direction to the group's centroid, with length d / (√n + d) for a distance d.
    - 4, 5: the mean heading of the group, which is its velocity.
    - 6, 7: the mean of the unit vectors to all others: its attraction by the default law, eq. (4).
    - 8: the local density, c / (1 + c) with c others within one body size.
    - Then 4 for each neighbour in sight, the nearest first: its position relative to the agent, in
      units of `sight`, and its heading; zeros if there is none.

    `state()` is the observation of `ShepherdEnv`, for a centralised critic.

    **Rewards**, the same for all: the drift, the mean velocity of the group's centroid along the
    goal during the action, in free speeds: at most 1.

    **Episodes** are truncated after `max_steps` actions, and never terminate. `infos` has, for each
    agent, `state_hash`, `step`, `time`, `order`, and `drift` since the start.

    Args:
        n: The size of the group.
        informed: Number of agents.
        goal: The direction in which it is to go, radians, counter-clockwise from +x.
        max_weight: The largest weight of a preference; attraction counts 1.
        steps_per_action: Number of time steps of an action.
        max_steps: Number of actions of an episode.
        neighbours: Number of observed neighbours.
        sight: The distance at which neighbours are observed, body sizes.
        render_mode: `"rgb_array"`, or None for no pictures.
        endpoint: The endpoint of a daemon, such as `tcp/127.0.0.1:7447`; None starts a private one,
            see `jostle.local`.
        spec: Other fields of `jostle.Spec`, such as `pi1=8.0`.

    Raises:
        InvalidArgument: An argument is out of range.
    """

    # Not a `ClassVar`, since it is none in the base class.
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
            render_mode=render_mode,
            endpoint=endpoint,
            spec=spec,
        )
        self._indices = np.arange(self._world.informed)
        self._neighbours = at_least_1("neighbours", neighbours)
        self._sight = positive("sight", sight)
        self.render_mode = render_mode
        self._random, _ = seeding.np_random()
        self.possible_agents = [f"informed_{index}" for index in self._indices]
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
        """The observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Floats]:
        """The action space of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, dict[str, Any]]]:
        """Begins an episode; `seed` determines everything except the actions.

        Args:
            seed: The seed; None draws one from the generator of the last seed.
            options: There are none.

        Raises:
            IncorrectState: The environment is closed.
            InvalidArgument: An option is given.
            Unavailable: The daemon does not start, or is disconnected.
        """
        # PettingZoo's own check gives this option to every environment.
        check_options(None if options == {"options": 1} else options)
        if seed is not None:
            self._random, _ = seeding.np_random(seed)
        self._world.reset(draw_seed(self._random))
        self.agents = list(self.possible_agents)
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
        """Applies the actions of all agents and advances the swarm.

        Args:
            actions: The action of each agent, shape (2,).

        Raises:
            IncorrectState: The environment is closed; or, as gymnasium's `ResetNeeded`, no episode
                has begun, or it has ended.
            InvalidArgument: The action of an agent is missing or invalid.
            Unavailable: The daemon is disconnected.
        """
        self._world.check_in_progress()
        agents = list(self.possible_agents)
        if missing := [agent for agent in agents if agent not in actions]:
            raise InvalidArgument(f"no action for {', '.join(missing)}")
        preference = np.array([read_action(agent, actions[agent], 2) for agent in agents])
        drift = self._world.advance(self._indices, preference)
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
        """The observation of `ShepherdEnv`, shape (82,), float32, for a centralised critic."""
        return _views.above(self._world.state, self._world.goal)

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
        self.agents = []
        self._world.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if not self._world.has_begun:
            self.agents = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"ParallelEnv(n={self._world.n}, informed={self._world.informed})"

    def _observe(self) -> dict[str, Floats]:
        world = self._world
        views = _views.within(world.state, self._indices, world.goal, self._neighbours, self._sight)
        # Copies, since agents may store their observations.
        return {agent: view.copy() for agent, view in zip(self.possible_agents, views, strict=True)}

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {agent: self._world.info() for agent in self.possible_agents}
