"""Repeats an experiment on a running swarm, to the bit.

    jostled &
    python repeat.py

A command that comes while a swarm runs takes effect at whatever step it meets. With `at_step` it
waits for a step of its own, and a `batch` applies several changes there at once or none of them:
the same commands then lead to the same state, however fast the swarm ran when they came.
"""

import math

import jostle


def experiment(swarm: jostle.Swarm, rate: float | None) -> jostle.Status:
    """Lets it run, steers it on the way, and waits until it is over."""
    with swarm.events(timeout=60.0) as events:
        swarm.run(rate=rate)
        leaders = jostle.ids(range(6))
        steer = jostle.Inform(leaders, direction=0.0, weight=2.0)
        swarm.batch([jostle.Set(pi3=1.5), steer], at_step=1000)
        swarm.inform(leaders, direction=math.pi / 2, weight=2.0, at_step=1500)
        swarm.pause(at_step=2000)
        for event in events:
            if event.kind == "command":
                print(f"step {event.step:4}: {event.verb}")
                if event.verb == "pause":
                    break
    return swarm.status()


def main() -> None:
    """Does it twice, at two rates, and compares."""
    spec = jostle.Spec(n=30, seed=4)
    hashes = []
    with jostle.connect(client="repeat.py") as client:
        for name, rate in (("once", 20.0), ("again", 10.0)):
            swarm = client.create(name, spec)
            try:
                status = experiment(swarm, rate)
            finally:
                swarm.delete()
            hashes.append(status.state_hash)
            print(f"{name}: step {status.step}, drift {status.order.drift:+.2f}, {hashes[-1][:16]}")
    if len(set(hashes)) > 1:
        raise SystemExit("the two came out differently")
    print("the same to the bit")


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
