"""Numbered records: asked for page by page, and joined with those that are published."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from ._errors import Conflict, JostleError
from ._events import Event, JournalEntry
from ._reading import read_event

T = TypeVar("T")

# No event has a higher number: asked for what comes after it, a daemon tells the newest alone.
_BEYOND_ALL = 2**53 - 1


def pages(
    ask: Callable[[int], tuple[list[T], int]], number: Callable[[T], int], after: int
) -> tuple[list[T], int]:
    """Asks for what is numbered higher than `after`, until all there was at the start is there.

    `ask` answers with some of them, oldest first, and the highest number there is. What is
    returned is all of them and that number.
    """
    records, newest = ask(after)
    page = records
    while page and number(page[-1]) < newest:
        page, _ = ask(number(page[-1]))
        records = records + page
    return records, newest


def mark_event_gaps(events: list[Event], last: int) -> list[Event]:
    """The same events, each with how many are missing before it; `last` came before the first."""
    marked = []
    for event in events:
        skipped = event.number - last - 1
        last = event.number
        marked.append(msgspec.structs.replace(event, skipped=skipped) if skipped else event)
    return marked


def mark_entry_gaps(entries: list[JournalEntry], last: int) -> list[JournalEntry]:
    """The same entries, each with how many commands are missing before it, as for events."""
    marked = []
    for entry in entries:
        is_batch = entry.verb == "batch" and isinstance(entry.args, dict)
        # Its `seq` is that of its last change.
        changes = len(entry.args.get("commands", [0])) if is_batch else 1
        skipped = max(0, entry.seq - last - changes)
        last = entry.seq
        marked.append(msgspec.structs.replace(entry, skipped=skipped) if skipped else entry)
    return marked


class EventReader:
    """Every event once and in order, whether it was published or asked for.

    Events are published on best effort and without a history. Their numbers tell which ones are
    missing, and those are asked for.
    """

    def __init__(self, ask: Callable[[int], tuple[list[Event], int]], after: int | None) -> None:
        self._ask = ask
        self._after = after
        self._last = 0
        self._is_over = False

    def first(self) -> list[Event]:
        """What is there already; called when nothing that is published is missed any more.

        Raises:
            Conflict: The swarm never had as many events as the caller knows of.
        """
        events, newest = self._ask(_BEYOND_ALL if self._after is None else self._after)
        self._last = newest if self._after is None else self._after
        if newest < self._last:
            raise Conflict(
                f"the swarm has had {newest} events and not {self._last}: it is another one than "
                "the one of this name that you followed. Begin with `after=0`",
                details={"field": "after", "expected": self._last, "actual": newest},
            )
        return self._follow(events)

    def read(self, payload: bytes) -> list[Event]:
        """What a published event brings: itself, and before it what was missed."""
        event = read_event(payload)
        if event.number > self._last + 1:
            return self._follow([*self._missed(), event])
        return self._follow([event])

    def look(self) -> list[Event]:
        """What has happened without being heard of."""
        return self._follow(self._missed())

    def _missed(self) -> list[Event]:
        try:
            return self._ask(self._last)[0]
        except JostleError:
            # The gap stays visible, and why nothing can be asked the stream finds out itself.
            return []

    def _follow(self, events: list[Event]) -> list[Event]:
        """Those of `events` that are new, with the gaps that stay."""
        # After its end a swarm of the same name may begin, and number its events from 1.
        if self._is_over:
            return []
        fresh = []
        newest = self._last
        for event in events:
            if event.number > newest:
                fresh.append(event)
                newest = event.number
        numbered = mark_event_gaps(fresh, self._last)
        self._last = newest
        self._is_over = any(event.kind == "deleted" for event in numbered)
        return numbered
