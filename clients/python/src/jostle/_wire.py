"""What a daemon sends, and the spec of a swarm.

Written by `cargo run --release -p jostle-contract`; not by hand.

Unknown fields are ignored, so that this version can read a newer daemon. Lengths are in body
sizes, speeds in free speeds, times in body sizes over free speed, and angles in radians,
counter-clockwise from +x.

On the wire the fields of a reply are in `result`, within the envelope of every reply, and those of
an event in `event`; here both are the fields of one struct, which `_decode` makes.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import msgspec

from ._dated import Dated
from ._repr import HtmlStruct, bar_html
from ._spec import Disc, Given

Departure = Literal["left", "lost", "late"]
"""Why a controller has left.

- `left`: It sent `leave`.
- `lost`: Its liveliness token disappeared.
- `late`: It missed three deadlines in a row, or sent nothing for `max_idle_secs`.
"""

ExperimentPhase = Literal["queued", "running", "paused", "finished", "cancelled", "failed"]
"""What an experiment is doing.

- `queued`: It waits for those before it.
- `running`: Its runs are carried out.
- `paused`: Its runs are paused until it is resumed, also when the daemon restarts.
- `finished`: Every run is over, and the tables are written.
- `cancelled`: It was ended half way.
- `failed`: It cannot go on.
"""

Mode = Literal["lockstep", "free_running"]
"""When a swarm with a controller steps.

- `lockstep`: When every controller in this mode has advanced.
- `free_running`: At its rate; the controller puts set-points on `ctl/{controller}`.
"""

OnTimeout = Literal["hold", "free", "pause"]
"""What happens to the individuals of a late controller.

- `hold`: They keep their last set-points, also after it has left.
- `free`: They are uninformed.
- `pause`: The swarm pauses and replies to the waiting controllers.
"""

OriginKind = Literal["fork", "restore", "play"]
"""How a swarm was made from another one.

- `fork`: By `fork`.
- `restore`: By `restore`, from a snapshot.
- `play`: By `replay`, from a recording.
"""

Phase = Literal["paused", "running", "faulted"]
"""The phase of a swarm.

- `paused`: Paused; every command is allowed.
- `running`: Stepping.
- `faulted`: A step failed: the last good state is kept; `reset` or `delete` go on from here.
"""

RecordingFormat = Literal["mcap", "parquet"]
"""How a recording is written: as MCAP, unless an earlier version wrote it.

- `mcap`: States, orders and events in the encodings in which they are published.
- `parquet`: A table with a row for each individual and state; only earlier versions wrote it.
"""

RecordingPhase = Literal["recording", "ended", "failed"]
"""What a recording is doing.

- `recording`: It goes on, also when the daemon restarts.
- `ended`: It is over, as its reason says: stopped, complete, as large as its `max_bytes`, or its
  swarm was deleted.
- `failed`: It cannot go on, for example on a full disk, or since all recordings together are as
  large as they may be, or files of it are missing or damaged; what was recorded before is kept.
"""

Role = Literal["viewer", "controller", "operator"]
"""What a person may do.

Each may do what the one before may.

- `viewer`: Watch: every `get`, states, orders, events.
- `controller`: Steer individuals: join swarms as a controller of one's own name, advance, put
  set-points. Also write notes into a swarm's journal.
- `operator`: Everything.
"""

Scale = Literal["linear", "logarithmic"]
"""How values are spread over a range.

- `linear`: Evenly.
- `logarithmic`: Evenly in their logarithms.
"""

WaitingAction = Literal["pause", "commands", "event"]
"""What a swarm does once a condition holds.

