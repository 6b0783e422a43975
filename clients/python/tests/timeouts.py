"""Every call with a `timeout`, and the error that it raises when the daemon never replies."""

from __future__ import annotations

from dataclasses import dataclass

import jostle
from recorder import SNAPSHOT
from rows import PLAN, Arguments, call


@dataclass(frozen=True)
class Ended:
    """How a call ends.

    Attributes:
        arguments: Its arguments without the `timeout`.
        error: What it raises.
        exchanges: How many queries in a row it may wait for, each for the timeout and the grace.
    """

    arguments: Arguments
    error: type[jostle.JostleError] = jostle.Unavailable
    exchanges: int = 1


_LATE = jostle.DeadlineExceeded
_ANYONE = jostle.count(1)

ENDED: dict[str, Ended] = {
    "Swarm.run": Ended(call()),
    "Swarm.pause": Ended(call()),
    "Swarm.step": Ended(call()),
    "Swarm.reset": Ended(call()),
    "Swarm.set": Ended(call(pi3=2.0)),
    "Swarm.inform": Ended(call(_ANYONE, 0.5)),
    "Swarm.uninform": Ended(call(_ANYONE)),
    "Swarm.inject": Ended(call(1)),
    "Swarm.remove": Ended(call(_ANYONE)),
    "Swarm.batch": Ended(call([jostle.Set(pi3=2.0)])),
    "Swarm.annotate": Ended(call("ready")),
    "Swarm.protect": Ended(call()),
    "Swarm.when": Ended(call(cancel=True)),
    "Swarm.delete": Ended(call()),
    "Swarm.join": Ended(call("bob")),
    "Swarm.fork": Ended(call("twin", 0)),
    "Swarm.seek": Ended(call(step=0)),
    "Swarm.verify": Ended(call()),
    "Swarm.wait": Ended(call(step=60)),
    # These are open before the daemon stops replying.
    "Swarm.states": Ended(call(), _LATE),
    "Swarm.orders": Ended(call(), _LATE),
    "Swarm.events": Ended(call(), _LATE),
    # It checks once for a restarted daemon.
    "Controller.advance": Ended(call(), exchanges=2),
    "Controller.leave": Ended(call()),
    "Client.create": Ended(call("school", {"n": 4})),
    "Client.restore": Ended(call(SNAPSHOT, "twin")),
    "Client.discard": Ended(call("school")),
    "Client.replay": Ended(call(recording="night")),
    "Client.submit": Ended(call(PLAN)),
    "Client.play": Ended(call(PLAN)),
    "Client.record": Ended(call("school")),
    "Client.stop_recording": Ended(call("night")),
    "Client.delete_recording": Ended(call("night")),
    "Experiment.wait": Ended(call(), _LATE),
    "connect": Ended(call()),
    "local": Ended(call()),
}
