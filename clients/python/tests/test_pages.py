"""Readers of pages, with pages of every size: together they are the whole."""

from __future__ import annotations

import asyncio
import base64
import json
import math
import re
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually
from jostle import _replay, aio
from jostle._session import Session

Create = Callable[..., jostle.Swarm]


@dataclass
class Pages:
    """The size of pages that clients request from now on, and the requests meanwhile."""

    size: int | None = None
    requests: list[str] = field(default_factory=list)


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> Pages:
    """Makes every client of this process request pages of at most this size."""
    pages = Pages()
    query_all = Session.query_all

    def limited(
        self: Session, selector: str, wait_secs: float, payload: bytes | None = None
    ) -> Iterator[bytes]:
        is_page = re.search(r"/(get/(events|journal|audit)|results|order|series)\?", selector)
        if is_page and pages.size is not None:
            given = re.search(r";limit=(\d+)", selector)
            size = min(pages.size, math.inf if given is None else int(given[1]))
            selector = re.sub(r";limit=\d+", "", selector) + f";limit={size}"
            pages.requests.append(selector)
        return query_all(self, selector, wait_secs, payload)

    monkeypatch.setattr(Session, "query_all", limited)
    return pages


def sizes(count: int) -> list[int]:
    """Sizes that divide a number of records, that do not, and larger ones."""
    divisors = [size for size in range(2, count) if count % size == 0]
    chosen = {1, 2, 3, *divisors[-2:], count - 1, count, count + 1, 1000}
    return sorted(size for size in chosen if size > 0)


def is_equal(one: Any, other: Any) -> bool:
    """Whether two results are equal; undefined numbers are."""
    if isinstance(one, pd.DataFrame):
        pd.testing.assert_frame_equal(one, other, check_exact=True)
        return bool(one.attrs == other.attrs)
    if isinstance(one, jostle.OrderSeries):
        columns = ("time", "order", "drift")
        equal = (
            np.array_equal(getattr(one, it), getattr(other, it), equal_nan=True) for it in columns
        )
        return all(equal)
    return bool(one == other)


async def finished(awaited: Callable[[], Awaitable[Any]]) -> Any:
    """What a call returns."""
    return await awaited()


def check(
    pages: Pages,
    count: int,
    read: Callable[[], Any],
    awaited: Callable[[], Awaitable[Any]],
    *,
    requests: Callable[[int], int] | None = None,
    chosen: Callable[[int], list[int]] = sizes,
) -> Any:
    """Compares what is read of `count` records by pages of all sizes with what one page has.

    Returns it. `requests` is the least number of requests of pages of a size.
    """
    pages.size = 1000
    whole = read()
    for size in chosen(count):
        pages.size, pages.requests = size, []
        assert is_equal(whole, read()), size
        least = math.ceil(count / size) if requests is None else requests(size)
        # At most one page more, which is empty.
        assert least <= len(pages.requests) <= least + 1, (size, pages.requests)

        # asyncio reads by the same calls, in a thread.
        if size in (2, count):
            assert is_equal(whole, asyncio.run(finished(awaited))), size
    pages.size = None
    assert is_equal(whole, read())
    return whole


def test_events_of_all_pages_are_the_events(pages: Pages, create: Create, daemon: Daemon) -> None:
    swarm = create(4)
    for number in range(11):
        swarm.annotate(f"note {number}")

    async def history(after: int) -> Any:
        async with aio.connect(daemon.endpoint) as client:
            return await client.swarm(swarm.name).history(after)

    events = check(pages, 12, swarm.history, lambda: history(0))
    assert [it.number for it in events] == list(range(1, 13))
    assert [it.kind for it in events[:1]] == ["created"]
    rest = check(pages, 7, lambda: swarm.history(5), lambda: history(5))
    assert rest == events[5:]
    # A stream reads those that it has missed, page by page.
    for size in sizes(12):
        pages.size = size
        with swarm.events(after=0, timeout=MAX_WAIT_SECS) as stream:
            assert [next(stream) for _ in range(12)] == events, size

        async def streamed(size: int = size) -> None:
            async with aio.connect(daemon.endpoint) as client:
                stream = client.swarm(swarm.name).events(after=3, timeout=MAX_WAIT_SECS)
                async with stream:
                    assert [await anext(stream) for _ in range(9)] == events[3:], size

        asyncio.run(streamed())