- `pause`: It pauses.
- `commands`: It applies changes.
- `event`: It publishes an event.
"""

WIRE_VERSION = 1
"""The version of the contract."""

AXES = {
    "pi1": float,
    "pi2": float,
    "pi3": float,
    "pi4": float,
    "n": float,
    "informed": float,
    "informed_fraction": float,
    "contacts": str,
    "dt": float,
    "stepping": str,
    "relinearise": float,
    "attraction": str,
    "noise": float,
}
"""What a grid of an experiment varies, in the order in the names of runs."""

OF_CONTROLLERS = ("join", "advance", "leave", "annotate")
"""The commands that a controller may send."""


class Spec(HtmlStruct, frozen=True, kw_only=True):
    """The spec of a swarm: equal specs give equal states, bit for bit.

    Lengths are in body sizes, speeds in free speeds, times in their quotient.

    Table 1 of the paper defines π1 to π4. Only `n` is required.

    Attributes:
        n: The number of individuals: 1 to the daemon's limit; in a spec the number at the start.
        pi1: Length over width of a body: 1 (a disc) to 32.
        pi2: Weight of individuals that are informed without a weight: 0 to 10⁶.
        pi3: Body size over turning radius: above 0, to 10⁶.
        pi4: Translational over rotational drag: above 0, to 10⁶.
        dt: The time step: above 0, and so short that no point of a body's axis travels further than
            a body's width. In body size / free speed.
        contacts: Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one
            with the smallest gap; or, for comparison, `clamped`, which adds redundant ones.
        stepping: What a contact limits: `position`, the gap after the step, or `velocity`, the
            speed at which touching bodies approach each other.
        relinearise: Number of further programs that a step solves about the result of the last one:
            0, or 1, which leaves less overlap and requires `position`.
        seed: The seed of all random draws: 0 to 2⁵³ - 1.
        start: Where the individuals begin: in a `disc`, or at `given` poses.
        attraction: The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes
            faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius`
            in body sizes, `topological` with a number of `neighbours`, and `power` with an
            `exponent`.
        noise: Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶. In
            free speed / body size.
        publish_every: Number of steps between two published states: 1 or more.
        measures: The measures in each published order, such as `milling`, at most 16 that need no
            earlier state; no measures if None.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    n: int
    pi1: float = 4.0
    pi2: float = 0.5
    pi3: float = 1.0
    pi4: float = 10.0
    dt: float = 0.02
    contacts: str = "endpoints"
    stepping: str = "position"
    relinearise: int = 0
    seed: int = 0
    start: Disc | Given = Disc()
    attraction: dict[str, Any] = msgspec.field(default_factory=lambda: {"kind": "all"})
    noise: float = 0.0
    publish_every: int = 5
    measures: list[str] | msgspec.UnsetType = msgspec.UNSET
    rate: float | None = 1.0


class Attachment(HtmlStruct, frozen=True, kw_only=True):
    """What a daemon attaches to a published state, in CBOR: times of its clock, and set-points.

    It is no part of the state, so that equal states have equal bytes.

    If the clock is set back in between, the second time is the earlier.

    Attributes:
        stepped_unix_nanos: When the step that led to the state was taken, nanoseconds since 1970,
            UTC; None if the daemon does not know: before the first step, after a reset or a restart
            until the next one, and in a playback.
        published_unix_nanos: When the daemon published the state, nanoseconds since 1970, UTC; None
            in a recording by the daemon.
        sequences: The numbers of the newest set-points in the state, the `sequence` of each put, by
            controller. Controllers in lock-step have none.
    """

    stepped_unix_nanos: int | None = None
    published_unix_nanos: int | None = None
    sequences: dict[str, int]


class AuditLine(HtmlStruct, frozen=True, kw_only=True):
    """Equal commands of one client within a minute.

    Attributes:
        number: The number of the line, from 1.
        unix_secs: The daemon's wall clock when it received the first of them, seconds since 1970,
            UTC.
        last_unix_secs: The same for the last of them.
        count: Number of commands.
        user: The user of the token; None from a daemon without users, and for an unknown token.
        client: The name that the client gives itself; None if it gives none.
        verb: The verb.
        action: What an `experiment`, `record` or `replay` does, such as `cancel`; None for other
            verbs.
        name: The swarm, experiment or recording; of `create`, `restore` and `replay` the new swarm.
        outcomes: How the commands ended. Those missing to `count` had no outcome when the line was
            stored.
    """

    number: int
    unix_secs: float
    last_unix_secs: float
    count: int
    user: str | None = None
    client: str | None = None
    verb: str
    action: str | None = None
    name: str | None = None
    outcomes: list[AuditOutcome]

    @property
    def when(self) -> datetime:
        """`unix_secs` as an aware datetime, UTC."""
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=self.unix_secs)


class AuditOutcome(HtmlStruct, frozen=True, kw_only=True):
    """How commands ended.

    Attributes:
        outcome: `ok`, the code of the error, such as `permission_denied`, or `abandoned` of a
            command that ended because its client was gone.
        count: Number of commands that ended so.
    """

    outcome: str
    count: int


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


class Certificate(HtmlStruct, frozen=True, kw_only=True):
    """The accuracy of a state.

    Attributes:
        worst_gap: The smallest gap between two bodies, body sizes; negative is overlap; None if no
            two are near. It is measured independently of the solver.
        residual: The residual `max |min(λ, s)|` of the step that led here, body sizes: at most 1e-9
            unless the step was degraded.
        degraded: Number of steps since the start or reset with a larger residual.
        crossed: Number of pairs with crossing axes. It is measured independently of the solver.
        contacts: Number of contacts that constrained the step.
        iterations: Number of iterations of the solver.
    """

    worst_gap: float | None = None
    residual: float
    degraded: int
    crossed: int
    contacts: int
    iterations: int


class Changed(HtmlStruct, frozen=True, kw_only=True):
    """The result of one change of a `batch`, which has the fields of its verb.

    Attributes:
        verb: `set`, `inform`, `uninform`, `inject` or `remove`.
        before: The values before.
        now: The values now.
        scaled_by: The factor by which `make_room` scaled the positions; 1 is not at all.
        ids: The ids of the individuals concerned, ascending.
        n: The size of the group after the command.
    """

    verb: str
    before: ParameterValues | None = None
    now: ParameterValues | None = None
    scaled_by: float | None = None
    ids: list[int] | None = None
    n: int | None = None


class ControllerSummary(HtmlStruct, frozen=True, kw_only=True):
    """A controller that has joined.

    Attributes:
        controller: Its name.
        mode: `lockstep` or `free_running`.
        ids: The ids of the individuals that it steers.
        deadline_secs: Seconds that others wait for it, or that its set-points apply.
        on_timeout: What happens to its individuals when it is late.
        driving: Whether it may set turning rates and speeds.
        target_step: The step that it has advanced to; None unless in lock-step.
        misses: Number of deadlines missed in a row.
        waited_secs: Seconds that others have waited for it; None if they do not.
        puts: The outcomes of its puts.
    """

    controller: str
    mode: Mode
    ids: list[int]
    deadline_secs: float
    on_timeout: OnTimeout
    driving: bool
    target_step: int | None = None
    misses: int
    waited_secs: float | None = None
    puts: Puts


class Departed(HtmlStruct, frozen=True, kw_only=True):
    """A controller that has left.

    Attributes:
        controller: Its name.
        why: Why it has left.
    """

    controller: str
    why: Departure


class EarlierModel(HtmlStruct, frozen=True, kw_only=True):
    """An earlier version of the model that computed steps of a swarm.

    Attributes:
        model_version: The version.
        epoch: The epoch of the last state that it computed.
        step: The step of that state.
    """

    model_version: int
    epoch: int
    step: int


class ErrorMessage(msgspec.Struct, frozen=True, kw_only=True):
    """An error.

    Clients branch on `code`; `message` has the remedy.

    Attributes:
        code: The kind of error, such as `conflict`.
        message: For people: what is wrong, and the remedy.
        details: For programs, such as `field` and `range`; may be empty.
        step: The swarm's step at that time; None if it concerns no swarm.
    """

    code: str
    message: str
    details: dict[str, Any]
    step: int | None = None


class Event(Dated, frozen=True, kw_only=True):
    """An event of a swarm.

    A gap in the numbers shows a reader that it missed some.

    The fields of each `kind`, beside those of all; the other fields are None:

    - `created`: The swarm was created; its first event: `verb, client, request_id`.
    - `phase`: Its phase changed: `reason`.
    - `command`: A command was applied: `seq, verb, args, client, request_id`.
    - `scheduled`: A command waits for its step: `applies_at_step, verb, args, client, request_id`.
    - `refused`: A scheduled command was rejected: `verb, args, client, request_id, error`.
    - `lapsed`: The time of informed individuals ended, and they are uninformed: `ids`.
    - `fault`: A step failed; the swarm keeps its last good state: `reason`.
    - `model`: Another version of the model goes on from its last stored state; it replays the
      commands after that state: `from, to`.
    - `recording_failed`: A recording of the daemon failed; its files are kept: `reason, recording`.
    - `deleted`: The swarm was deleted; its last event: `client, request_id`.

    A newer daemon may send other kinds.

    Attributes:
        swarm: The swarm's name.
        number: The number of the event, from 1.
        epoch: Increases when `step` does not continue what was published before.
        step: The step of the event.
        time: `step · dt`, body sizes over free speed.
        phase: The phase after the event.
        from_: The version that computed that state.
        to: The version that computes the steps from there on.
        kind: `created`, `phase`, `command`, `scheduled`, `refused`, `lapsed`, `fault`, `model`,
            `recording_failed` or `deleted`.
        reason: The cause.
        seq: Number of commands applied to the swarm.
        applies_at_step: The step that the command waits for.
        verb: The verb of the command.
        args: The arguments of the command, as they were sent.
        client: The name of the client that sent the command.
        request_id: The id of the request.
        error: Why the command was rejected.
        ids: The ids of the individuals concerned, ascending.
        recording: The name of the daemon's recording.
        skipped: Number of events between the previous one and this that the daemon no longer
            stores; it stores about a thousand.
    """

    swarm: str
    number: int
    epoch: int
    step: int
    time: float
    phase: Phase
    from_: int | None = msgspec.field(default=None, name="from")
    to: int | None = None
    kind: str
    reason: str | None = None
    seq: int | None = None
    applies_at_step: int | None = None
    verb: str | None = None
    args: Any = None
    client: str | None = None
    request_id: str | None = None
    error: ErrorMessage | None = None
    ids: list[int] | None = None
    recording: str | None = None
    skipped: int = 0


class ExpandedRun(HtmlStruct, frozen=True, kw_only=True):
    """A run as the swarm and the commands that have its states.

    Attributes:
        run: Its name.
        spec: The spec of the swarm, with the seed of the run.
        snapshot: The snapshot from which `restore` creates the swarm, its CBOR as base64; None if
            `create` creates it from `spec`.
        steps: The number of its steps, at most.
        commands: The commands to send, in this order.
        stop: The condition that ends the run and pauses the swarm; None if there is none.
    """

    run: str
    spec: dict[str, Any]
    snapshot: str | None = None
    steps: int
    commands: list[RunCommand]
    stop: str | None = None


class ExtraValue(msgspec.Struct, frozen=True, kw_only=True):
    """The value of a column that only some experiments have.

    Attributes:
        name: The column: a variable of the grid, `stopped_at`, or the mean of a measure such as
            `msd(5)`.
        value: `stopped_at` in time units, a measure in its unit; None if it is undefined.
    """

    name: str
    value: float | None = None


class Fault(HtmlStruct, frozen=True, kw_only=True):
    """What went wrong in a swarm that has faulted.

    `reason` says it in words.

    Attributes:
        kind: What it is: `crossed_bodies`; `not_solved`, if no solution of a step was exact enough;
            `overturned`, if the attraction turned an individual too far in one step; `not_finite`,
            if a position is no number; `other` if the step does not fail: a stored line is damaged,
            a replay had another hash, or the daemon has a defect. Later versions may have more.
        ids: The individuals that it is about; empty if it is about none in particular.
        gap: The gap between the two bodies that cross, in the last good state, body sizes; None for
            others.
    """

    kind: str
    ids: list[int]
    gap: float | None = None


class Histogram(HtmlStruct, frozen=True, kw_only=True):
    """A histogram of a state.

    Attributes:
        name: Its name: `pair_correlation` or `neighbour_density`.
        unit: The unit of its values; `1` if they have none.
        edges: The edges of the bins of one axis, body sizes: one more than the axis has bins.
        counts: The number of ordered pairs of individuals in each bin. The bins of
            `neighbour_density` are squares: rows from the back to the front, each from the right to
            the left.
        values: The value of each bin.
    """

    name: str
    unit: str
    edges: list[float]
    counts: list[int]
    values: list[float]


class HistoryFrom(HtmlStruct, frozen=True, kw_only=True):
    """The oldest stored checkpoint of a swarm: the history after it can be replayed.

    Attributes:
        epoch: Its epoch.
        step: Its step.
    """

    epoch: int
    step: int


class JournalEntry(Dated, frozen=True, kw_only=True):
    """A command that a swarm applied.

    Attributes:
        seq: The number of the command; each change of a `batch` has one, and its entry has that of
            the last.
        epoch: The epoch in which it was applied.
        step: The step at which it was applied.
        time: `step · dt`, body sizes over free speed.
        verb: Its verb.
        args: Its arguments as they were sent.
        client: The name of the client that sent it.
        request_id: The id of the request.
        skipped: Number of commands between the previous entry and this that the daemon no longer
            stores; 0 if only some commands were selected.
    """

    seq: int
    epoch: int
    step: int
    time: float
    verb: str
    args: Any = None
    client: str | None = None
    request_id: str | None = None
    skipped: int = 0


class Limits(HtmlStruct, frozen=True, kw_only=True):
    """The limits of a daemon.

    Attributes:
        max_individuals: Number of individuals of a swarm.
        max_swarms: Number of swarms.
        max_memory_bytes: Memory of all swarms together, bytes.
        max_message_bytes: Length of a request, bytes; a longer one is rejected, and zenoh drops one
            of more than 1 MiB without an error.
        max_clients: Number of connected clients; beyond it `hello` is rejected with
            `resource_exhausted`.
        max_hz: Published states per second and swarm.
    """

    max_individuals: int
    max_swarms: int
    max_memory_bytes: int
    max_message_bytes: int
    max_clients: int
    max_hz: int


class MeasureValue(HtmlStruct, frozen=True, kw_only=True):
    """A measure of a state.

    Attributes:
        name: Its name with its argument, unless that is the default: `order`,
            `clusters.count(0.1)`.
        value: Its value; None if it is undefined, such as `drift` without informed individuals.
        unit: Its unit; `1` if it has none.
    """

    name: str
    value: float | None = None
    unit: str


class Miss(HtmlStruct, frozen=True, kw_only=True):
    """A missed deadline.

    Attributes:
        controller: The controller that missed it.
        step: The step at which the swarm waited.
        misses: Number of misses in a row: with the third the controller has left.
    """

    controller: str
    step: int
    misses: int


class News(HtmlStruct, frozen=True, kw_only=True):
    """What happened between two replies to a controller.

    Attributes:
        missed: Missed deadlines, also its own.
        left: Controllers that have left.
        removed: Ids of individuals of its own that were removed.
    """

    missed: list[Miss]
    left: list[Departed]
    removed: list[int]


class OccasionalColumns(HtmlStruct, frozen=True, kw_only=True):
    """The columns that only the tables of some experiments have, in their order.

    Attributes:
        varied: The values that vary in the names of the runs, such as `pi1`.
        extra: Those of the table of results, as `extra` of a row: variables, `stopped_at`, and
            means of measures.
        series: The measures over time.
    """

    varied: list[str]
    extra: list[str]
    series: list[str]


class Order(HtmlStruct, frozen=True, kw_only=True):
    """The order and drift of a swarm, now and as means since the start or the last reset.

    Speeds are in free speeds; the means are over steps.

    Attributes:
        order: The polar order parameter, the length of the mean heading: 0 to 1; eq. (8) without
            the mean.
        mean_order: Its time mean, `v` of eq. (8); None before the first step.
        velocity: The mean heading (x, y), which is the centroid's velocity in free speeds.
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


class OrderSample(HtmlStruct, frozen=True, kw_only=True):
    """A published order.

    Attributes:
        swarm: The swarm's name.
        epoch: Increases when `step` does not continue what was published before.
        frame: The number of its published state.
        step: The number of steps since the start.
        time: `step · dt`, body sizes over free speed.
        phase: The phase of the swarm.
        n: The number of individuals.
        informed: How many individuals are informed.
        order: Order and drift.
        certificate: How exact the state is.
        rate: Time units per second of wall clock that the swarm is asked to run at; None is as fast
            as possible.
        real_time_factor: The rate that was reached lately; None while it does not run.
        measures: The measures that the swarm publishes, by name, each in its unit; a value is None
            where it is undefined or the group too large. None without any.
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


class Origin(HtmlStruct, frozen=True, kw_only=True):
    """What a swarm was made from.

    Attributes:
        kind: How it was made.
        swarm: The swarm that was forked, saved in a snapshot or recorded; None if a snapshot has no
            name that a swarm can have.
        swarm_id: The number of that swarm in the store of this daemon; None if it may be of another
            daemon.
        step: Its step then.
        seq: The number of its commands before; None for a replay.
        state_hash: BLAKE3 of its state then, in hexadecimal; None for a replay.
    """

    kind: OriginKind
    swarm: str | None = None
    swarm_id: int | None = None
    step: int
    seq: int | None = None
    state_hash: str | None = None


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
        usual: Its usual values; None if it has none, and of daemons of earlier versions.
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
    usual: Usual | None = None
    choices: list[Any]
    nullable: bool
    default: Any = None
    value: Any = None
    live: bool
    changed_by: list[str]


class ParameterValues(HtmlStruct, frozen=True, kw_only=True):
    """The values of the parameters that commands can change.

    Attributes:
        pi1: Length over width of a body: 1 (a disc) to 32.
        pi2: Weight of individuals that are informed without a weight: 0 to 10⁶.
        pi3: Body size over turning radius: above 0, to 10⁶.
        pi4: Translational over rotational drag: above 0, to 10⁶.
        contacts: Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one
            with the smallest gap; or, for comparison, `clamped`, which adds redundant ones.
        stepping: What a contact limits: `position`, the gap after the step, or `velocity`, the
            speed at which touching bodies approach each other.
        relinearise: Number of further programs that a step solves about the result of the last one:
            0, or 1, which leaves less overlap and requires `position`.
        attraction: The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes
            faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius`
            in body sizes, `topological` with a number of `neighbours`, and `power` with an
            `exponent`.
        noise: Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶.
        publish_every: Number of steps between two published states: 1 or more.
        measures: The measures in each published order; None without any.
        max_idle_secs: Seconds that the swarm waits for a controller in lock-step that sends
            nothing; None without a limit.
    """

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


class Progress(msgspec.Struct, frozen=True, kw_only=True):
    """The progress of an experiment, published while it changes, at most twice a second.

    Attributes:
        name: The experiment's name.
        phase: Its phase.
        runs: Number of runs.
        finished: Number of finished runs.
        faulted: Number of finished runs that ended early.
        share: The finished share of the work, 0 to 1, with that of the present runs.
        elapsed_secs: Seconds that it has run, without pauses.
        left_secs: Seconds that it will still take, without pauses; None while there is no estimate.
        running: The runs that are being executed.
        message: Why it failed or the daemon paused it, or a remark on its runs; None without one.
        model_version: The version of the model that executed its finished runs, if the daemon has
            another one: no run is added to them, and they remain readable. None if the daemon has
            this one.
        start_model_version: The earliest version of the model that computed a part of the snapshot
            from which its runs start, if it is before that of the runs. None otherwise.
    """

    name: str
    phase: ExperimentPhase
    runs: int
    finished: int
    faulted: int
    share: float
    elapsed_secs: float
    left_secs: float | None = None
    running: list[RunUnderWay]
    message: str | None = None
    model_version: int | None = None
    start_model_version: int | None = None

    def _summary(self) -> str:
        """The same as a text, without the share."""
        left = "" if self.left_secs is None or self.is_over else f", {self.left_secs:.0f} s left"
        faulted = f", {self.faulted} faulted" if self.faulted else ""
        why = f": {self.message}" if self.message else ""
        runs = f"{self.finished} of {self.runs} runs"
        if self.model_version is not None:
            runs += f" of model version {self.model_version}"
        if self.start_model_version is not None:
            runs += f", from a state of model version {self.start_model_version}"
        return f"{self.phase}, {runs}{faulted}{left}{why}"

    def _repr_html_(self) -> str:
        return bar_html(self.share, f"{self.name} {100 * self.share:z.0f} %, {self._summary()}")

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self.phase in ("finished", "cancelled", "failed")


class Puts(HtmlStruct, frozen=True, kw_only=True):
    """Numbers of a controller's puts, by outcome.

    Attributes:
        applied: Applied ones.
        stale: Those that were not newer than one before, or of another epoch.
        overtaken: Those that a newer one overtook before the next step.
        refused: Those that were unreadable, out of range, not permitted, or for individuals of
            another controller.
    """

    applied: int
    stale: int
    overtaken: int
    refused: int


class RecordedAt(HtmlStruct, frozen=True, kw_only=True):
    """The epoch and step of a state in a recording.

    Attributes:
        epoch: Its epoch.
        step: Its step.
    """

    epoch: int
    step: int


class RecordingStatus(HtmlStruct, frozen=True, kw_only=True):
    """The status of a recording of a daemon; of a deleted one, its last status.

    Attributes:
        recording: Its name, and that of its folder in `recordings` of the daemon's data directory.
        swarm: The name of the recorded swarm.
        format: `mcap`, or `parquet` if an earlier version recorded it.
        every: It has the states whose step is a multiple of this; None is the published states, of
            an earlier version.
        phase: Its phase.
        reason: Why it ended or failed, and which of its files are missing or damaged.
        frames: Number of recorded states.
        missed: Number of missing states: those that were dropped because the disk was too slow
            (without `drop_when_behind` the swarm waits instead), and those in `lost`.
        lost: Number of them that were lost because the daemon ended before their file was complete.
        gap: Where the last of these were; None if none was lost.
        lost_parts: Number of finished files that are missing or damaged; `frames`, `parts` and
            `bytes` are those of the others then.
        parts: Number of complete files.
        bytes: Bytes of these files.
        began_unix_secs: Its beginning, seconds since 1970, UTC.
        drop_when_behind: Whether it drops states while the disk is too slow; otherwise the swarm
            waits.
        max_bytes: The size in bytes at which it ends; None for a recording of an earlier version,
            which has no limit.
        temporary: Whether the client that fetches it is to delete it afterwards.
    """

    recording: str
    swarm: str
    format: RecordingFormat
    every: int | None = None
    phase: RecordingPhase
    reason: str | None = None
    frames: int
    missed: int
    lost: int
    gap: RecordingGap | None = None
    lost_parts: int
    parts: int
    bytes: int
    began_unix_secs: int
    drop_when_behind: bool
    max_bytes: int | None = None
    temporary: bool


class RecordingGap(HtmlStruct, frozen=True, kw_only=True):
    """States that a recording lost because the daemon ended before their file was complete.

    Attributes:
        after: The state up to which none is missing; None if the recording begins with the gap.
        until: The state at which the recording continues.
        missed: Number of missing states.
    """

    after: RecordedAt | None
    until: RecordedAt
    missed: int


class RecordingMetrics(HtmlStruct, frozen=True, kw_only=True):
    """Numbers of a daemon's recordings, by phase.

    Attributes:
        recording: Number of running recordings.
        ended: Number of ended recordings.
        failed: Number of failed recordings.
    """

    recording: int
    ended: int
    failed: int


class Replay(HtmlStruct, frozen=True, kw_only=True):
    """A playback of a recording.

    Attributes:
        of: The swarm that was recorded.
        frame: The number of the present frame, from 1.
        frames: Number of frames.
        position: Time units since its first frame.
        duration: Time units from its first frame to its last, resets and gaps None.
    """

    of: str
    frame: int
    frames: int
    position: float
    duration: float


class ResultRow(HtmlStruct, frozen=True, kw_only=True):
    """The result of one run of an experiment: a row of the table of results.

    Attributes:
        run: The run's name within its experiment: the varied parameters, then the replicate. The
            seed is derived from the name.
        seed: The seed of all random draws.
        n: Number of individuals.
        pi1: Length over width of a body.
        pi2: Weight of the informed individuals' own preference.
        pi3: Body size over turning radius.
        pi4: Translational over rotational drag.
        informed: Number of informed individuals.
        contacts: The contact rule: `endpoints`, `closest` or `clamped`.
        dt: The time step.
        time: Duration of the run; less than that of the experiment if the run faulted.
        v: Time mean of the centroid's speed, eq. (8).
        v_pd: Mean drift along the informed individuals' direction; None without informed
            individuals.
        ordered_intervals: Number of intervals with an order of at least 2/3, including those that
            the run's ends cut.
        ordered_time: Total time of the ordered intervals.
        unordered_intervals: Number of intervals with an order below 2/3, including those that the
            run's ends cut.
        unordered_time: Total time of the unordered intervals.
        worst_overlap: The deepest overlap of any two bodies, 0 or more.
        crossed_share: The share of time in which any two axes crossed.
        worst_residual: The largest residual of any step.
        degraded: Number of degraded steps: less accurate than the target, but acceptable.
        fallbacks: Number of steps that the fallback solved because the exact solver missed its
            target.
        steps: Number of steps.
        state_hash: The hash of the last state, BLAKE3 in hexadecimal.
        fault: Why the run ended early, if a fault ended it; None otherwise. The other values are
            then those of the time before the fault.
        extra: Columns that only some experiments have, in their order: variables of the grid,
            `stopped_at`, and means of chosen measures.
    """

    run: str
    seed: int
    n: int
    pi1: float
    pi2: float
    pi3: float
    pi4: float
    informed: int
    contacts: str
    dt: float
    time: float
    v: float
    v_pd: float | None = None
    ordered_intervals: int
    ordered_time: float
    unordered_intervals: int
    unordered_time: float
    worst_overlap: float
    crossed_share: float
    worst_residual: float
    degraded: int
    fallbacks: int
    steps: int
    state_hash: str
    fault: str | None = None
    extra: list[ExtraValue] | None = None


class ResultsPage(HtmlStruct, frozen=True, kw_only=True):
    """Some rows of an experiment's table of results, in the order of its plan.

    Attributes:
        name: The experiment's name.
        rows: The rows of the finished runs, faulted ones included, after the requested run.
        next: The number to request the next page after, as `after`; None after the last page.
        finished: Number of finished runs.
        columns: The columns that only some experiments have, so that a table without rows has them,
            too; None in replies of earlier versions.
    """

    name: str
    rows: list[ResultRow]
    next: int | None = None
    finished: int
    columns: OccasionalColumns | None = None


class RunCommand(HtmlStruct, frozen=True, kw_only=True):
    """A command of a run, and its `at_step`.

    Attributes:
        at_step: The step before which it is executed; None if it is executed at once.
        verb: `batch`: the changes of one execution of an `[[at]]` block; `when`: a block with a
            condition, or `[stop]`.
        args: The arguments of the verb.
    """

    at_step: int | None = None
    verb: str
    args: Any = None


class RunUnderWay(msgspec.Struct, frozen=True, kw_only=True):
    """A run that is being executed.

    Attributes:
        run: Its name.
        share: The finished share of its steps, 0 to 1.
    """

    run: str
    share: float


class StoreMetrics(HtmlStruct, frozen=True, kw_only=True):
    """The database of a daemon.

    Attributes:
        commits: Number of commits since the daemon started.
        commit_secs: Seconds that they took, with their syncs.
        last_commit_secs: Seconds that the last one took.
        waiting: Number of queued writes.
        disk_bytes: Bytes on disk.
        full: Whether the disk is full.
        failing: Whether writing fails for another reason.
        overrun: Whether the queue exceeds its memory limit.
    """

    commits: int
    commit_secs: float
    last_commit_secs: float
    waiting: int
    disk_bytes: int
    full: bool
    failing: bool
    overrun: bool


class SwarmMetrics(HtmlStruct, frozen=True, kw_only=True):
    """Metrics of a swarm.

    Attributes:
        swarm: The swarm's name.
        phase: The phase of the swarm.
        step: Number of steps since the start.
        n: The size of the group.
        rate: Time units per second of wall clock; None is as fast as possible.
        real_time_factor: The rate that it reached lately; None while it does not run.
        steps: Number of steps since the daemon loaded it.
        step_secs: Seconds that these steps took.
        due_steps: Number of these steps that had a due time.
        late_secs: Seconds that they began after their due times.
        contacts: Number of contacts of the last step.
        residual: Residual of the last step, body sizes.
        degraded: Number of steps that missed the target residual, but were acceptable.
        faults: Number of failed steps.
    """

    swarm: str
    phase: Phase
    step: int
    n: int
    rate: float | None = None
    real_time_factor: float | None = None
    steps: int
    step_secs: float
    due_steps: int
    late_secs: float
    contacts: int
    residual: float
    degraded: int
    faults: int


class SwarmSummary(HtmlStruct, frozen=True, kw_only=True):
    """A swarm in the list of a daemon.

    Attributes:
        swarm: Its name.
        phase: Its phase.
        reason: Why it is paused or faulted.
        step: The number of steps since the start.
        time: `step · dt`, body sizes over free speed.
        n: The number of individuals.
        informed: How many individuals are informed.
        order: The polar order parameter, 0 to 1.
        rate: Time units per second of wall clock; None is as fast as possible.
        real_time_factor: The rate that was reached lately; None while it does not run.
        replay: Whether it is the playback of a recording.
        earlier_models: As in its status.
        protected: As in its status.
        swarm_id: As in its status.
        origin: As in its status.
        contested_by: The other daemon that has a swarm of this name, if there is one; see
            `contested`.
    """

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
    replay: bool
    earlier_models: list[EarlierModel] | None = None
    protected: bool = False
    swarm_id: int | None = None
    origin: Origin | None = None
    contested_by: str | None = None


class Usual(HtmlStruct, frozen=True, kw_only=True):
    """The usual values of a parameter, for a slider.

    They are those of the paper where it varies one, else around its value; others are valid, too.

    Attributes:
        from_: The least.
        to: The largest.
        scale: How they are spread.
    """

    from_: float = msgspec.field(name="from")
    to: float
    scale: Scale


class WaitingClient(HtmlStruct, frozen=True, kw_only=True):
    """A client that waits for a condition by `wait`.

    Attributes:
        condition: The condition.
        user: The user; None on a daemon without users.
    """

    condition: str
    user: str | None = None


class WaitingCondition(HtmlStruct, frozen=True, kw_only=True):
    """A condition of `when` that waits.

    Attributes:
        id: By which `when` with `cancel` removes it: 8 hexadecimal digits, the same for equal
            conditions with equal actions.
        condition: The condition.
        action: `pause`, `commands` or `event`.
        event: The name of its event; None without one.
        client: The client that sent it, as the request names it; None if it is not known.
        evaluated: False if the condition does not hold since its measures need too much time or too
            many earlier states: the group has grown, or an earlier version accepted more of them.
            None if it is evaluated.
    """

    id: str
    condition: str
    action: WaitingAction
    event: str | None = None
    client: str | None = None
    evaluated: bool | None = None


class Reply(HtmlStruct, frozen=True, kw_only=True):
    """The reply of a swarm, and of the node that created one.

    The reply to a query on a swarm's `state` is the state alone.

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


