"""A controller as a separate program: steers two individuals in lock-step, and prints the progress.

Every line is a word and its values. The directions are a function of the step alone, so that a run
in which nothing is lost gives the same bits as an undisturbed one.
"""

from __future__ import annotations

import argparse
import math
import sys
import time

import jostle


def put(*words: object) -> None:
    """Prints a line and flushes it."""
    print(*words, flush=True)


def directions(controller: jostle.Controller) -> list[float]:
    """The directions at the current step."""
    return [math.sin(0.1 * controller.step + one) for one in controller.ids]


def steer(controller: jostle.Controller, until: int, waits: bool) -> None:
    """Advances until a step, with `waits` once per line on stdin; syncs after an error."""
    is_back = False
    while controller.step < until:
        if waits and not is_back:
            sys.stdin.readline()
        try:
            advanced = controller.advance(direction=directions(controller), weight=2.0)
        except (jostle.Conflict, jostle.NotFound) as error:
            put("out", error.code, error)
            controller.sync()
            is_back = True
            put("back", controller.step)
            continue
        is_back = False
        put("step", advanced.step, advanced.state_hash)
        for miss in advanced.news.missed:
            put("missed", miss.controller, miss.misses)
        for departed in advanced.news.left:
            put("left", departed.controller, departed.why)


def main() -> None:
    """Joins and steers."""
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
    options = parser.parse_args()
    with jostle.connect(options.endpoint, client=options.name, timeout=options.timeout) as client:
        swarm = client.swarm(options.swarm)
        with swarm.join(
            options.name,
            jostle.ids(options.ids),
            deadline=options.deadline,
            on_timeout=options.on_timeout,
        ) as controller:
            put("joined", controller.step)
            # No controller advances before all have joined.
            while swarm.status().controllers < 2:
                time.sleep(0.01)
            steer(controller, options.until, options.waits)


if __name__ == "__main__":
    main()