def test_commands_of_all_pages_are_the_journal(
    pages: Pages, create: Create, daemon: Daemon
) -> None:
    swarm = create(6, seed=2)
    for number in range(6):
        swarm.set(pi2=0.5 + number / 64)
        swarm.step(3)
        swarm.inform(jostle.count(1), direction=float(number))
    commands = [it.verb for it in swarm.journal()]
    assert commands == ["set", "step", "inform"] * 6

    async def journal(**arguments: Any) -> Any:
        async with aio.connect(daemon.endpoint) as client:
            return await client.swarm(swarm.name).journal(**arguments)

    cases: list[tuple[dict[str, Any], list[int] | None]] = [
        ({}, list(range(18))),
        ({"after": 5}, list(range(5, 18))),
        ({"verb": "inform"}, list(range(2, 18, 3))),
        ({"from_step": 3, "to_step": 9}, None),
        ({"client": "nobody"}, []),
    ]
    for arguments, chosen in cases:
        expected = None if chosen is None else [it + 1 for it in chosen]
        count = len(swarm.journal(**arguments))
        entries = check(
            pages,
            max(count, 1),
            lambda arguments=arguments: swarm.journal(**arguments),  # type: ignore[misc]
            lambda arguments=arguments: journal(**arguments),  # type: ignore[misc]
        )
        if expected is not None:
            assert [it.seq for it in entries] == expected
        else:
            assert {it.step for it in entries} <= {3, 6, 9}
            assert len(entries) > 4


def test_lines_of_all_pages_are_the_audit_log(pages: Pages, own_daemon: Daemon) -> None:
    with jostle.connect(own_daemon.endpoint, client="ada") as client:
        # Equal commands share a line: each of these swarms has two of its own.
        for number in range(6):
            swarm = client.create(f"one-{number}", {"n": 2})
            swarm.set(pi2=0.4)

        async def audit(**arguments: Any) -> Any:
            async with aio.connect(own_daemon.endpoint) as other:
                return await other.audit(**arguments)

        every = client.audit(limit=None)
        assert [it.verb for it in every] == ["create", "set"] * 6
        for arguments, chosen in [
            ({"limit": None}, every),
            ({"limit": 7}, every[-7:]),
            ({"limit": 12}, every),
            ({"limit": 1}, every[-1:]),
            ({"limit": None, "verb": "set"}, every[1::2]),
            ({"limit": 4, "verb": "create"}, every[::2][-4:]),
        ]:
            lines = check(
                pages,
                len(chosen),
                lambda arguments=arguments: client.audit(**arguments),  # type: ignore[misc]
                lambda arguments=arguments: audit(**arguments),  # type: ignore[misc]
            )
            assert lines == chosen


INFORMED_LATE = {
    "name": "paged",
    "seed": 5,
    "replicates": 3,
    "duration": 0.46,
    "grid": [{"n": [3, 6]}, {"n": [4], "noise": [0.25, 0.5]}],
    # Some pages have no drift, some have both, some have one throughout.
    "at": [
        {"step": 7, "inform": {"select": {"count": 2}, "direction": 1.0}},
        {"step": 19, "uninform": {"select": {"informed": True}}},
    ],
    "measure": {
        "order_every": 2,
        "series_every": 3,
        "record_every": 4,
        "columns": ["drift", "milling"],
    },
}