class Audit(HtmlStruct, frozen=True, kw_only=True):
    """A page of the audit log: who sent which commands, oldest first.

    Attributes:
        node: The daemon's name.
        lines: The lines that the request selects, as many as one reply holds.
        oldest: The number of the oldest stored line; None if there is none.
        newest: The number of the newest line; 0 before the first.
        damaged: Number of selected lines that are damaged, and therefore missing.
    """

    node: str
    lines: list[AuditLine]
    oldest: int | None = None
    newest: int
    damaged: int


class BatchResult(Reply, frozen=True, kw_only=True):
    """The reply to `batch`; `seq` has increased by the number of its changes.

    Attributes:
        results: The result of each change, in their order.
    """

    results: list[Changed]


class ControllerList(Reply, frozen=True, kw_only=True):
    """The controllers that have joined a swarm.

    Attributes:
        controllers: The controllers that have joined, by name.
    """

    controllers: list[ControllerSummary]


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


class Events(Reply, frozen=True, kw_only=True):
    """A page of the events that a daemon stores of a swarm.

    Attributes:
        events: The events of the page, oldest first.
        oldest: The number of the oldest stored event; None if there is none.
        newest: The number of the newest event: query until it is reached; 0 before the first.
    """

    events: list[Event]
    oldest: int | None = None
    newest: int


