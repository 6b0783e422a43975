"""Numbered records: queried page by page, and merged with those that are published."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from ._attachment import Arrival
from ._decode import read_event
from ._errors import Conflict, JostleError
from ._wire import Event, Journal, JournalEntry

T = TypeVar("T")
R = TypeVar("R", Event, JournalEntry)

# No event has a higher number: a query after it returns only the number of the newest event.
_MAX_NUMBER = 2**53 - 1


def pages(
    request: Callable[[int], tuple[list[T], int]], number: Callable[[T], int], after: int
) -> tuple[list[T], int]:
    """Queries the records of higher numbers than `after`, up to the newest at the start.

    `request` returns a page of them, oldest first, and the number of the newest record. Returns all
    of them and that number.
    """
    records, newest = request(after)
    page = records
    while page and number(page[-1]) < newest:
        page, _ = request(number(page[-1]))
        records = records + page
    return records, newest


def journal_entries(
    request: Callable[[str], Journal], after: int, parameters: str
) -> list[JournalEntry]:
    """Queries the commands after a `seq` that `parameters` select, up to the newest."""
    start = f"after={after};limit=1000{parameters}"
    page = request(start)
    entries = list(page.entries)
    line = 0
    while True:
        if page.next is not None and page.next > line:
            line = page.next
            page = request(f"{start};line={line}")
        elif (
            not parameters
            and page.next is None
            and page.entries[-1:]
            and (page.entries[-1].seq < page.newest)
        ):
            # An earlier daemon sends no next line.
            page = request(f"after={page.entries[-1].seq};limit=1000")
        else:
            return entries
        entries += page.entries


def mark_gaps(records: list[R], last: int) -> list[R]:
    """Sets `skipped` of each record; `last` is the number before the first."""
    marked = []
    for record in records:
        number, count = (
            (record.number, 1) if isinstance(record, Event) else _seq_and_changes(record)
        )
        skipped = max(0, number - last - count)
        last = number
        marked.append(msgspec.structs.replace(record, skipped=skipped) if skipped else record)
    return marked


def _seq_and_changes(entry: JournalEntry) -> tuple[int, int]:
    """The `seq` of an entry, which is that of its last change, and the number of its changes."""
    is_batch = entry.verb in {"batch", "fired"} and isinstance(entry.args, dict)
    return entry.seq, len(entry.args.get("commands") or [0]) if is_batch else 1


class EventReader:
    """Yields every event once and in order.

    Events are published with best effort and without a history. Their numbers show which are
    missing, and those are queried.
    """

    def __init__(
        self, request: Callable[[int], tuple[list[Event], int]], after: int | None
    ) -> None:
        self._request = request
        self._after = after
        self._last = 0
        self._is_over = False

    def first(self) -> list[Event]:
        """The stored events; called after the stream has subscribed.

        Raises:
            Conflict: The swarm has had fewer events than the caller has read.
        """
        events, newest = self._request(_MAX_NUMBER if self._after is None else self._after)
        self._last = newest if self._after is None else self._after
        if newest < self._last:
            raise Conflict(
                f"the swarm has had {newest} events and not {self._last}: it is another swarm of "
                "the same name. Begin with `after=0`",
                details={"field": "after", "expected": self._last, "actual": newest},
            )
        return self._follow(events)

    def read(self, payload: bytes, _arrival: Arrival | None = None, /) -> list[Event]:
        """The published event, preceded by the missing ones."""
        event = read_event(payload)
        if event.number > self._last + 1:
            return self._follow([*self._missed(), event])
        return self._follow([event])

    def poll(self) -> list[Event]:
        """The events that were lost since the last message."""
        return self._follow(self._missed())

    def refresh(self) -> list[Event]:
        """The events that were missed, or all of another swarm of the name."""
        events, newest = self._request(self._last)
        if newest < self._last:
            self._last = 0
            events, _ = self._request(0)
        return self._follow(events)

    def _missed(self) -> list[Event]:
        try:
            return self._request(self._last)[0]
        except JostleError:
            # `skipped` shows the gap, and the stream reports the cause.
            return []

    def _follow(self, events: list[Event]) -> list[Event]:
        """The new ones of `events`, with `skipped` set."""
        # After `deleted` another swarm of the same name may number its events from 1.
        if self._is_over:
            return []
        fresh = []
        newest = self._last
        for event in events:
            if event.number > newest:
                fresh.append(event)
                newest = event.number
        numbered = mark_gaps(fresh, self._last)
        self._last = newest
        self._is_over = any(event.kind == "deleted" for event in numbered)
        return numbered
