"""Repeats an experiment on a running swarm, to the bit.

    jostled &
    python repeat.py

A command that is sent while a swarm runs takes effect at whichever step that is. `Swarm.at` sends
it for a step of its own, and a `batch` applies several changes at one step or none of them: the
same commands then lead to the same state, whatever the rate of the swarm when they were sent.
"""

import math

import jostle


def experiment(swarm: jostle.Swarm, rate: float | None) -> jostle.Status:
    """Runs the swarm, steers it at three steps, and waits until it is paused."""
    with swarm.events(timeout=60.0) as events:
        swarm.run(rate=rate)
        leaders = jostle.ids(range(6))
        steer = jostle.Inform(leaders, direction=0.0, weight=2.0)
        swarm.at(1000).batch([jostle.Set(pi3=1.5), steer])
        swarm.at(1500).inform(leaders, direction=math.pi / 2, weight=2.0)
        swarm.at(2000).pause()
        for event in events:
            if event.kind == "command":
                print(f"step {event.step:4}: {event.verb}")
                if event.verb == "pause":
                    break
    return swarm.status()


def main() -> None:
    """Runs the experiment at two rates and compares the hashes."""
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
        raise SystemExit("the two runs have different states")
    print("the same to the bit")


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
