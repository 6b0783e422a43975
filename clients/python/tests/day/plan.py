"""The day as it is drawn from its seed."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

STEPS_PER_SECOND = 50
"""Of a swarm at rate 1: the reciprocal of `dt`."""

DEADLINE_SECS = 2.0
"""How long a controller is waited for."""

STEPS_PER_EXCHANGE = 12
EXCHANGES_PER_SECOND = 4

# What is not one of a scientist's many.
SPECIAL = ("loop-1", "loop-2", "twin-1", "twin-2", "still", "film", "table", "nameless")


@dataclass(frozen=True)
class Controller:
    """One of the four: whom it steers, and where."""

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
    """Who is there, and when what goes wrong; times are seconds since the day began."""

    seed: int
    seconds: float
    viewers: int
    specs: dict[str, dict[str, Any]]
    twin_commands: list[tuple[int, str, dict[str, Any]]]
    twin_end: int
    kill_controller: float
    first_kill: float
    stop_film: float
    freeze_controller: float
    freeze_secs: float
    fill: float
    free: float
    film_again: float
    second_kill: float

    def experiment(self, number: int) -> str:
        """The file of one of the two experiments, to be under way when the daemon is killed."""
        return f"""\
name = "grid-{number}"
seed = {self.seed + number}
replicates = 150
duration = 150

[[grid]]
pi1 = [1, {2 + number}]
n = [20, 50]

[measure]
order_every = 50
"""


def draw(seed: int, seconds: float, swarms: int, viewers: int) -> Plan:
    """Draws a day."""
    dice = random.Random(seed)
    names = [*SPECIAL, *(f"school-{k:02}" for k in range(1, swarms - len(SPECIAL) + 1))]
    specs: dict[str, dict[str, Any]] = {
        name: {
            "n": dice.randint(20, 50),
            "seed": dice.randrange(2**40),
            "rate": 1,
            "publish_every": dice.choice((5, 10)),
        }
        for name in names
    }
    specs["twin-2"] = specs["twin-1"]
    specs["still"]["rate"] = None
    specs["film"]["publish_every"] = 5
    twin_end = int(0.7 * seconds * STEPS_PER_SECOND)
    at = sorted(dice.sample(range(STEPS_PER_SECOND, twin_end), max(20, int(seconds / 10))))
    fill = dice.uniform(0.48, 0.52) * seconds
    return Plan(
        seed=seed,
        seconds=seconds,
        viewers=viewers,
        specs=specs,
        twin_commands=[(step, *change(dice)) for step in at],
        twin_end=twin_end,
        kill_controller=dice.uniform(0.08, 0.14) * seconds,
        first_kill=dice.uniform(0.20, 0.30) * seconds,
        stop_film=0.35 * seconds,
        freeze_controller=dice.uniform(0.39, 0.42) * seconds,
        freeze_secs=dice.uniform(2.5, 6.0),
        fill=fill,
        free=fill + min(0.08 * seconds, 60.0),
        film_again=0.63 * seconds,
        second_kill=dice.uniform(0.70, 0.82) * seconds,
    )


def change(dice: random.Random) -> tuple[str, dict[str, Any]]:
    """A change of a swarm: its verb and arguments, as the wire has them."""
    informed = {"select": {"count": dice.randint(1, 4)}, "direction": dice.uniform(-3.0, 3.0)}
    match dice.randrange(10):
        case 0 | 1 | 2:
            return "inform", {**informed, "weight": dice.uniform(0.1, 2.0)}
        case 3:
            return "inform", {**informed, "for_time": dice.uniform(0.5, 5.0)}
        case 4:
            return "uninform", {"select": {"count": 1}}
        case 5:
            return "set", {"pi3": dice.uniform(0.5, 2.0)}
        case 6:
            return "set", {"noise": dice.uniform(0.0, 0.05)}
        case 7:
            return "inject", {"count": 1, "direction": dice.uniform(-3.0, 3.0)}
        case 8:
            return "remove", {"select": {"count": 1}}
        case _:
            changes = [
                {"verb": "set", "args": {"pi2": dice.uniform(0.2, 1.0)}},
                {"verb": "inform", "args": informed},
                {"verb": "inject", "args": {"count": 1}},
                {"verb": "remove", "args": {"select": {"count": 1}}},
            ]
            return "batch", {"commands": changes}
