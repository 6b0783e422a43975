"""A controller as a program of its own: steers two individuals in lock-step, and says how it goes.

Every line it says is a word and what belongs to it, and what it wants is a function of the step
alone, so that a run in which nothing is lost leads to the bit where an undisturbed one does.
"""

from __future__ import annotations

import argparse
import math
import sys
import time

import jostle


def say(*words: object) -> None:
    """Says a line at once."""
    print(*words, flush=True)


def directions(controller: jostle.Controller) -> list[float]:
    """What it wants at the step it is at."""
    return [math.sin(0.1 * controller.step + one) for one in controller.ids]


def steer(controller: jostle.Controller, until: int, waits: bool) -> None:
    """Advances until a step, each time it is told to if it waits; gets in line again when out."""
    is_back = False
    while controller.step < until:
        if waits and not is_back:
            sys.stdin.readline()
        try:
            advanced = controller.advance(direction=directions(controller), weight=2.0)
        except (jostle.Conflict, jostle.NotFound) as error:
            say("out", error.code, error)
            controller.sync()
            is_back = True
            say("back", controller.step)
            continue
        is_back = False
        say("step", advanced.step, advanced.state_hash)
        for miss in advanced.news.missed:
            say("missed", miss.controller, miss.misses)
        for departed in advanced.news.left:
            say("left", departed.controller, departed.why)


def main() -> None:
    """Joins, and steers."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("swarm")
    parser.add_argument("name")
    parser.add_argument("--ids", type=int, nargs="*", default=[])
    parser.add_argument("--until", type=int, required=True)
    parser.add_argument("--deadline", type=float, default=30.0)
    parser.add_argument("--on-timeout", default="hold")
    parser.add_argument("--timeout", type=float, default=60.0)
    parser.add_argument("--waits", action="store_true", help="for a line before it advances")
    asked = parser.parse_args()
    with jostle.connect(asked.endpoint, client=asked.name, timeout=asked.timeout) as client:
        swarm = client.swarm(asked.swarm)
        with swarm.join(
            asked.name,
            jostle.ids(asked.ids),
            deadline=asked.deadline,
            on_timeout=asked.on_timeout,
        ) as controller:
            say("joined", controller.step)
            # Nobody begins before all are there.
            while swarm.status().controllers < 2:
                time.sleep(0.01)
            steer(controller, asked.until, asked.waits)


if __name__ == "__main__":
    main()
