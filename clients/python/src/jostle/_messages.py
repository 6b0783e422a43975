"""What swarms answer, as msgspec structs.

Unknown fields in what a daemon sends are ignored, so that this version can read a newer daemon.
Unless said otherwise lengths are in body sizes, speeds in free speeds, times in their quotient,
and angles are in radians, counter-clockwise from +x.

The wire puts what was asked for into `result`, within what every answer tells; here both are the
fields of one struct, which `_reading` makes of them.
"""

from __future__ import annotations

from typing import Any, Literal

from ._show import Shown
from ._spec import Spec

Phase = Literal["paused", "running", "faulted"]
"""What a swarm is doing: standing still, stepping, or stopped by a step that failed."""


class Order(Shown, frozen=True, kw_only=True):
    """How ordered a swarm is and where it drifts, now and on average since the start or reset.

    Attributes:
        order: The polar order parameter, 0 to 1.
        mean_order: Its mean over steps; None before the first.
        velocity: The centroid's velocity (x, y), free speeds; it is the mean heading.
        mean_velocity: Its mean over steps; None before the first.
        direction: The informed individuals' common direction in radians; None if there is none.
        drift: The velocity along that direction, free speeds.
        mean_drift: Its mean over the steps that had such a direction.
    """

    order: float
    mean_order: float | None = None
    velocity: tuple[float, float]
    mean_velocity: tuple[float, float] | None = None
    direction: float | None = None
    drift: float | None = None
    mean_drift: float | None = None


class Certificate(Shown, frozen=True, kw_only=True):
    """What shows that a state is an exact one.

    Attributes:
        worst_gap: The smallest gap between two bodies, body sizes; negative is overlap; None if
            no two are near. Measured apart from the solver.
        residual: Of the step that led here, body sizes: at most 1e-9 unless degraded.
        degraded: How many steps since the start or reset were taken with a larger residual.
        crossed: How many pairs have crossing axes.
        contacts: How many contacts constrained the step.
        iterations: How many iterations the solver took.
    """

    worst_gap: float | None = None
    residual: float
    degraded: int
    crossed: int
    contacts: int
    iterations: int


class ParameterValues(Shown, frozen=True, kw_only=True):
    """The parameters that may change while a swarm lives; `Spec` says what each means."""

    pi1: float
    pi2: float
    pi3: float
    pi4: float
    contacts: str
    stepping: str
    relinearise: int
    attraction: dict[str, Any]
    noise: float
    publish_every: int


class Reply(Shown, frozen=True, kw_only=True):
    """What every answer of a swarm tells.

    Attributes:
        swarm: The swarm's name.
        epoch: Grows whenever `step` does not continue what was published before.
        step: The step at which the command took effect; for `step`, the step reached.
        time: `step · dt`.
        phase: What the swarm does from then on.
        seq: Counts the swarm's applied commands.
    """

    swarm: str
    epoch: int
    step: int
    time: float
    phase: Phase
    seq: int


class Scheduled(Reply, frozen=True, kw_only=True):
    """A command that waits for its step, as one does whose `at_step` lies ahead.

    When its step comes an event `command` of the same `request_id` tells that it was carried out,
    or one `refused` why it was not.

    Attributes:
        applies_at_step: The step it will be carried out at.
    """

    applies_at_step: int


class CreateResult(Reply, frozen=True, kw_only=True):
    """What `create` did.

    Attributes:
        created: False if an equal swarm was there already.
        spec: What it is made from, every default filled in.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    created: bool
    spec: Spec
    state_hash: str


class RunResult(Reply, frozen=True, kw_only=True):
    """How a swarm now runs.

    Attributes:
        until_step: The step it will pause at; None if at none.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    until_step: int | None = None
    rate: float | None = None


class StepResult(Reply, frozen=True, kw_only=True):
    """Where `step` arrived.

    Attributes:
        steps: How many were taken; fewer than asked for if another command came between.
        durable_step: The last step that a crash of the daemon would not take back. It follows
            `step` within a few milliseconds, unless the disk is full.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    steps: int
    durable_step: int
    state_hash: str


class ResetResult(Reply, frozen=True, kw_only=True):
    """What a reset swarm begins from.

    Attributes:
        seed: Its seed.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    seed: int
    state_hash: str


class SetResult(Reply, frozen=True, kw_only=True):
    """What `set` did.

    Attributes:
        before: The values before.
        now: The values now.
        scaled_by: By how much positions were scaled to make room; 1 if not at all.
    """

    before: ParameterValues
    now: ParameterValues
    scaled_by: float


class IdsResult(Reply, frozen=True, kw_only=True):
    """The individuals a command was about.

    Attributes:
        ids: Their ids, ascending.
        n: The size of the group now.
    """

    ids: list[int]
    n: int


class Changed(Shown, frozen=True, kw_only=True):
    """What one change of a `batch` came to; what is not of its verb is None.

    Attributes:
        verb: `set`, `inform`, `uninform`, `inject` or `remove`.
        before: For `set`: the values before.
        now: For `set`: the values now.
        scaled_by: For `set`: by how much positions were scaled to make room; 1 if not at all.
        ids: For the others: the ids of those it was about, ascending.
        n: For the others: the size of the group after it.
    """

    verb: str
    before: ParameterValues | None = None
    now: ParameterValues | None = None
    scaled_by: float | None = None
    ids: list[int] | None = None
    n: int | None = None


