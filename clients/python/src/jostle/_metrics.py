"""Metrics of a daemon and its swarms, as msgspec structs."""

from __future__ import annotations

from ._messages import Phase
from ._repr import HtmlStruct


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
        degraded: Number of steps that missed the target residual.
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


class Metrics(HtmlStruct, frozen=True, kw_only=True):
    """Metrics of a daemon; counters begin when it starts.

    Attributes:
        node: The daemon's name.
        uptime_secs: Seconds since it started.
        unwell: The reasons why it is unhealthy; empty if it is healthy.
        warnings: Problems that do not stop its work, such as a failed recording; empty if there are
            none.
        cpu_secs: CPU seconds of its threads.
        cores: Number of cores that it may use.
        memory_bytes: Memory in use.
        sessions: Number of connected clients.
        steps: Number of steps of all swarms, also of deleted ones.
        step_secs: Seconds that these steps took.
        faults: Number of failed steps.
        degraded: Number of steps that missed the target residual.
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
            paused; None if there is none.
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