class ExperimentFile(Reply, frozen=True, kw_only=True):
    """The commands of a swarm since its start, as the file of an experiment with one run.

    The parameter `replicates` of the query gives the run other seeds, so many.

    The file contains the set-points of controllers as the text of a CSV; with the parameter
    `setpoints`, a name of a file, it names that one.

    Attributes:
        file: The text of the file, TOML. Its run takes the steps of the swarm.
        setpoints: The text of the CSV of set-points that the file names; None if it names none.
        steps: The step of the swarm.
        state_hash: BLAKE3 of the state at that step, in hexadecimal. The run ends with it, unless
            commands were applied at that step: then the run takes one more step.
    """

    file: str
    setpoints: str | None = None
    steps: int
    state_hash: str


class ExperimentResult(HtmlStruct, frozen=True, kw_only=True):
    """The reply to a command about an experiment.

    Attributes:
        node: The daemon's name.
        created: Whether the command created it.
        progress: Its progress; of a deleted one, its last; with `expand`, that at its beginning.
        expanded: The run of `expand`; None by other commands.
    """

    node: str
    created: bool
    progress: Progress
    expanded: ExpandedRun | None = None


class Experiments(HtmlStruct, frozen=True, kw_only=True):
    """The experiments of a daemon.

    Attributes:
        node: The daemon's name.
        experiments: The experiments, in the order of submission.
    """

    node: str
    experiments: list[Progress]