class BatchResult(Reply, frozen=True, kw_only=True):
    """What a `batch` came to; `seq` has grown by the number of its changes.

    Attributes:
        results: One for each change, in their order.
    """

    results: list[Changed]


class HistoryFrom(Shown, frozen=True, kw_only=True):
    """The oldest checkpoint kept of a swarm: all that came after it can be told again.

    Attributes:
        epoch: Its epoch.
        step: Its step.
    """

    epoch: int
    step: int


class Replay(Shown, frozen=True, kw_only=True):
    """A recording that is shown as if it were a swarm, and where it is.

    Attributes:
        of: The swarm that was recorded.
        frame: The number of the frame it is at, from 1.
        frames: How many frames it has.
        position: Time units since its first frame.
        duration: Time units from its first frame to its last, resets and gaps left out.
    """

    of: str
    frame: int
    frames: int
    position: float
    duration: float


class Awaited(Shown, frozen=True, kw_only=True):
    """A controller that the others wait for.

    Attributes:
        controller: Its name.
        secs: For how long.
        deadline_secs: After how long they wait no more.
    """

    controller: str
    secs: float
    deadline_secs: float


class Status(Reply, frozen=True, kw_only=True):
    """What a swarm is and does.

    Attributes:
        reason: Why it is paused or faulted.
        until_step: The step it will pause at.
        rate: Time units per second of wall clock; None is as fast as possible.
        real_time_factor: What it lately ran at, in the same unit; None while it does not run.
        n: The size of the group.
        informed: How many of it are informed.
        seed: The seed of every draw.
        dt: The time step.
        parameters: Those that may change while it lives.
        scheduled: How many commands wait for their step.
        controllers: How many controllers have joined.
        waiting_for: The controllers that the swarm waits for in lock-step.
        state_hash: BLAKE3 of the state, in hexadecimal.
        order: Order and drift.
        certificate: How exact the state is.
        history_from: Where the history begins that is kept of it; None while that cannot be
            read.
        replay: Where it is, if it is the replay of a recording.
        verifying: The share of its history that a `verify` under way has replayed, 0 to 1; None if
            none is under way.
    """

    reason: str | None = None
    until_step: int | None = None
    rate: float | None = None
    real_time_factor: float | None = None
    n: int
    informed: int
    seed: int
    dt: float
    parameters: ParameterValues
    scheduled: int
    controllers: int
    waiting_for: list[Awaited]
    state_hash: str
    order: Order
    certificate: Certificate
    history_from: HistoryFrom | None = None
    replay: Replay | None = None
    verifying: float | None = None


class Verified(Reply, frozen=True, kw_only=True):
    """Whether a swarm's past comes out the same when it is told again.

    Attributes:
        from_step: The step of the checkpoint it was told from.
        to_step: The step it was told to.
        hashes: How many hashes were compared: those that were written down on the way, and its
            present one of a swarm that stands still.
        differs_at: The first step that has another hash than it had; None if there is none.
        differs_in_epoch: The epoch that step is of: after a reset steps are counted anew.
    """

    from_step: int
    to_step: int
    hashes: int
    differs_at: int | None = None
    differs_in_epoch: int | None = None


class Parameter(Shown, frozen=True, kw_only=True):
    """A parameter of a swarm, with all that a form or a slider needs.

    Attributes:
        name: Its name in the spec.
        doc: What it means, in a line.
        unit: Its unit; `1` if it has none.
        kind: What values it takes: `number`, `integer` or `choice`.
        minimum: The least value; None if there is none.
        exclusive_minimum: What it must be above; None if nothing.
        maximum: The largest value as things are; None if there is none.
        choices: The values of a choice, of those that take numbers the kind alone; empty otherwise.
        nullable: Whether None is a value.
        default: What it is if left out; None if it must be given.
        value: What it is now.
        live: Whether it may change while the swarm lives.
        changed_by: The verbs that change it.
    """

    name: str
    doc: str
    unit: str
    kind: str
    minimum: float | None = None
    exclusive_minimum: float | None = None
    maximum: float | None = None
    choices: list[Any]
    nullable: bool
    default: Any = None
    value: Any = None
    live: bool
    changed_by: list[str]


class Parameters(Reply, frozen=True, kw_only=True):
    """All parameters of a swarm but its start, in the order of its spec."""

    parameters: list[Parameter]


class SpecReply(Reply, frozen=True, kw_only=True):
    """What a swarm was made from, every default filled in."""

    result: Spec


class OrderSample(Shown, frozen=True, kw_only=True):
    """One published order; the fields mean what they mean in `State` and `Status`."""

    swarm: str
    epoch: int
    frame: int
    step: int
    time: float
    phase: Phase
    n: int
    informed: int
    order: Order
    certificate: Certificate
    rate: float | None = None
    real_time_factor: float | None = None
