"""Environments for learning: swarms whose informed individuals somebody else decides for.

    import jostle.env

    env = jostle.env.ParallelEnv(n=50, informed=5)  # PettingZoo: an agent is an informed individual
    env = jostle.env.ShepherdEnv(n=50)  # Gymnasium: the agent chooses whom to inform, and whither
    env = gymnasium.make("jostle/Shepherd-v0", n=50)  # the same

Both reward the group's drift along the goal: the speed of its centre that way, in free speeds. Each
starts a daemon of its own when it is first reset, unless it is given the `endpoint` of one. The
same seed and the same actions lead to the same `state_hash`, which is in every `info`.

`pip install 'jostle[env]'` brings what this needs.
"""

from .._extras import need

for _module in ("gymnasium", "pettingzoo"):
    need(_module, "env")

import gymnasium  # noqa: E402

from ._parallel import ParallelEnv  # noqa: E402
from ._shepherd import ShepherdEnv  # noqa: E402

__all__ = ["ParallelEnv", "ShepherdEnv"]

gymnasium.register("jostle/Shepherd-v0", entry_point="jostle.env:ShepherdEnv")