class Hello(HtmlStruct, frozen=True, kw_only=True):
    """The name, version and limits of a daemon.

    Attributes:
        node: The daemon's name.
        version: The daemon's version.
        wire_version: The version of the contract that it speaks.
        unix_secs: Its clock: seconds since 1970, UTC.
        limits: Its limits.
        http: The address of its HTTP server, such as `https://0.0.0.0:8443`; None if it has none.
        data_id: Its data folder, by a number that the daemon drew when it began the folder's
            database; a restored backup has another one. A daemon with the same id has the replies
            to commands that were executed, so that a command can be sent again after a restart.
            None if the daemon could not store it.
    """

    node: str
    version: str
    wire_version: int
    unix_secs: float
    limits: Limits
    http: str | None = None
    data_id: str | None = None


class IdsResult(Reply, frozen=True, kw_only=True):
    """The reply to `inform`, `uninform`, `inject` and `remove`.

    Attributes:
        ids: The ids of the individuals concerned, ascending.
        n: The size of the group after the command.
    """

    ids: list[int]
    n: int


class JoinResult(Reply, frozen=True, kw_only=True):
    """The reply to `join`.

    Attributes:
        ids: The ids of the individuals that the controller steers.
        news: What happened since it left, if it rejoins.
    """

    ids: list[int]
    news: News


