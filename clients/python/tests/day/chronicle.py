"""Follows every swarm's journal and events, and whether the daemon says that all is well."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import jostle

from .node import Node

_LOOK_AGAIN_SECS = 1.5
_HEALTH_SECS = 0.5


@dataclass
class Past:
    """What was told of one swarm.

    Attributes:
        journal: The commands it applied, by number, as they were last told.
        changed: Commands that were told otherwise later, of those that no crash takes back.
        events: In which life of the daemon which event was told.
        returns: The status at the first look in each life.
        owners: Whoever was told to steer somebody whom another one steered.
    """

    journal: dict[int, jostle.JournalEntry] = field(default_factory=dict)
    changed: list[int] = field(default_factory=list)
    events: list[tuple[int, int]] = field(default_factory=list)
    returns: dict[int, dict[str, Any]] = field(default_factory=dict)
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
            began = time.monotonic()
            answers = list(self._client._link.ask_all("jostle/*/get/status", 5.0))
            self.get_secs.append(time.monotonic() - began)
        except jostle.JostleError:
            return
        for status in map(json.loads, answers):
            if status["result"].get("replay") is not None:
                continue
            name = status["swarm"]
            past = self.pasts.setdefault(name, Past())
            past.returns.setdefault(life, status)
            if status["phase"] == "faulted":
                self.faulted.add(name)
            try:
                self._read(name, past, life, status["result"]["controllers"] > 1)
            except jostle.JostleError:
                # It was deleted, or the daemon killed.
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
        last = past.events[-1][1] if past.events else 0
        past.events += [(life, event.number) for event in swarm.history(last)]
        if has_several:
            owned: set[int] = set()
            for one in swarm.controllers():
                if owned & set(one.ids):
                    past.owners.append(one.controller)
                owned |= set(one.ids)

    @staticmethod
    def _compare(past: Past, entries: list[jostle.JournalEntry]) -> None:
        told = {entry.seq: entry for entry in entries}
        oldest = min(told, default=1)
        for seq, before in list(past.journal.items()):
            after = told.get(seq)
            if seq < oldest:
                continue
            if after is None or (after.verb, after.request_id, after.step) != (
                before.verb,
                before.request_id,
                before.step,
            ):
                # Some were told that were on no disk yet; whether one was answered shows later.
                past.changed.append(seq)
                del past.journal[seq]
