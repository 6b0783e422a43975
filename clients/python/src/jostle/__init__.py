"""Python client of the daemon jostled: creates, steers and reads swarms.

    import jostle

    with jostle.connect() as client:
        swarm = client.create("school", jostle.Spec(n=50, seed=1))
        swarm.inform(jostle.fraction(0.1), direction=0.0)
        swarm.run(until=100.0, rate=None)
        for state in swarm.states():
            print(state.time, state.order.order, state.position.mean(axis=0))
            if state.phase == "paused":
                break

Lengths are in body sizes, speeds in free speeds, times in body sizes over free speed; angles are in
radians, counter-clockwise from +x. Every error of this package is a `JostleError`.
"""

from ._arguments import (
    Pose,
    Region,
    Select,
    count,
    disc,
    foremost,
    fraction,
    given,
    ids,
    informed,
    poses,
    within,
)
from ._at_step import AtStep
from ._attachment import Attachment
from ._audit import AuditLine, AuditOutcome
from ._changes import Change, Inform, Inject, Remove, Set, Uninform
from ._client import Client, connect, experiment
from ._commands import Options
from ._controller import Controller
from ._controller_messages import (
    Advanced,
    Arrived,
    ControllerSummary,
    Departed,
    Miss,
    Mode,
    News,
    OnTimeout,
    Puts,
)
from ._credentials import Role, WhoAmI
from ._errors import (
    AlreadyExists,
    Busy,
    Conflict,
    Contested,
    DeadlineExceeded,
    ErrorMessage,
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
from ._events import Event, JournalEntry
from ._experiment import Experiment
from ._frame import frame
from ._local import Local, local
from ._messages import (
    Awaited,
    BatchResult,
    Certificate,
    Changed,
    HistoryFrom,
    IdsResult,
    Order,
    OrderSample,
    Parameter,
    ParameterValues,
    Phase,
    Replay,
    Reply,
    ResetResult,
    RunResult,
    Scheduled,
    SetResult,
    Status,
    StepResult,
    Verified,
    WaitingClient,
    WaitingCondition,
    WhenResult,
)
from ._metrics import Metrics, RecordingMetrics, StoreMetrics, SwarmMetrics
from ._node import Hello, Limits, NodeStatus, Schemas, SwarmSummary
from ._objective import Objective
from ._recording import RecordedFrame, Recording, read_recording
from ._recordings import (
    RecordedAt,
    RecordingFormat,
    RecordingGap,
    RecordingPhase,
    RecordingStatus,
)
from ._repr import HtmlList
from ._results import ExperimentPhase, ExtraValue, OrderSeries, Progress, ResultRow, RunUnderWay
from ._snapshot import Snapshot
from ._spec import Disc, Given, Spec
from ._state import State
from ._stream import Stream
from ._swarm import Swarm
from ._sweep import Sweep, sweep
from ._tables import read_table
from ._view import View

__all__ = [
    "Advanced",
    "AlreadyExists",
    "Arrived",
    "AtStep",
    "Attachment",
    "AuditLine",
    "AuditOutcome",
    "Awaited",
    "BatchResult",
    "Busy",
    "Certificate",
    "Change",
    "Changed",
    "Client",
    "Conflict",
    "Contested",
    "Controller",
    "ControllerSummary",
    "DeadlineExceeded",
    "Departed",
    "Disc",
    "ErrorMessage",
    "Event",
    "Experiment",
    "ExperimentPhase",
    "ExtraValue",
    "Faulted",
    "Given",
    "Hello",
    "HistoryFrom",
    "HtmlList",
    "IdsResult",
    "IncorrectState",
    "Inform",
    "Inject",
    "Internal",
    "InvalidArgument",
    "JostleError",
    "JournalEntry",
    "Limits",
    "Local",
    "Metrics",
    "Miss",
    "Mode",
    "News",
    "NodeStatus",
    "NotFound",
    "Objective",
    "OnTimeout",
    "Options",
    "Order",
    "OrderSample",
    "OrderSeries",
    "Parameter",
    "ParameterValues",
    "PermissionDenied",
    "Phase",
    "Pose",
    "Progress",
    "Puts",
    "RecordedAt",
    "RecordedFrame",
    "Recording",
    "RecordingFormat",
    "RecordingGap",
    "RecordingMetrics",
    "RecordingPhase",
    "RecordingStatus",
    "Region",
    "Remove",
    "Replay",
    "Reply",
    "ResetResult",
    "ResourceExhausted",
    "ResultRow",
    "Role",
    "RunResult",
    "RunUnderWay",
    "Scheduled",
    "Schemas",
    "Select",
    "Set",
    "SetResult",
    "Snapshot",
    "Spec",
    "State",
    "Status",
    "StepResult",
    "StorageFull",
    "StoreMetrics",
    "Stream",
    "Swarm",
    "SwarmMetrics",
    "SwarmSummary",
    "Sweep",
    "Unavailable",
    "Uninform",
    "Verified",
    "View",
    "WaitingClient",
    "WaitingCondition",
    "WhenResult",
    "WhoAmI",
    "connect",
    "count",
    "disc",
    "experiment",
    "foremost",
    "fraction",
    "frame",
    "given",
    "ids",
    "informed",
    "local",
    "poses",
    "read_recording",
    "read_table",
    "sweep",
    "within",
]