class Journal(Reply, frozen=True, kw_only=True):
    """A page of the commands that a daemon stores of a swarm.

    The spec and these commands determine the state of the swarm.

    Attributes:
        entries: The entries of the page, oldest first.
        oldest: The `seq` of the oldest stored entry; None if there is none.
        newest: The `seq` of the newest entry; 0 before the first.
        next: The line of the journal at which the next page begins: query again with it as `line`,
            also if this page has no entries; None after the last page, and in replies of earlier
            daemons.
    """

    entries: list[JournalEntry]
    oldest: int | None = None
    newest: int
    next: int | None = None


class Measures(Reply, frozen=True, kw_only=True):
    """Measures of the newest state of a swarm, or a histogram of it.

    Attributes:
        measures: The requested measures of the newest state, in the requested order.
        histogram: The requested histogram of the newest state.
    """

    measures: list[MeasureValue]
    histogram: Histogram | None = None


class Metrics(HtmlStruct, frozen=True, kw_only=True):
    """Metrics of a daemon; counters begin when it starts.

    Attributes:
        node: The daemon's name.
        uptime_secs: Seconds since it started.
        unwell: The reasons why it is unhealthy, for people; empty if it is healthy.
        warnings: Problems that do not stop its work, for people, such as a failed recording; empty
            if there are none.
        cpu_secs: CPU seconds of its threads.
        cores: Number of cores that it may use.
        memory_bytes: Memory in use, bytes.
        sessions: Number of connected clients.
        steps: Number of steps of all swarms, also of deleted ones.
        step_secs: Seconds that these steps took.
        faults: Number of failed steps; each stops its swarm.
        degraded: Number of steps that missed the target residual, but were acceptable.
        residual_max: The largest residual of a step, body sizes.
        frames: Number of states for publication.
        frames_dropped: Number of states that a newer one replaced before publication.
        contested: Number of names, the daemon's and its swarms', that another daemon has too.
        store: The database.
        recordings: The recordings.
        recordings_bytes: Bytes of all recordings on disk.
        recordings_quota_bytes: The limit of these bytes: running recordings end at it, and none
            begins.
        experiments_bytes: Bytes of all experiments on disk; None from an earlier daemon.
        experiments_quota_bytes: The limit of these bytes, at which the running experiment is
            paused, and none begins; None if there is none.
        swarms: Every swarm, ordered by name.
    """

    node: str
    uptime_secs: float
    unwell: list[str]
    warnings: list[str]
    cpu_secs: float
    cores: int
    memory_bytes: int
    sessions: int
    steps: int
    step_secs: float
    faults: int
    degraded: int
    residual_max: float
    frames: int
    frames_dropped: int
    contested: int
    store: StoreMetrics
    recordings: RecordingMetrics
    recordings_bytes: int
    recordings_quota_bytes: int
    experiments_bytes: int | None = None
    experiments_quota_bytes: int | None = None
    swarms: list[SwarmMetrics]


