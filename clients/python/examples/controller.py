"""A controller in lock-step: it reads the state, decides, and advances the swarm.

    jostled &
    python controller.py looped

The swarm steps only when its controllers have advanced, the reply has the state, and an advance for
one step is rejected at any other. After a restart of the daemon the program continues.
"""

import argparse
import math

import jostle


def main() -> None:
    """Steers a group of thirty round a corner by five informed individuals."""
    parser = argparse.ArgumentParser(description="Steers a new swarm of thirty round a corner.")
    parser.add_argument("name", nargs="?", default="looped", help="name of the swarm to create")
    parser.add_argument("--endpoint", help="endpoint of the daemon, such as tcp/127.0.0.1:7447")
    args = parser.parse_args()

    try:
        client = jostle.connect(args.endpoint, client="controller.py")
    except jostle.Unavailable as error:
        raise SystemExit(f"{error}; here --endpoint names it") from None
    with client:
        try:
            swarm = client.create(args.name, jostle.Spec(n=30, seed=4))
        except jostle.AlreadyExists:
            raise SystemExit(
                f"there is a swarm {args.name}: delete it with `jostle delete {args.name}`, or "
                "give another name as in `controller.py NAME`"
            ) from None
        with swarm.join("pilot", jostle.ids(range(5)), on_timeout="free") as pilot:
            state = pilot.sync()
            for turn in range(200):
                heading = 0.0 if state.time < 20 else math.pi / 2
                # 0.2 time units in one exchange.
                arrived = pilot.advance(10, direction=heading, weight=2.0, state=True)
                state = arrived.state
                for miss in arrived.news.missed:
                    print(f"step {miss.step}: {miss.controller} was late")
                if not arrived.complete:
                    # Another client paused or reset the swarm: it is not where the loop assumes.
                    raise SystemExit(
                        f"the exchange ended after {arrived.steps} of 10 steps, at step "
                        f"{arrived.step}: someone paused or reset {args.name}"
                    )
                if turn % 20 == 19:
                    velocity = state.order.velocity
                    print(
                        f"t = {state.time:5.1f}: wanted {math.degrees(heading):3.0f}°, "
                        f"going {math.degrees(math.atan2(velocity[1], velocity[0])):4.0f}° "
                        f"at {state.order.order:.2f}"
                    )
        swarm.delete()


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
