"""Follows the journal and the events of every swarm, and the health of the daemon."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

import jostle

from .node import Node

_READ_INTERVAL_SECS = 1.5
_HEALTH_INTERVAL_SECS = 0.5


@dataclass
class SwarmLog:
    """What was read about one swarm.

    Attributes:
        journal: The commands it applied by `seq`, as last read.
        compared: How many commands that were read before a restart were read again after it.
        missing: Their `seq` if they were missing after a restart, but not those around them.
        events: For each event the run of the daemon in which it was first read, and its number.
        contents: The content of each event, by number.
        duplicates: Numbers of two different events.
        epochs: The epoch at the first read in each run of the daemon.
        reads: How often two or more controllers were read.
        conflicts: Controllers that owned an individual of another one.
    """

    journal: dict[int, jostle.JournalEntry] = field(default_factory=dict)
    compared: int = 0
    missing: list[int] = field(default_factory=list)
    events: list[tuple[int, int]] = field(default_factory=list)
    contents: dict[int, tuple[object, ...]] = field(default_factory=dict)
    duplicates: list[int] = field(default_factory=list)
    epochs: dict[int, int] = field(default_factory=dict)
    reads: int = 0
    conflicts: list[str] = field(default_factory=list)

    @property
    def newest(self) -> int:
        """The `seq` of the last command read."""
        return max(self.journal, default=0)


class Observer(threading.Thread):
    """Reads periodically, across restarts of the daemon."""

    def __init__(self, node: Node) -> None:
        super().__init__(name="observer", daemon=True)
        self._node = node
        self._stop_event = threading.Event()
        self._client = jostle.connect(node.endpoint, client="observer")
        self._last_run: dict[str, int] = {}
        self.logs: dict[str, SwarmLog] = {}
        # When, and the codes of why it was unhealthy; None without a response.
        self.health: list[tuple[float, list[str] | None]] = []
        self.faulted: set[str] = set()

    def run(self) -> None:
        """Reads until `finish` is called."""
        due = 0.0
        while not self._stop_event.wait(_HEALTH_INTERVAL_SECS):
            self.health.append((time.monotonic(), self._node.health()))
            if time.monotonic() >= due:
                self.read_all()
                due = time.monotonic() + _READ_INTERVAL_SECS

    def finish(self) -> None:
        """Stops the thread and reads a last time."""
        self._stop_event.set()
        self.join()
        self.read_all()
        self._client.close()

    def read_all(self) -> None:
        """Reads each swarm once; one whose read a kill interrupts is read later."""
        if not self._node.is_up():
            return
        run = self._node.runs[-1].number
        try:
            names = [it.swarm for it in self._client.swarms() if not it.replay]
        except jostle.JostleError:
            return
        for name in names:
            try:
                self._read(name, run)
            except jostle.JostleError:
                # The swarm was deleted or the daemon killed; the next pass reads it again.
                continue

    def _read(self, name: str, run: int) -> None:
        swarm = self._client.swarm(name)
        status = swarm.status()
        log = self.logs.setdefault(name, SwarmLog())
        # After a restart everything is read again: it must still be there.
        is_first = self._last_run.get(name) != run
        entries = swarm.journal(0 if is_first else log.newest)
        last = log.events[-1][1] if log.events and not is_first else 0
        events = list(swarm.history(last))
        controllers = swarm.controllers() if status.controllers > 1 else []
        if not self._node.is_up() or self._node.runs[-1].number != run:
            # The client went on over a restart: the next pass reads it in the next run.
            return
        log.epochs.setdefault(run, status.epoch)
        if status.phase == "faulted":
            self.faulted.add(name)
        if is_first:
            self._compare(log, entries)
        for entry in entries:
            log.journal[entry.seq] = entry
        self._last_run[name] = run
        for event in events:
            content = (event.kind, event.seq, event.epoch, event.step)
            if log.contents.setdefault(event.number, content) != content:
                log.duplicates.append(event.number)
            if not log.events or event.number > log.events[-1][1]:
                log.events.append((run, event.number))
        if controllers:
            owned: set[int] = set()
            log.reads += len(controllers) > 1
            for one in controllers:
                if owned & set(one.ids):
                    log.conflicts.append(one.controller)
                owned |= set(one.ids)

    @staticmethod
    def _compare(log: SwarmLog, entries: list[jostle.JournalEntry]) -> None:
        """Compares the journal after a restart with the one read before it."""
        now = {entry.seq: entry for entry in entries}
        for seq, before in list(log.journal.items()):
            after = now.get(seq)
            log.compared += after is not None
            if seq > max(now, default=0):
                # Not durable at the kill. If there was a reply to it, `replies.durable` fails.
                del log.journal[seq]
            elif after is None and seq > min(now):
                log.missing.append(seq)
            elif after is not None and _key(after) != _key(before):
                log.journal[seq] = after


def _key(entry: jostle.JournalEntry) -> tuple[object, ...]:
    return entry.verb, entry.client, entry.request_id, entry.epoch, entry.step
