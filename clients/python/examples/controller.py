"""A controller in lock-step: it looks, decides, and lets the swarm step.

    jostled &
    python controller.py

The swarm moves only when its controllers have advanced, the state comes back with the answer, and
what was decided for one step is refused at any other. If the daemon is started again meanwhile,
this goes on as if nothing had been.
"""

import math

import jostle


def main() -> None:
    """Steers a group of thirty round a corner by five informed individuals."""
    with jostle.connect(client="controller.py") as client:
        swarm = client.create("looped", jostle.Spec(n=30, seed=4))
        with swarm.join("pilot", jostle.ids(range(5)), on_timeout="free") as pilot:
            state = pilot.sync()
            for turn in range(200):
                heading = 0.0 if state.time < 20 else math.pi / 2
                # 0.2 time units on in one exchange.
                arrived = pilot.advance(10, direction=heading, weight=2.0, state=True)
                state = arrived.state
                for miss in arrived.news.missed:
                    print(f"step {miss.step}: {miss.controller} was late")
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
