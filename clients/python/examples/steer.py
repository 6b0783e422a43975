"""Steers a running swarm by a tenth of its individuals.

    jostled demo &
    python steer.py demo

A tenth of the group is informed of a direction, first east, then north. The others are not; the
drift of the whole group along that direction, in free speeds, measures how far it follows: 1 if
all individuals moved straight along it.
"""

import argparse
import math
from itertools import pairwise

import jostle


def drift_between(before: jostle.State, after: jostle.State, direction: float) -> float:
    """The mean drift of the group between two states along `direction`, radians, free speeds."""
    moved = after.position.mean(axis=0) - before.position.mean(axis=0)
    along = moved[0] * math.cos(direction) + moved[1] * math.sin(direction)
    return float(along) / (after.time - before.time)


def follow(swarm: jostle.Swarm, direction: float, time_units: float) -> None:
    """Prints the drift along `direction` for `time_units`, in six lines."""
    seen: list[jostle.State] = []
    print("     time  order   drift")
    for state in swarm.states(timeout=10.0):
        if not seen:
            seen.append(state)
        elif state.time - seen[-1].time >= time_units / 6:
            seen.append(state)
            drift = drift_between(seen[-2], seen[-1], direction)
            print(f"{state.time:9.1f}  {state.order.order:5.2f}  {drift:+6.2f}", flush=True)
        if len(seen) == 7:
            break
    else:
        raise SystemExit("the swarm was deleted")
    mean = drift_between(seen[0], seen[-1], direction)
    best = max(drift_between(a, b, direction) for a, b in pairwise(seen))
    print(f"drift towards {math.degrees(direction):.0f}°: {mean:+.2f}, at best {best:+.2f}\n")


def main() -> None:
    """Informs a tenth of the swarm of two directions in turn, and uninforms it."""
    parser = argparse.ArgumentParser(description="Steers a running swarm by a tenth of it.")
    parser.add_argument("name", help="name of a running swarm, such as demo")
    parser.add_argument("--endpoint", help="endpoint of its daemon, such as tcp/127.0.0.1:7447")
    parser.add_argument("--for", dest="time_units", type=float, default=60.0, help="time per leg")
    args = parser.parse_args()

    with jostle.connect(args.endpoint, client="steer.py") as client:
        swarm = client.swarm(args.name)
        tenth = jostle.count(max(1, round(swarm.status().n / 10)))
        informed = swarm.inform(tenth, direction=0.0)
        print(f"informed {len(informed.ids)} of {informed.n}: {informed.ids}\n")
        for direction in (0.0, math.pi / 2):
            swarm.inform(jostle.ids(informed.ids), direction, weight=1.0)
            follow(swarm, direction, args.time_units)
        swarm.uninform(jostle.ids(informed.ids))


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
