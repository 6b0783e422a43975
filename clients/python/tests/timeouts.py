"""Every call with a `timeout`, and the error that it raises when the daemon never replies."""

from __future__ import annotations

from dataclasses import dataclass

import jostle
from recorder import SNAPSHOT
from rows import PLAN, Take, take


@dataclass(frozen=True)
class Ended:
    """How a call ends.

    Attributes:
        take: Its arguments without the `timeout`.
        error: What it raises.
        exchanges: How many queries in a row it may wait for, each for the timeout and the grace.
    """

    take: Take
    error: type[jostle.JostleError] = jostle.Unavailable
    exchanges: int = 1


_LATE = jostle.DeadlineExceeded
_ANYONE = jostle.count(1)

ENDED: dict[str, Ended] = {
    "Swarm.run": Ended(take()),
    "Swarm.pause": Ended(take()),
    "Swarm.step": Ended(take()),
    "Swarm.reset": Ended(take()),
    "Swarm.set": Ended(take(pi3=2.0)),
    "Swarm.inform": Ended(take(_ANYONE, 0.5)),
    "Swarm.uninform": Ended(take(_ANYONE)),
    "Swarm.inject": Ended(take(1)),
    "Swarm.remove": Ended(take(_ANYONE)),
    "Swarm.batch": Ended(take([jostle.Set(pi3=2.0)])),
    "Swarm.annotate": Ended(take("ready")),
    "Swarm.delete": Ended(take()),
    "Swarm.join": Ended(take("bob")),
    "Swarm.fork": Ended(take("twin", 0)),
    "Swarm.seek": Ended(take(step=0)),
    "Swarm.verify": Ended(take()),
    "Swarm.wait": Ended(take(step=60)),
    # These are open before the daemon is silent.
    "Swarm.states": Ended(take(), _LATE),
    "Swarm.orders": Ended(take(), _LATE),
    "Swarm.events": Ended(take(), _LATE),
    # It looks for a daemon that was started again, once.
    "Controller.advance": Ended(take(), exchanges=2),
    "Controller.leave": Ended(take()),
    "Client.create": Ended(take("school", {"n": 4})),
    "Client.restore": Ended(take(SNAPSHOT, "twin")),
    "Client.discard": Ended(take("school")),
    "Client.replay": Ended(take(recording="night")),
    "Client.submit": Ended(take(PLAN)),
    "Client.record": Ended(take("school")),
    "Client.stop_recording": Ended(take("night")),
    "Client.delete_recording": Ended(take("night")),
    "Experiment.wait": Ended(take(), _LATE),
    "connect": Ended(take()),
    "local": Ended(take()),
}
