"""A daemon and its swarms in numbers, as msgspec structs."""

from __future__ import annotations

from ._messages import Phase
from ._show import Shown


class StoreMetrics(Shown, frozen=True, kw_only=True):
    """How a daemon's memory on disk does.

    Attributes:
        commits: Since the daemon started.
        commit_secs: Seconds that they took, their syncs included.
        last_commit_secs: Seconds that the last one took.
        waiting: Writes that wait.
        disk_bytes: What it takes on disk.
        full: Whether the disk is full.
        failing: Whether writing fails otherwise.
        overrun: Whether more waits than should be kept in memory.
    """

    commits: int
    commit_secs: float
    last_commit_secs: float
    waiting: int
    disk_bytes: int
    full: bool
    failing: bool
    overrun: bool


class RecordingMetrics(Shown, frozen=True, kw_only=True):
    """A daemon's recordings, counted by what they do.

    Attributes:
        recording: Those that go on.
        ended: Those that have ended.
        failed: Those that have failed.
    """

    recording: int
    ended: int
    failed: int


class SwarmMetrics(Shown, frozen=True, kw_only=True):
    """A swarm in numbers.

    Attributes:
        swarm: Its name.
        phase: What it is doing.
        step: The number of steps since the start.
        n: The size of the group.
        rate: Time units per second of wall clock; `None` is as fast as possible.
        real_time_factor: What of that it lately reached; `None` while it does not run.
        steps: Taken since it is hosted here.
        step_secs: Seconds that these steps took.
        due_steps: How many of them were due at a time.
        late_secs: Seconds that they began after they were due.
        contacts: Of its last step.
        residual: Of its last step, in body sizes.
        degraded: Steps that missed the target residual.
        faults: Steps that failed.
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


class Metrics(Shown, frozen=True, kw_only=True):
    """A daemon in numbers; what grows for ever is counted since it started.

    Attributes:
        node: Its name.
        uptime_secs: Seconds since it started.
        unwell: Why not all is well; empty if it is.
        warnings: What is wrong without keeping it from its work, such as a recording that has
            failed; empty if nothing is.
        cpu_secs: Seconds its threads have computed.
        cores: It may use.
        memory_bytes: In use.
        sessions: Clients connected.
        steps: Of all swarms there ever were.
        step_secs: Seconds that these steps took.
        faults: Steps that failed.
        degraded: Steps that missed the target residual.
        residual_max: The largest residual of a step, in body sizes.
        frames: States made to be published.
        frames_dropped: Those that gave way to a newer one before they were.
        contested: Names of the daemon and its swarms that another daemon holds, too.
        store: How its memory on disk does.
        recordings: Those that it has made or makes.
        recordings_bytes: What all recordings take on disk.
        recordings_quota_bytes: What they may take: those that go on end there, and none begins.
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
    swarms: list[SwarmMetrics]
