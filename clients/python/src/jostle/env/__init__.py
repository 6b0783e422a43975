"""Environments for reinforcement learning: agents steer the informed individuals of a swarm.

    import jostle.env

    env = jostle.env.ParallelEnv(n=50, informed=5)  # PettingZoo: an agent is an informed individual
    env = jostle.env.ShepherdEnv(n=50)  # Gymnasium: the agent selects whom to inform
    env = gymnasium.make("jostle/Shepherd-v0", n=50)  # the same

Both reward the group's drift along the goal: the speed of its centroid in that direction, in free
speeds. Each starts a private daemon at the first `reset`, unless an `endpoint` is given. The same
seed and the same actions lead to the same `state_hash`, which is in every `info`.

A pickled environment has its arguments and no episode; `fork` and `copy.deepcopy` copy the episode.
No connection survives a fork of the process: `AsyncVectorEnv(..., context="forkserver")`.

`pip install './clients/python[env]'` in a checkout installs its dependencies. `jostled` must be on
the `PATH`, unless the wheel contains it or `JOSTLED` names it.
"""

from .._extras import import_extra

for _module in ("gymnasium", "pettingzoo"):
    import_extra(_module, "env")

import gymnasium  # noqa: E402

from ._parallel import ParallelEnv  # noqa: E402
from ._shepherd import ShepherdEnv  # noqa: E402

__all__ = ["ParallelEnv", "ShepherdEnv"]

gymnasium.register("jostle/Shepherd-v0", entry_point="jostle.env:ShepherdEnv")
