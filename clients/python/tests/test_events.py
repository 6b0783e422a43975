"""Events without gaps and duplicates, whenever a reader subscribes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import jostle
from conftest import MAX_WAIT_SECS, Wire
from jostle import _stream, _swarm
from jostle._decode import read_event
from jostle._history import EventReader

Create = Callable[..., jostle.Swarm]


def payload(number: int, kind: str = "phase") -> bytes:
    """An event as it is published."""
    place = {"swarm": "school", "epoch": 1, "step": 0, "time": 0.0, "phase": "paused"}
    return json.dumps({**place, "number": number, "event": {"kind": kind, "reason": None}}).encode()


class Past:
    """The events that a daemon stores."""

    def __init__(self, numbers: range) -> None:
        self.numbers = numbers
        self.is_there = True
        self.requested: list[int] = []

    def __call__(self, after: int) -> tuple[list[jostle.Event], int]:
        """Replies as `get/events` does."""
        self.requested.append(after)
        if not self.is_there:
            raise jostle.NotFound("no such swarm")
        newest = self.numbers[-1] if self.numbers else 0
        return [read_event(payload(n)) for n in self.numbers if n > after], newest


def numbers(events: list[jostle.Event]) -> list[tuple[int, int]]:
    return [(event.number, event.skipped) for event in events]


def test_missing_events_are_requested() -> None:
    past = Past(range(1, 5))
    reader = EventReader(past, after=None)
    assert reader.first() == []
    assert numbers(list(reader.read(payload(5)))) == [(5, 0)]
    past.numbers = range(3, 9)
    assert numbers(reader.read(payload(8))) == [(6, 0), (7, 0), (8, 0)]
    # Late, and duplicated.
    for number in (7, 8, 1):
        assert reader.read(payload(number)) == []
    assert past.requested[1:] == [5]


def test_events_dropped_by_the_daemon_are_counted() -> None:
    past = Past(range(1, 3))
    reader = EventReader(past, after=None)
    reader.first()
    past.numbers = range(8, 11)
    assert numbers(reader.read(payload(10))) == [(8, 5), (9, 0), (10, 0)]
    past.is_there = False
    assert numbers(reader.read(payload(14))) == [(14, 3)]
    assert reader.poll() == []
    past.is_there, past.numbers = True, range(8, 17)
    assert numbers(reader.poll()) == [(15, 0), (16, 0)]


def test_history_comes_first_and_events_published_meanwhile_once() -> None:
    reader = EventReader(Past(range(4, 8)), after=2)
    assert numbers(reader.first()) == [(4, 1), (5, 0), (6, 0), (7, 0)]
    assert reader.read(payload(6)) == []
    assert numbers(reader.read(payload(8))) == [(8, 0)]


def test_after_the_end_no_event_of_another_swarm_of_the_name_follows() -> None:
    reader = EventReader(Past(range(1, 4)), after=3)
    assert reader.first() == []
    assert numbers(reader.read(payload(4, kind="deleted"))) == [(4, 0)]
    for number in range(1, 9):
        assert reader.read(payload(number)) == []
    assert reader.poll() == []


def test_a_late_subscriber_gets_the_history_and_then_live_events(create: Create) -> None:
    swarm = create(n=2)
    for number in range(20):
        swarm.set(publish_every=1 + number)
    with swarm.events(after=0, timeout=MAX_WAIT_SECS) as events:
        past = list(itertools.islice(events, 21))
        swarm.set(pi3=0.5)
        past.append(next(events))
    assert [event.number for event in past] == list(range(1, 23))
    assert (past[0].kind, past[-1].args) == ("created", {"pi3": 0.5})
    assert {event.skipped for event in past} == {0}
    with swarm.events(after=past[9].number, timeout=MAX_WAIT_SECS) as events:
        assert list(itertools.islice(events, 12)) == past[10:]


def test_subscribing_amid_many_events_misses_and_repeats_none(create: Create) -> None:
    swarm = create(n=1)

    def work() -> None:
        for number in range(300):
            swarm.set(pi3=1.0 + number / 512)

    with ThreadPoolExecutor(1) as pool:
        busy = pool.submit(work)
        while not busy.done():
            with swarm.events(after=0, timeout=MAX_WAIT_SECS) as events:
                got = [next(events).number for _ in range(swarm.status().seq)]
                assert got == list(range(1, len(got) + 1))
        busy.result()


def test_unread_events_beyond_the_queue_are_requested(
    create: Create, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_swarm, "_EVENT_CAPACITY", 5)
    swarm = create(n=2)
    with swarm.events(timeout=MAX_WAIT_SECS) as events:
        for number in range(200):
            swarm.set(publish_every=1 + number)
        got = list(itertools.islice(events, 200))
    assert [event.args["publish_every"] for event in got] == list(range(1, 201))
    assert {event.skipped for event in got} == {0}


def test_events_that_are_lost_are_counted(create: Create, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_swarm, "_EVENT_CAPACITY", 5)
    swarm = create(n=2)
    with swarm.events(timeout=MAX_WAIT_SECS) as events:
        for number in range(1200):
            swarm.set(publish_every=1 + number)
        first = next(events)
        got = [first, *itertools.islice(events, 1200 - first.skipped - 1)]
    assert first.skipped > 100
    assert sum(event.skipped + 1 for event in got) == 1200
    assert got[-1].args == {"publish_every": 1200}


def test_a_lost_last_event_is_requested_after_a_pause(
    create: Create, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_stream, "_SILENCE_SECS", 0.2)
    # No published event arrives.
    monkeypatch.setattr(_stream._Inbox, "on_sample", lambda inbox, sample: None)
    swarm = create(n=2)
    with swarm.events(timeout=MAX_WAIT_SECS) as events:
        swarm.set(pi3=2.0)
        assert next(events).args == {"pi3": 2.0}
    with swarm.events(timeout=0.3) as events, pytest.raises(jostle.DeadlineExceeded):
        next(events)


def test_events_of_another_swarm_of_the_same_name_are_an_error(
    client: jostle.Client,
) -> None:
    swarm = client.create("followed", jostle.Spec(n=2))
    for _ in range(5):
        swarm.set(pi3=2.0)
    with swarm.events(after=0, timeout=MAX_WAIT_SECS) as events:
        swarm.delete()
        seen = list(events)
    assert [event.kind for event in seen][-1] == "deleted"
    assert [event.number for event in seen] == list(range(1, 8))
    again = client.create("followed", jostle.Spec(n=2))
    try:
        with pytest.raises(jostle.Conflict) as caught:
            again.events(after=seen[-1].number)
        assert caught.value.details == {"field": "after", "expected": 7, "actual": 1}
        with again.events(after=0, timeout=MAX_WAIT_SECS) as events:
            assert next(events).kind == "created"
        wrong: list[Any] = [-1, 1.5, "now"]
        for after in wrong:
            with pytest.raises(jostle.InvalidArgument):
                again.events(after=after)
    finally:
        again.delete()


def test_a_stream_continues_through_broken_connections(wire: Wire, create: Create) -> None:
    swarm = create(n=2)
    with (
        jostle.connect(wire.endpoint) as client,
        client.swarm(swarm.name).events(after=0, timeout=MAX_WAIT_SECS) as events,
    ):
        seen = [next(events)]
        for number in range(20):
            swarm.set(publish_every=1 + 2 * number)
            seen.append(next(events))
            wire.cut()
            swarm.set(publish_every=2 + 2 * number)
            seen.append(next(events))
    assert [event.number for event in seen] == list(range(1, 42))
    assert {event.skipped for event in seen} == {0}
