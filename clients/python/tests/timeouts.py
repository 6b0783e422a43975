"""Every call with a `timeout`, and the error that it raises when the daemon never replies."""

from __future__ import annotations

from dataclasses import dataclass

import jostle
from arguments import TAKEN
from recorder import SNAPSHOT
from rows import PLAN, Arguments, call
from rows_of_swarms import COMMANDS


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
_FIRST = {row.call: row.arguments for row in reversed(COMMANDS)}

ENDED: dict[str, Ended] = {
    # Each that can have an `at_step`, with the arguments of its first row.
    **{call: Ended(_FIRST[call]) for call, taken in TAKEN.items() if "at_step" in taken},
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
