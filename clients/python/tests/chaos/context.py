"""Everything that takes part in a run, and what was observed of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .clients import Clients
from .controller_process import ControllerProcess
from .isolation import Disk
from .meter import Meter
from .node import Node
from .observer import Observer
from .plan import Plan
from .requests import RequestLog
from .viewers import ViewerRecord, Viewers


@dataclass
class FullDisk:
    """What was observed while the disk was full; times are of the monotonic clock.

    Attributes:
        filled: When no byte was free.
        rejected_at: When the first command was rejected.
        freed: When there was space again.
        accepted: When the first command was executed again.
        rejections: How many commands to one paused swarm were rejected in between.
        changed: How many of these changed its epoch, step, `seq` or hash.
        others: Other error codes that such commands got.
        ran: How many steps a running swarm took meanwhile.
        stepped: The reply to a `step`: step and `durable_step`.
        deleted: Whether a swarm could be deleted, which frees space.
        failed: Which recordings had failed at the end.
    """

    filled: float = 0.0
    rejected_at: float = 0.0
    freed: float = 0.0
    accepted: float = 0.0
    rejections: int = 0
    changed: int = 0
    others: list[str] = field(default_factory=list)
    ran: int = 0
    stepped: tuple[int, ...] = ()
    deleted: bool = False
    failed: list[str] = field(default_factory=list)


@dataclass
class RecordingSpan:
    """What a recording was to cover: its swarm, the first step, and from when until when."""

    swarm: str
    began: float
    step: int
    ended: float = float("inf")


@dataclass
class Observations:
    """What was observed in the course of the run, and after it.

    Attributes:
        kills: When the daemon was killed.
        steps: For each kill the epoch and step of the recorded swarms just before it.
        recorded: For each recording what it was to cover.
        parts: For each kill the complete files of recordings, with the hash of each.
        frozen: From when until when a controller was stopped.
        full: What was observed while the disk was full.
        playback: What was observed of the playback.
        recordings: The final status of each recording.
        verified: The result of `verify` for each swarm.
        reexecuted: The state hash of each swarm here, and after the same commands on another
            daemon.
        experiments: Results of the daemon, and of a run without one, by name.
        read: What was read from the files of each recording.
        ended: The exit code of the daemon.
        log: Lines of its log that indicate a defect.
        log_lines: How many lines its log has.
    """

    kills: list[float] = field(default_factory=list)
    steps: list[dict[str, tuple[int, int]]] = field(default_factory=list)
    recorded: dict[str, RecordingSpan] = field(default_factory=dict)
    parts: list[dict[str, str]] = field(default_factory=list)
    frozen: tuple[float, float] = (0.0, 0.0)
    full: FullDisk = field(default_factory=FullDisk)
    playback: dict[str, Any] = field(default_factory=dict)
    recordings: dict[str, Any] = field(default_factory=dict)
    verified: dict[str, Any] = field(default_factory=dict)
    reexecuted: dict[str, tuple[str, str]] = field(default_factory=dict)
    experiments: dict[str, tuple[bytes, bytes]] = field(default_factory=dict)
    read: dict[str, Any] = field(default_factory=dict)
    ended: int | None = None
    log: list[str] = field(default_factory=list)
    log_lines: int = 0


@dataclass
class Context:
    """All parts of a run."""

    plan: Plan
    work: Path
    disk: Disk
    node: Node
    requests: RequestLog
    clients: Clients
    controllers: dict[str, ControllerProcess]
    viewers: Viewers
    observer: Observer
    meter: Meter
    began: float = field(default_factory=time.monotonic)
    observed: Observations = field(default_factory=Observations)
    seen: list[ViewerRecord] = field(default_factory=list)

    def log(self, text: str) -> None:
        """Prints a line of progress."""
        print(f"[{time.monotonic() - self.began:7.1f} s] {text}", flush=True)


def wait_until(what: str, secs: float, holds: Callable[[], bool]) -> None:
    """Polls until `holds` returns true; fails with `what` after `secs` seconds."""
    deadline = time.monotonic() + secs
    while not holds():
        assert time.monotonic() < deadline, f"{what}: not within {secs} s"
        time.sleep(0.02)
