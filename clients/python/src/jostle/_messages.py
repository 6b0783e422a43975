"""What crosses the wire as JSON, as msgspec structs.

Unknown fields in what a daemon sends are ignored, so that this version can read a newer daemon.
Unless said otherwise lengths are in body sizes, speeds in free speeds, times in their quotient,
and angles are in radians, counter-clockwise from +x.
"""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import msgspec

from ._errors import Internal

WIRE_VERSION = 1
"""The version of the contract this package speaks."""

Phase = Literal["paused", "running", "faulted"]
"""What a swarm is doing: standing still, stepping, or stopped by a step that failed."""


class Disc(msgspec.Struct, frozen=True, tag_field="kind", tag="disc"):
    """A start: uniformly in a disc, one after the other, none overlapping an earlier one.

    Attributes:
        radius: Of the disc, body sizes; None is √n, at least 1.
    """

    radius: float | None = None


class Given(msgspec.Struct, frozen=True, tag_field="kind", tag="given"):
    """A start: exactly there, to the bit. `jostle.given` makes one from arrays.

    Attributes:
        x: Absolute positions, body sizes, n of them.
        y: Absolute positions, body sizes, n of them.
        alpha: Headings in radians, n of them.
    """

    x: list[float]
    y: list[float]
    alpha: list[float]


class Spec(msgspec.Struct, frozen=True, kw_only=True):
    """What a swarm is made from: same spec, same seed, same bytes.

    Attributes:
        n: The number of individuals at the start: 1 to the daemon's limit.
        pi1: Length over width of a body: 1 (a disc) to 32.
        pi2: Weight of individuals informed without a weight: 0 or more.
        pi3: Body size over turning radius: above 0.
        pi4: Translational over rotational drag: above 0.
        dt: The time step: above 0, and short enough that no body is carried across another.
        contacts: Which of a pair's contacts constrain it.
        seed: The seed of every draw: 0 to 2⁵³ - 1.
        start: Where the individuals begin.
        attraction: What an individual turns towards.
        noise: Intensity of the noise on the turning rate.
        publish_every: Steps between two published states: 1 or more.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    n: int
    pi1: float = 4.0
    pi2: float = 0.5
    pi3: float = 1.0
    pi4: float = 10.0
    dt: float = 0.02
    contacts: str = "endpoints"
    seed: int = 0
    start: Disc | Given = Disc()
    attraction: dict[str, Any] = msgspec.field(default_factory=lambda: {"kind": "all"})
    noise: float = 0.0
    publish_every: int = 5
    rate: float | None = 1.0


class Order(msgspec.Struct, frozen=True, kw_only=True):
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


class Certificate(msgspec.Struct, frozen=True, kw_only=True):
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


class ParameterValues(msgspec.Struct, frozen=True, kw_only=True):
    """The parameters that may change while a swarm lives; `Spec` says what each means."""

    pi1: float
    pi2: float
    pi3: float
    pi4: float
    publish_every: int


class Reply(msgspec.Struct, frozen=True, kw_only=True):
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
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    steps: int
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
        state_hash: BLAKE3 of the state, in hexadecimal.
        order: Order and drift.
        certificate: How exact the state is.
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
    state_hash: str
    order: Order
    certificate: Certificate


class SpecReply(Reply, frozen=True, kw_only=True):
    """What a swarm was made from, every default filled in."""

    result: Spec


class OrderSample(msgspec.Struct, frozen=True, kw_only=True):
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


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """Something that happened to a swarm.

    Attributes:
        swarm: The swarm's name.
        number: Counts the swarm's events from 1; a gap tells that some were missed.
        epoch: Grows whenever `step` does not continue what was published before.
        step: The step it happened at.
        time: `step · dt`.
        phase: What the swarm does from then on.
        kind: `created`, `phase`, `command`, `lapsed`, `fault` or `deleted`.
        reason: Why, for `phase` and `fault`.
        seq: For `command`: counts the swarm's applied commands.
        verb: For `command`.
        args: For `command`: its arguments as they came.
        client: For `command`: who says to have sent it.
        request_id: For `command`: what the sender called it.
        ids: For `lapsed`: who is uninformed again, ascending.
    """

    swarm: str
    number: int
    epoch: int
    step: int
    time: float
    phase: Phase
    kind: str
    reason: str | None = None
    seq: int | None = None
    verb: str | None = None
    args: Any = None
    client: str | None = None
    request_id: str | None = None
    ids: list[int] | None = None


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What a daemon refuses to go beyond.

    Attributes:
        max_individuals: In one swarm.
        max_swarms: At once.
        max_memory_bytes: Of all swarms together.
        max_message_bytes: The largest payload; larger ones vanish on the way.
        max_hz: States published per second and swarm.
    """

    max_individuals: int
    max_swarms: int
    max_memory_bytes: int
    max_message_bytes: int
    max_hz: int


class Hello(msgspec.Struct, frozen=True, kw_only=True):
    """Who a daemon is.

    Attributes:
        node: Its name.
        version: Its version.
        wire_version: The version of the contract it speaks.
        limits: What it refuses to go beyond.
    """

    node: str
    version: str
    wire_version: int
    limits: Limits


class NodeStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How a daemon fares.

    Attributes:
        node: Its name.
        uptime_secs: Seconds since it started.
        swarms: How many it hosts.
        running: How many of them run.
        faulted: How many of them faulted.
        individuals: In all swarms together.
        memory_bytes: Set aside for the swarms.
        clients: Connected.
    """

    node: str
    uptime_secs: float
    swarms: int
    running: int
    faulted: int
    individuals: int
    memory_bytes: int
    clients: int


class SwarmSummary(msgspec.Struct, frozen=True, kw_only=True):
    """A swarm in a list; the fields mean what they mean in `Status`, `order` is that now."""

    swarm: str
    phase: Phase
    reason: str | None = None
    step: int
    time: float
    n: int
    informed: int
    order: float
    rate: float | None = None
    real_time_factor: float | None = None


class Swarms(msgspec.Struct, frozen=True, kw_only=True):
    """All that a daemon hosts, ordered by name."""

    swarms: list[SwarmSummary]


T = TypeVar("T")


def read_reply(payload: bytes, kind: type[T]) -> T:
    """Reads an answer: the fields of its `result` and of the envelope around it, as one struct.

    Raises:
        Internal: It is not what the contract says.
    """
    fields = read_json(payload, dict[str, Any])
    result = fields.pop("result", None)
    # No result has a field of the envelope's names; if one ever has, the envelope's stands.
    return convert({**(result if isinstance(result, dict) else {}), **fields}, kind)


def read_event(payload: bytes) -> Event:
    """Reads an event, what happened beside when it happened.

    Raises:
        Internal: It is not what the contract says.
    """
    fields = read_json(payload, dict[str, Any])
    event = fields.pop("event", None)
    return convert({**(event if isinstance(event, dict) else {}), **fields}, Event)


def read_json(payload: bytes, kind: type[T]) -> T:
    """Reads JSON as `kind`.

    Raises:
        Internal: It is not what the contract says.
    """
    try:
        return msgspec.json.decode(payload, type=kind)
    except msgspec.DecodeError as error:
        raise _unreadable(kind, error) from error


def convert(fields: object, kind: type[T]) -> T:
    """Reads what was decoded already as `kind`.

    Raises:
        Internal: It is not what the contract says.
    """
    try:
        return msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        raise _unreadable(kind, error) from error


def _unreadable(kind: type[object], error: Exception) -> Internal:
    name = getattr(kind, "__name__", str(kind))
    return Internal(f"the daemon sent a {name} that cannot be read: {error}")