def test_rows_and_series_of_all_pages_are_the_results(
    pages: Pages, client: jostle.Client, daemon: Daemon
) -> None:
    experiment = client.submit(INFORMED_LATE).wait(MAX_WAIT_SECS)

    def of(what: str, *arguments: Any) -> Callable[[], Awaitable[Any]]:
        async def read() -> Any:
            async with aio.connect(daemon.endpoint) as other:
                return await getattr(other.experiment("paged"), what)(*arguments)

        return read

    rows = check(pages, 12, experiment.rows, of("rows"))
    assert len({row.run for row in rows}) == 12
    frame = check(pages, 12, experiment.frame, of("frame"))
    assert list(frame.run) == [row.run for row in rows]
    run = rows[0].run
    # Before steps 0, 2, … 22, with the commands of the step.
    order = check(pages, 12, lambda: experiment.order(run), of("order", run))
    assert order.time == pytest.approx(0.02 * np.arange(0, 23, 2))
    assert np.isfinite(order.drift).tolist() == [7 <= step < 19 for step in range(0, 23, 2)]
    # At steps 0, 3, … 21 and 23, after the commands of the step.
    series = check(pages, 9, lambda: experiment.series(run), of("series", run))
    assert series.step.tolist() == [*range(0, 23, 3), 23]
    assert np.isfinite(series.drift).tolist() == [9 <= step < 19 for step in series.step]
    everything = check(
        pages,
        12,
        experiment.series,
        of("series"),
        requests=lambda size: every(size, 12, 9),
        chosen=lambda _: [2, 3, 9],
    )
    assert len(everything) == 12 * 9
    path = check(pages, 21, lambda: experiment.trajectory(run), of("trajectory", run))
    assert path.step.tolist() == [step for step in (*range(0, 23, 4), 23) for _ in range(3)]
    assert json.loads(path.attrs["spec"])["n"] == 3
    experiment.delete()

    never = client.submit({**INFORMED_LATE, "at": []}).wait(MAX_WAIT_SECS)
    order = check(pages, 12, lambda: never.order(run), of("order", run))
    assert order.drift.shape == order.time.shape == (12,)
    assert np.isnan(order.drift).all()
    series = check(pages, 9, lambda: never.series(run), of("series", run))
    assert series.drift.isna().all()
    assert series.milling.notna().all()
    never.delete()


def every(size: int, runs: int, entries: int) -> int:
    """The requests for the rows, and for the entries of each."""
    return math.ceil(runs / size) + runs * math.ceil(entries / size)


def test_a_recording_in_pieces_of_every_size_is_the_recording(
    client: jostle.Client, create: Create, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = create(9)
    begun = client.record(swarm.name, every=1, steps=40)
    swarm.step(40)
    eventually(
        "it has ended",
        lambda: {it.recording: it.phase for it in client.recordings()}[begun.recording] == "ended",
    )
    (part,) = client.fetch_recording(begun.recording, tmp_path / "whole", show=False).iterdir()
    whole = part.read_bytes()
    length = len(whole)
    query_all = Session.query_all
    pieces: list[int] = []

    def cut(
        self: Session, selector: str, wait_secs: float, payload: bytes | None = None
    ) -> Iterator[bytes]:
        # Pieces as a daemon with smaller messages would send them.
        for reply in query_all(self, selector, wait_secs, payload):
            if "get/recording?" not in selector:
                yield reply
                continue
            fields = json.loads(reply)
            piece = fields["result"]
            content = base64.b64decode(piece["bytes"])[:size]
            pieces.append(len(content))
            piece["bytes"] = base64.b64encode(content).decode()
            yield json.dumps(fields).encode()

    monkeypatch.setattr(Session, "query_all", cut)
    for size in (length // 40, math.ceil(length / 3), length - 1, length, length + 1):
        pieces.clear()
        folder = client.fetch_recording(begun.recording, tmp_path / f"of-{size}", show=False)
        assert (folder / part.name).read_bytes() == whole
        assert len([it for it in pieces if it]) == math.ceil(length / size)
    monkeypatch.undo()

    # And back, in messages of every size.
    steps = [frame.step for frame in jostle.read_recording(part)]
    for size in (length // 30, math.ceil(length / 2), length - 1, length, length + 1):
        monkeypatch.setattr(_replay, "_PIECE_BYTES", size)
        with client.replay(part, "in-pieces") as played:
            played.seek(step=steps[-1])
            assert np.array_equal(played.state().position, swarm.state().position)
            played.delete()
    client.delete_recording(begun.recording)


def test_every_query_for_a_page_is_tested(pages: Pages) -> None:
    """A new reader of pages must be in the tests above."""
    folder = Path(jostle.__file__).parent
    found = {
        (file.name, match[1])
        for file in folder.rglob("*.py")
        for match in re.finditer(
            r"[\"/]([\w/{}]+)\?[^\"]*(?:after|before|offset|page)", file.read_text()
        )
    }
    assert {name for name, _ in found} <= {
        *("_audit.py", "_experiment.py", "_past.py", "_recordings.py"),
    }
    assert {kind for _, kind in found} >= {"get/audit", "get/events", "results"}
