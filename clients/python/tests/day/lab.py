"""Everything that is there in the course of a day, and what was noted of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .apart import Disk
from .chronicle import Chronicle
from .controllers import Running
from .ledger import Ledger
from .meter import Meter
from .node import Node
from .plan import Plan
from .scientists import People
from .viewers import Crowd, Seen


@dataclass
class Full:
    """What was seen while the disk was full; times are of the monotonic clock.

    Attributes:
        filled: When no byte was left.
        refused: When the first command was.
        freed: When there was room again.
        taken: When the first command was carried out again.
        refusals: How many commands to one paused swarm were refused in between.
        changed: How many of these changed its epoch, step, `seq` or hash.
        others: What else such commands were refused with.
        ran: How many steps a running swarm took meanwhile.
        stepped: What a `step` was answered: step and `durable_step`.
        deleted: Whether a swarm could be deleted, which makes room.
        failed: Which recordings had failed by its end.
    """

    filled: float = 0.0
    refused: float = 0.0
    freed: float = 0.0
    taken: float = 0.0
    refusals: int = 0
    changed: int = 0
    others: list[str] = field(default_factory=list)
    ran: int = 0
    stepped: tuple[int, ...] = ()
    deleted: bool = False
    failed: list[str] = field(default_factory=list)


@dataclass
class Recorded:
    """What was asked of a recording: whose, from which step on, and until when."""

    swarm: str
    began: float
    step: int
    ended: float = float("inf")


@dataclass
class Notes:
    """What was noted in the course of the day, and in its evening.

    Attributes:
        kills: When the daemon was killed.
        steps: Of each kill, the epoch and step of the swarms that are recorded, just before.
        recorded: Of each recording its swarm, and from when until when it was to go on.
        parts: Of each kill, the files of recordings that were whole, with the hash of each.
        controller_killed: When the controller was.
        frozen: From when until when another one stood still.
        full: What the full disk came to.
        replay: What was seen of the replay.
        recordings: How each recording stood when the day was over.
        verified: What `verify` said of each swarm.
        again: What the same commands carried out elsewhere came to: hashes there and here.
        experiments: Results here and elsewhere, by name.
        read: What was read of the recordings' files.
        ended: How the daemon ended.
        log: Lines of its log that must not be there.
        log_lines: How many lines its log has.
    """

    kills: list[float] = field(default_factory=list)
    steps: list[dict[str, tuple[int, int]]] = field(default_factory=list)
    recorded: dict[str, Recorded] = field(default_factory=dict)
    parts: list[dict[str, str]] = field(default_factory=list)
    controller_killed: float = 0.0
    frozen: tuple[float, float] = (0.0, 0.0)
    full: Full = field(default_factory=Full)
    replay: dict[str, Any] = field(default_factory=dict)
    recordings: dict[str, Any] = field(default_factory=dict)
    verified: dict[str, Any] = field(default_factory=dict)
    again: dict[str, tuple[str, str]] = field(default_factory=dict)
    experiments: dict[str, tuple[bytes, bytes]] = field(default_factory=dict)
    read: dict[str, Any] = field(default_factory=dict)
    ended: int | None = None
    log: list[str] = field(default_factory=list)
    log_lines: int = 0


@dataclass
class Lab:
    """Everybody and everything."""

    plan: Plan
    work: Path
    disk: Disk
    node: Node
    ledger: Ledger
    people: People
    controllers: dict[str, Running]
    crowd: Crowd
    chronicle: Chronicle
    meter: Meter
    began: float = field(default_factory=time.monotonic)
    notes: Notes = field(default_factory=Notes)
    seen: list[Seen] = field(default_factory=list)
    # What all but the daemon computed in the course of the day.
    others_cpu_secs: float = 0.0

    def say(self, what: str) -> None:
        """Shows a line of progress."""
        print(f"[{time.monotonic() - self.began:7.1f} s] {what}", flush=True)


def eventually(what: str, secs: float, holds: Callable[[], bool]) -> None:
    """Waits until `holds`, or fails saying what did not come about."""
    deadline = time.monotonic() + secs
    while not holds():
        assert time.monotonic() < deadline, f"{what}: not within {secs} s"
        time.sleep(0.02)
