"""Steers and reads the swarms that a jostled daemon hosts.

    import jostle

    with jostle.connect() as client:
        swarm = client.create("school", jostle.Spec(n=50, seed=1))
        swarm.inform(jostle.fraction(0.1), direction=0.0)
        swarm.run(until=100.0, rate=None)
        for state in swarm.states():
            print(state.time, state.order.order, state.position.mean(axis=0))
            if state.phase == "paused":
                break

Lengths are in body sizes, speeds in free speeds, times in their quotient; angles are in radians,
counter-clockwise from +x. Everything raised on purpose is a `JostleError`.
"""

from ._arguments import (
    Region,
    Select,
    count,
    disc,
    foremost,
    fraction,
    given,
    ids,
    within,
)
from ._client import Client, connect
from ._errors import (
    AlreadyExists,
    Busy,
    Conflict,
    DeadlineExceeded,
    Faulted,
    IncorrectState,
    Internal,
    InvalidArgument,
    JostleError,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
    StorageFull,
    Unavailable,
)
from ._messages import (
    Certificate,
    Disc,
    Event,
    Given,
    Hello,
    IdsResult,
    Limits,
    NodeStatus,
    Order,
    OrderSample,
    ParameterValues,
    Phase,
    Reply,
    ResetResult,
    RunResult,
    SetResult,
    Spec,
    Status,
    StepResult,
    SwarmSummary,
)
from ._state import State
from ._stream import Stream
from ._swarm import Options, Swarm

__all__ = [
    "AlreadyExists",
    "Busy",
    "Certificate",
    "Client",
    "Conflict",
    "DeadlineExceeded",
    "Disc",
    "Event",
    "Faulted",
    "Given",
    "Hello",
    "IdsResult",
    "IncorrectState",
    "Internal",
    "InvalidArgument",
    "JostleError",
    "Limits",
    "NodeStatus",
    "NotFound",
    "Options",
    "Order",
    "OrderSample",
    "ParameterValues",
    "PermissionDenied",
    "Phase",
    "Region",
    "Reply",
    "ResetResult",
    "ResourceExhausted",
    "RunResult",
    "Select",
    "SetResult",
    "Spec",
    "State",
    "Status",
    "StepResult",
    "StorageFull",
    "Stream",
    "Swarm",
    "SwarmSummary",
    "Unavailable",
    "connect",
    "count",
    "disc",
    "foremost",
    "fraction",
    "given",
    "ids",
    "within",
]
