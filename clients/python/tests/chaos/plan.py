"""The load and the faults of a run, drawn from its seed."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

STEPS_PER_SECOND = 50
"""Of a swarm at rate 1: the reciprocal of `dt`."""

DEADLINE_SECS = 2.0
"""How long the other controllers wait for one."""

STEPS_PER_EXCHANGE = 12
EXCHANGES_PER_SECOND = 4

# Swarms with a role of their own; the others are changed at random.
SPECIAL = ("loop-1", "loop-2", "twin-1", "twin-2", "stepped", "recorded", "forked", "unnamed")


@dataclass(frozen=True)
class Controller:
    """One of the four: its swarm and the individuals it steers."""

    name: str
    swarm: str
    ids: tuple[int, ...]


CONTROLLERS = (
    Controller("ada", "loop-1", (0, 1, 2)),
    Controller("bob", "loop-1", (3, 4)),
    Controller("cyd", "loop-2", (0, 1, 2)),
    Controller("dan", "loop-2", (5, 6)),
)


@dataclass(frozen=True)
class Plan:
    """The load, and when each fault is injected, in seconds since the start."""

    seed: int
    seconds: float
    viewers: int
    specs: dict[str, dict[str, Any]]
    twin_commands: list[tuple[int, str, dict[str, Any]]]
    twin_end: int
    kill_controller: float
    submit_secs: float
    first_kill: float
    stop_recording: float
    freeze_controller: float
    freeze_secs: float
    fill: float
    free: float
    record_again: float
    second_kill: float

    def experiment(self, number: int) -> str:
        """The file of one of the two experiments, which has to run while the daemon is killed."""
        return f"""\
name = "grid-{number}"
seed = {self.seed + number}
replicates = {min(75, round(self.seconds / 2))}
duration = 150

[[grid]]
pi1 = [1, {2 + number}]
n = [20, 50]

[measure]
order_every = 50
"""


def draw(seed: int, seconds: float, swarms: int, viewers: int) -> Plan:
    """Draws a run."""
    rng = random.Random(seed)
    names = [*SPECIAL, *(f"school-{k:02}" for k in range(1, swarms - len(SPECIAL) + 1))]
    specs: dict[str, dict[str, Any]] = {
        name: {
            "n": rng.randint(20, 50),
            "seed": rng.randrange(2**40),
            "rate": 1,
            "publish_every": rng.choice((5, 10)),
        }
        for name in names
    }
    specs["twin-2"] = specs["twin-1"]
    specs["stepped"]["rate"] = None
    specs["recorded"]["publish_every"] = 5
    twin_end = int(0.7 * seconds * STEPS_PER_SECOND)
    at = sorted(rng.sample(range(STEPS_PER_SECOND, twin_end), max(20, int(seconds / 10))))
    fill = rng.uniform(0.48, 0.52) * seconds
    return Plan(
        seed=seed,
        seconds=seconds,
        viewers=viewers,
        specs=specs,
        twin_commands=[(step, *change(rng)) for step in at],
        twin_end=twin_end,
        kill_controller=rng.uniform(0.08, 0.14) * seconds,
        # Short enough that the experiment is not finished at the kill.
        submit_secs=min(8.0, 0.03 * seconds),
        first_kill=rng.uniform(0.20, 0.30) * seconds,
        stop_recording=0.35 * seconds,
        freeze_controller=rng.uniform(0.39, 0.42) * seconds,
        freeze_secs=rng.uniform(2.5, 6.0),
        fill=fill,
        free=fill + min(0.08 * seconds, 60.0),
        record_again=0.63 * seconds,
        second_kill=rng.uniform(0.70, 0.82) * seconds,
    )


def change(rng: random.Random) -> tuple[str, dict[str, Any]]:
    """A change of a swarm: its verb and arguments, as the wire has them."""
    informed = {"select": {"count": rng.randint(1, 4)}, "direction": rng.uniform(-3.0, 3.0)}
    match rng.randrange(10):
        case 0 | 1 | 2:
            return "inform", {**informed, "weight": rng.uniform(0.1, 2.0)}
        case 3:
            return "inform", {**informed, "for_time": rng.uniform(0.5, 5.0)}
        case 4:
            return "uninform", {"select": {"count": 1}}
        case 5:
            return "set", {"pi3": rng.uniform(0.5, 2.0)}
        case 6:
            return "set", {"noise": rng.uniform(0.0, 0.05)}
        case 7:
            return "inject", {"count": 1, "direction": rng.uniform(-3.0, 3.0)}
        case 8:
            return "remove", {"select": {"count": 1}}
        case _:
            changes = [
                {"verb": "set", "args": {"pi2": rng.uniform(0.2, 1.0)}},
                {"verb": "inform", "args": informed},
                {"verb": "inject", "args": {"count": 1}},
                {"verb": "remove", "args": {"select": {"count": 1}}},
            ]
            return "batch", {"commands": changes}