class NodeStatus(HtmlStruct, frozen=True, kw_only=True):
    """The status of a daemon.

    Attributes:
        node: The daemon's name.
        uptime_secs: Seconds since it started.
        swarms: Number of swarms.
        running: Number of running swarms.
        faulted: Number of faulted swarms.
        individuals: Number of individuals in all swarms.
        memory_bytes: Memory reserved for the swarms and the running experiment, bytes.
        experiments_memory_bytes: Of it, memory reserved for the running experiment, bytes.
        clients: Number of connected clients.
    """

    node: str
    uptime_secs: float
    swarms: int
    running: int
    faulted: int
    individuals: int
    memory_bytes: int
    experiments_memory_bytes: int
    clients: int


class Parameters(Reply, frozen=True, kw_only=True):
    """All parameters of a swarm except its start.

    Attributes:
        parameters: All but the start, in the order of the spec.
    """

    parameters: list[Parameter]


class RecordingResult(RecordingStatus, frozen=True, kw_only=True):
    """The status of a recording of a daemon; of a deleted one, its last status.

    Attributes:
        node: The daemon's name.
    """

    node: str


class RecordingPiece(HtmlStruct, frozen=True, kw_only=True):
    """A piece of a complete part of a recording.

    Attributes:
        node: The daemon's name.
        recording: The name of the recording.
        part: The number of the part, from 0.
        parts: Number of complete parts.
        offset: The offset of the piece in the part, bytes.
        length: The length of the part, bytes.
        bytes: The piece, as base64: at most 512 KiB of the part; empty at the end of the part.
    """

    node: str
    recording: str
    part: int
    parts: int
    offset: int
    length: int
    bytes: str


