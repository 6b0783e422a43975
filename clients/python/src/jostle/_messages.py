"""Replies of swarms, as msgspec structs.

Unknown fields are ignored, so that this version can read a newer daemon. Lengths are in body
sizes, speeds in free speeds, times in body sizes over free speed, and angles in radians,
counter-clockwise from +x.

On the wire the fields of a reply are in `result`, within the envelope of every reply; here both
are the fields of one struct, which `_decode` makes.
"""

from __future__ import annotations

from typing import Any, Generic, Literal, TypeVar

from ._repr import HtmlStruct
from ._spec import Spec

T = TypeVar("T")

Phase = Literal["paused", "running", "faulted"]
"""The phase of a swarm: paused, stepping, or stopped by a step that failed."""


class Order(HtmlStruct, frozen=True, kw_only=True):
    """The order and drift of a swarm, now and as means since the start or the last reset.

    Attributes:
        order: The order, the length of the mean heading: 0 to 1.
        mean_order: Its time mean, `v` of eq. (8); None before the first step.
        velocity: The mean heading (x, y), the centroid's velocity in free speeds.
        mean_velocity: Its time mean; None before the first step.
        direction: The common direction of the informed individuals, radians: that of the sum of
            their directions, each times its weight; None if there are none, or they disagree so
            much that `direction_strength` is below 0.1.
        direction_strength: How far they agree, the length of that sum divided by the sum of the
            weights: 0 to 1; None if there are none, and from an earlier version.
        drift: The centroid's velocity along that direction, free speeds; None without one.
        mean_drift: Its mean over the steps with such a direction.
    """

    order: float
    mean_order: float | None = None
    velocity: tuple[float, float]
    mean_velocity: tuple[float, float] | None = None
    direction: float | None = None
    direction_strength: float | None = None
    drift: float | None = None
    mean_drift: float | None = None


class Certificate(HtmlStruct, frozen=True, kw_only=True):
    """The accuracy of a state.

    Attributes:
        worst_gap: The smallest gap between two bodies, body sizes; negative is overlap; None if no
            two are near. It is measured independently of the solver.
        residual: `max |min(λ, s)|` of the step that led here, body sizes: at most 1e-9 unless the
            step was degraded.
        degraded: Number of steps since the start or reset with a larger residual.
        crossed: Number of pairs with crossing axes.
        contacts: Number of contacts that constrained the step.
        iterations: Number of iterations of the solver.
    """

    worst_gap: float | None = None
    residual: float
    degraded: int
    crossed: int
    contacts: int
    iterations: int


class ParameterValues(HtmlStruct, frozen=True, kw_only=True):
    """The parameters that `set` can change; see `Spec`."""

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
    measures: list[str] | None = None
    max_idle_secs: float | None = None


class Reply(HtmlStruct, frozen=True, kw_only=True):
    """A reply of a swarm.

    Attributes:
        swarm: The swarm's name.
        epoch: Increases when `step` does not continue what was published before.
        step: The step at which the command took effect; for `step`, the step reached.
        time: `step · dt`, body sizes over free speed.
        phase: The phase after the command.
        seq: Number of commands applied to the swarm.
    """

    swarm: str
    epoch: int
    step: int
    time: float
    phase: Phase
    seq: int


class Scheduled(Reply, Generic[T], frozen=True, kw_only=True):
    """The reply to a command of `Swarm.at`.

    If the step lies ahead, the command waits: at that step an event `command` of the same
    `request_id` reports that it was executed, or an event `refused` why it was not. If the swarm
    was at the step, the command was executed at once.

    Attributes:
        applies_at_step: The step at which the command is or was executed.
        outcome: What the method of `Swarm` returns, if the command was executed at once; None if it
            waits.
    """

    applies_at_step: int
    outcome: T | None = None


class CreateResult(Reply, frozen=True, kw_only=True):
    """The reply to `create`, `fork` and `restore`.

    Attributes:
        created: False if an equal swarm existed.
        spec: Its spec, with all defaults.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    created: bool
    spec: Spec
    state_hash: str


class RunResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.run`.

    Attributes:
        until_step: The step it will pause at; None if it has no end.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    until_step: int | None = None
    rate: float | None = None


class WhenResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.when`.

    Attributes:
        holds: With `event`: whether the condition holds already, so that it does not wait.
        id: The id of the condition that waits now; None if none does, and from older daemons.
    """

    holds: bool | None = None
    id: str | None = None


class StepResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.step`.

    Attributes:
        steps: Number of steps that were taken; fewer than requested if another command interrupted
            them.
        durable_step: The last step that a crash of the daemon would not take back. It follows
            `step` within a few milliseconds, unless the disk is full.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    steps: int
    durable_step: int
    state_hash: str


class ResetResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.reset`.

    Attributes:
        seed: The seed of the swarm.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    seed: int
    state_hash: str


class SetResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.set`.

    Attributes:
        before: The values before.
        now: The values now.
        scaled_by: The factor by which `make_room` scaled the positions; 1 is not at all.
        published_hz: As in `Status`.
    """

    before: ParameterValues
    now: ParameterValues
    scaled_by: float
    published_hz: float | None = None


class IdsResult(Reply, frozen=True, kw_only=True):
    """The reply to `inform`, `uninform`, `inject` and `remove`.

    Attributes:
        ids: The ids of the individuals concerned, ascending.
        n: The size of the group after the command.
    """

    ids: list[int]
    n: int


class Changed(HtmlStruct, frozen=True, kw_only=True):
    """The result of one change of a `batch`; fields of other verbs are None.

    Attributes:
        verb: `set`, `inform`, `uninform`, `inject` or `remove`.
        before: For `set`: the values before.
        now: For `set`: the values now.
        scaled_by: For `set`: the factor by which `make_room` scaled the positions; 1 is not at all.
        ids: For the others: the ids of the individuals concerned, ascending.
        n: For the others: the size of the group after the change.
    """

    verb: str
    before: ParameterValues | None = None
    now: ParameterValues | None = None
    scaled_by: float | None = None
    ids: list[int] | None = None
    n: int | None = None


class BatchResult(Reply, frozen=True, kw_only=True):
    """The reply to `Swarm.batch`; `seq` has increased by the number of its changes.

    Attributes:
        results: The result of each change, in their order.
    """

    results: list[Changed]


class HistoryFrom(HtmlStruct, frozen=True, kw_only=True):
    """The oldest stored checkpoint of a swarm: the history after it can be replayed.

    Attributes:
        epoch: Its epoch.
        step: Its step.
    """

    epoch: int
    step: int


class Replay(HtmlStruct, frozen=True, kw_only=True):
    """A playback of a recording.

    Attributes:
        of: The swarm that was recorded.
        frame: The number of the present frame, from 1.
        frames: Number of frames.
        position: Time units since its first frame.
        duration: Time units from its first frame to its last, resets and gaps left out.
    """

    of: str
    frame: int
    frames: int
    position: float
    duration: float


class Awaited(HtmlStruct, frozen=True, kw_only=True):
    """A controller that the others wait for in lock-step.

    Attributes:
        controller: Its name.
        secs: Seconds that they have waited.
        deadline_secs: Its deadline, seconds.
    """

    controller: str
    secs: float
    deadline_secs: float


class WaitingCondition(HtmlStruct, frozen=True, kw_only=True):
    """A condition of `Swarm.when` that waits.

    Attributes:
        id: By which `Swarm.when(cancel=True, id=...)` removes it.
        condition: The condition.
        action: `pause`, `commands` or `event`.
        event: The name of its event; None without one.
        client: The client that sent it; None if it is not known.
        evaluated: False if the condition does not hold since its measures need too much time or too
            many earlier states: the group has grown, or an earlier version accepted more of them.
            None if it is evaluated.
    """

    id: str
    condition: str
    action: Literal["pause", "commands", "event"]
    event: str | None = None
    client: str | None = None
    evaluated: bool | None = None


class WaitingClient(HtmlStruct, frozen=True, kw_only=True):
    """A client that waits for a condition by `Swarm.wait`.

    Attributes:
        condition: The condition.
        user: The user; None on a daemon without users.
    """

    condition: str
    user: str | None = None


class Status(Reply, frozen=True, kw_only=True):
    """The status of a swarm.

    Attributes:
        reason: Why it is paused or faulted.
        until_step: The step it will pause at; None if it has no end.
        rate: Time units per second of wall clock; None is as fast as possible.
        real_time_factor: The rate that it reached lately; None while it does not run.
        behind_rate: Whether it lately omitted steps that were due, since they take longer than
            `rate` allows.
        published_hz: How many states a second it publishes at most while it runs: what `rate`, `dt`
            and `publish_every` ask for, or the daemon's `max_hz` if that is less; None for a
            playback and from older daemons.
        n: The size of the group.
        informed: Number of informed individuals.
        seed: The seed of all random draws.
        dt: The time step, body sizes over free speed.
        parameters: The parameters that `set` can change.
        scheduled: Number of commands that wait for their step.
        when: The conditions that it waits for; None without any. See `Swarm.when`.
        conditions: The same conditions: their ids, actions and clients; None without any.
        waits: The conditions for which clients wait, see `Swarm.wait`; None without any.
        controllers: Number of controllers that have joined.
        waiting_for: The controllers that the swarm waits for in lock-step.
        state_hash: BLAKE3 of the state, in hexadecimal.
        order: Order and drift.
        certificate: The accuracy of the state.
        history_from: The oldest stored checkpoint; None while it cannot be read.
        replay: The position, if it is a playback.
        verifying: The fraction of the history that a running `verify` has replayed, 0 to 1; None if
            none is running.
    """

    reason: str | None = None
    until_step: int | None = None
    rate: float | None = None
    real_time_factor: float | None = None
    behind_rate: bool
    published_hz: float | None = None
    n: int
    informed: int
    seed: int
    dt: float
    parameters: ParameterValues
    scheduled: int
    when: list[str] | None = None
    conditions: list[WaitingCondition] | None = None
    waits: list[WaitingClient] | None = None
    controllers: int
    waiting_for: list[Awaited]
    state_hash: str
    order: Order
    certificate: Certificate
    history_from: HistoryFrom | None = None
    replay: Replay | None = None
    verifying: float | None = None


class Verified(Reply, frozen=True, kw_only=True):
    """The result of a replay of a swarm's history.

    Attributes:
        from_step: The step of the checkpoint that it began at.
        to_step: The step that it ended at.
        hashes: Number of hashes that were compared: those in the history, and the present one of a
            paused swarm.
        differs_at: The first step whose hash differs; None if there is none.
        differs_in_epoch: The epoch of that step.
    """

    from_step: int
    to_step: int
    hashes: int
    differs_at: int | None = None
    differs_in_epoch: int | None = None


class ExperimentFile(Reply, frozen=True, kw_only=True):
    """The commands of a swarm since its start, as the file of an experiment.

    Attributes:
        file: The text of the file, TOML.
        setpoints: The text of the CSV that it names; None if it names none.
        steps: The step of the swarm.
        state_hash: BLAKE3 of the state at that step, in hexadecimal.
    """

    file: str
    setpoints: str | None = None
    steps: int
    state_hash: str


class Parameter(HtmlStruct, frozen=True, kw_only=True):
    """A parameter of a swarm, with the data of a form or a slider.

    Attributes:
        name: Its name in the spec.
        doc: A description in one line.
        unit: Its unit; `1` if it has none.
        kind: The type of its values: `number`, `integer` or `choice`.
        minimum: The smallest value; None if there is none.
        exclusive_minimum: The value must be above this; None if there is no such bound.
        maximum: The largest value at present; None if there is none.
        choices: The values of a choice, without their numbers; empty otherwise.
        nullable: Whether None is a value.
        default: The default; None if it must be given.
        value: The present value.
        live: Whether a command can change it.
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
    """All parameters of a swarm except its start, in the order of its spec."""

    parameters: list[Parameter]


class MeasureValue(HtmlStruct, frozen=True, kw_only=True):
    """A measure of a state."""

    name: str
    value: float | None
    unit: str


class HistogramMessage(HtmlStruct, frozen=True, kw_only=True):
    """A histogram as it is sent."""

    name: str
    unit: str
    edges: list[float]
    counts: list[int]
    values: list[float]


class Measures(Reply, frozen=True, kw_only=True):
    """Measures of the newest state of a swarm, in the requested order."""

    measures: list[MeasureValue]
    histogram: HistogramMessage | None = None


class SpecReply(Reply, frozen=True, kw_only=True):
    """The spec of a swarm, with all defaults."""

    result: Spec


class OrderSample(HtmlStruct, frozen=True, kw_only=True):
    """A published order; the other fields are those of `State` and `Status`.

    Attributes:
        measures: The measures that the swarm publishes (`Swarm.set`) by name, each in its unit; a
            value is None where it is undefined or the group too large. None without any.
    """

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
    measures: dict[str, float | None] | None = None
