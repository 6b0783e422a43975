"""Follows every swarm's journal and events, and whether the daemon says that all is well."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

import jostle

from .node import Node

_LOOK_AGAIN_SECS = 1.5
_HEALTH_SECS = 0.5


@dataclass
class Past:
    """What was told of one swarm.

    Attributes:
        journal: The commands it applied, by number, as they were last told.
        compared: How many commands reported before a restart were reported again after it.
        forgotten: Numbers that were told before a restart, and after it only those around them.
        events: In which life of the daemon which event was first told.
        told: What each event was, by number.
        twice: Numbers under which two different events were told.
        epochs: The epoch at the first look in each life.
        looks: How often two controllers or more were looked at.
        owners: Whoever was told to steer somebody whom another one steered.
    """

    journal: dict[int, jostle.JournalEntry] = field(default_factory=dict)
    compared: int = 0
    forgotten: list[int] = field(default_factory=list)
    events: list[tuple[int, int]] = field(default_factory=list)
    told: dict[int, tuple[object, ...]] = field(default_factory=dict)
    twice: list[int] = field(default_factory=list)
    epochs: dict[int, int] = field(default_factory=dict)
    looks: int = 0
    owners: list[str] = field(default_factory=list)

    @property
    def newest(self) -> int:
        """The number of the last command told."""
        return max(self.journal, default=0)


class Chronicle(threading.Thread):
    """Looks again and again, across the daemon's lives."""

    def __init__(self, node: Node) -> None:
        super().__init__(name="chronicle", daemon=True)
        self._node = node
        self._over = threading.Event()
        self._client = jostle.connect(node.endpoint, client="chronicle")
        self._asked_in: dict[str, int] = {}
        self.pasts: dict[str, Past] = {}
        # When, and why it was not well; None if it did not answer.
        self.health: list[tuple[float, list[str] | None]] = []
        self.get_secs: list[float] = []
        self.faulted: set[str] = set()

    def run(self) -> None:
        """Looks until told to end."""
        due = 0.0
        while not self._over.wait(_HEALTH_SECS):
            self.health.append((time.monotonic(), self._node.health()))
            if time.monotonic() >= due:
                self.look()
                due = time.monotonic() + _LOOK_AGAIN_SECS

    def finish(self) -> None:
        """Ends, with a last look."""
        self._over.set()
        self.join()
        self.look()
        self._client.close()

    def look(self) -> None:
        """Asks each swarm once; whom a kill silences is asked again later."""
        if not self._node.is_up():
            return
        life = self._node.lives[-1].number
        try:
            names = [it.swarm for it in self._client.swarms() if not it.replay]
        except jostle.JostleError:
            return
        for name in names:
            try:
                began = time.monotonic()
                status = self._client.swarm(name).status()
                self.get_secs.append(time.monotonic() - began)
                past = self.pasts.setdefault(name, Past())
                past.epochs.setdefault(life, status.epoch)
                if status.phase == "faulted":
                    self.faulted.add(name)
                self._read(name, past, life, status.controllers > 1)
            except jostle.JostleError:
                # It was deleted, or the daemon killed; it is asked again.
                continue

    def _read(self, name: str, past: Past, life: int, has_several: bool) -> None:
        swarm = self._client.swarm(name)
        # What was told before a kill is asked for once more: it must be there still.
        anew = self._asked_in.get(name) != life
        entries = swarm.journal(0 if anew else past.newest)
        if anew:
            self._compare(past, entries)
        for entry in entries:
            past.journal[entry.seq] = entry
        self._asked_in[name] = life
        last = past.events[-1][1] if past.events and not anew else 0
        for event in swarm.history(last):
            said = (event.kind, event.seq, event.epoch, event.step)
            if past.told.setdefault(event.number, said) != said:
                past.twice.append(event.number)
            if not past.events or event.number > past.events[-1][1]:
                past.events.append((life, event.number))
        if has_several:
            owned: set[int] = set()
            controllers = swarm.controllers()
            past.looks += len(controllers) > 1
            for one in controllers:
                if owned & set(one.ids):
                    past.owners.append(one.controller)
                owned |= set(one.ids)

    @staticmethod
    def _compare(past: Past, entries: list[jostle.JournalEntry]) -> None:
        """Holds what is told after a restart against what was told before it."""
        told = {entry.seq: entry for entry in entries}
        for seq, before in list(past.journal.items()):
            after = told.get(seq)
            past.compared += after is not None
            if seq > max(told, default=0):
                # It was on no disk yet. Whether somebody was answered that it is, shows later.
                del past.journal[seq]
            elif after is None and seq > min(told):
                past.forgotten.append(seq)
            elif after is not None and _name(after) != _name(before):
                past.journal[seq] = after


def _name(entry: jostle.JournalEntry) -> tuple[object, ...]:
    return entry.verb, entry.client, entry.request_id, entry.epoch, entry.step