class Recordings(HtmlStruct, frozen=True, kw_only=True):
    """The recordings of a daemon.

    Attributes:
        node: The daemon's name.
        recordings: The recordings, ordered by name.
    """

    node: str
    recordings: list[RecordingStatus]


class ReplayResult(HtmlStruct, frozen=True, kw_only=True):
    """The reply to `replay`.

    Attributes:
        node: The daemon's name.
        uploaded: Number of uploaded bytes, which is the offset of the next piece; None after
            `open`.
        replay: The playback after `open`; None after `upload`.
    """

    node: str
    uploaded: int | None = None
    replay: Replay | None = None


class ResetResult(Reply, frozen=True, kw_only=True):
    """The reply to `reset`.

    Attributes:
        seed: The seed of the swarm.
        state_hash: BLAKE3 of the state, in hexadecimal.
    """

    seed: int
    state_hash: str


class RunResult(Reply, frozen=True, kw_only=True):
    """The reply to `run`.

    Attributes:
        until_step: The step it will pause at; None if it has no end.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    until_step: int | None = None
    rate: float | None = None


class Schemas(msgspec.Struct, frozen=True, kw_only=True):
    """The JSON Schemas (2020-12) of every message.

    Attributes:
        node: The daemon's name.
        wire_version: The version of the contract that they describe.
        schemas: The schemas by the name of the message, such as `step.args` and `step.reply`.
    """

    node: str
    wire_version: int
    schemas: dict[str, Any]


class SetResult(Reply, frozen=True, kw_only=True):
    """The reply to `set`.

    Attributes:
        before: The values before.
        now: The values now.
        scaled_by: The factor by which `make_room` scaled the positions; 1 is not at all.
        published_hz: As in `Status`; None in a `batch`.
    """

    before: ParameterValues
    now: ParameterValues
    scaled_by: float
    published_hz: float | None = None


class Status(Reply, frozen=True, kw_only=True):
    """The status of a swarm; its phase, step and time are in the envelope.

    Attributes:
        reason: Why it is paused or faulted.
        fault: What went wrong, if it has faulted; None otherwise.
        swarm_id: The number of the swarm in the store of its daemon: another swarm that gets this
            name later has another one. None for a replay.
        origin: What it was made from; None if it was created from a spec, and for swarms made by
            earlier versions.
        earlier_models: The earlier versions of the model that computed steps of it or of what it
            was made from, since their start or reset, oldest first; None without any.
        protected: Whether `protect` protects it from `delete` and `reset`.
        until_step: The step it will pause at; None if it has no end.
        rate: Time units per second of wall clock; None is as fast as possible.
        real_time_factor: The rate that it reached lately; None while it does not run.
        behind_rate: Whether it lately omitted steps that were due, since they take longer than
            `rate` allows on the cores that it gets.
        published_hz: How many states a second it publishes at most while it runs: what `rate`, `dt`
            and `publish_every` ask for, or the daemon's `max_hz` if that is less; None for a
            playback and in replies of earlier daemons.
        n: The size of the group.
        informed: Number of informed individuals.
        seed: The seed of all random draws.
        dt: The time step, body sizes over free speed.
        parameters: The parameters that `set` can change.
        scheduled: Number of commands that wait for their step.
        when: The conditions that it waits for, in the order of their commands; None without any.
            See `when`.
        conditions: The same conditions: their ids, actions and clients; None without any.
        waits: The conditions for which clients wait by `wait`; None without any. They are no part
            of the state.
        controllers: Number of controllers that have joined.
        waiting_for: The controllers that the swarm waits for in lock-step.
        state_hash: BLAKE3 of the state, in hexadecimal; zeros for a replay, which has frames and no
            state.
        order: Order and drift.
        certificate: The accuracy of the state.
        history_from: The oldest stored checkpoint; None while it cannot be read.
        replay: The position, if it is a playback.
        verifying: The fraction of the history that a running `verify` has replayed, 0 to 1; None if
            none is running.
    """

    reason: str | None = None
    fault: Fault | None = None
    swarm_id: int | None = None
    origin: Origin | None = None
    earlier_models: list[EarlierModel] | None = None
    protected: bool = False
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


class StepResult(Reply, frozen=True, kw_only=True):
    """The reply to `step`.

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


class Swarms(HtmlStruct, frozen=True, kw_only=True):
    """The swarms of a daemon.

    Attributes:
        node: The daemon's name.
        swarms: The swarms, ordered by name.
    """

    node: str
    swarms: list[SwarmSummary]


class Verified(Reply, frozen=True, kw_only=True):
    """The result of a replay of a swarm's history.

    Attributes:
        from_step: The step of the checkpoint that it began at.
        to_step: The step that it ended at.
        hashes: Number of hashes that were compared: those in the history, and the present one of a
            paused swarm.
        differs_at: The first step whose hash differs; None if there is none.
        differs_in_epoch: The epoch of that step: a reset restarts the count of steps.
    """

    from_step: int
    to_step: int
    hashes: int
    differs_at: int | None = None
    differs_in_epoch: int | None = None


class WhenResult(Reply, frozen=True, kw_only=True):
    """The reply to `when`.

    Attributes:
        holds: With `event`: whether the condition holds already, so that it does not wait; None if
            it waits.
        id: The id of the condition that waits now, by which `when` with `cancel` removes it; None
            if none does, and in replies of earlier daemons.
    """

    holds: bool | None = None
    id: str | None = None


class WhoAmI(HtmlStruct, frozen=True, kw_only=True):
    """The person and role that a daemon assigns to a client, by the token of the query.

    Attributes:
        node: The daemon's name.
        person: The person; None from a daemon without users, and for an unknown token.
        role: The role; None for an unknown token.
        verbs: The permitted commands of swarms.
        node_verbs: The permitted commands of the daemon.
    """

    node: str
    person: str | None
    role: Role | None
    verbs: list[str]
    node_verbs: list[str]

    def may(self, verb: str) -> bool:
        """Whether `verb` is permitted, such as `"pause"` or `"create"`."""
        return verb in self.verbs or verb in self.node_verbs
