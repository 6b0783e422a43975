"""Closes a loop around a swarm: look, decide, step.

    jostled &
    python controller.py

The swarm moves only when asked, the state comes back with the answer, and `expect_step` refuses a
decision that is not about the state it was made for.
"""

import math

import jostle


def main() -> None:
    """Steers a group of thirty round a corner by five informed individuals."""
    with jostle.connect(client="controller.py") as client:
        swarm = client.create("looped", jostle.Spec(n=30, seed=4))
        state = swarm.step(1, state=True)
        leaders = jostle.ids(state.id[:5])
        for turn in range(200):
            heading = 0.0 if state.time < 20 else math.pi / 2
            swarm.inform(leaders, direction=heading, weight=2.0, expect_step=state.step)
            state = swarm.step(10, state=True)  # 0.2 time units on
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
