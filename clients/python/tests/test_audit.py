"""Pages of the audit log and of journals, from this and from earlier daemons."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec
import pytest

import jostle
from jostle._audit import newest_lines, selection
from jostle._errors import JostleError
from jostle._history import journal_entries
from jostle._queries import Queries
from jostle._wire import Audit, Journal


def _line(number: int) -> dict[str, Any]:
    return {
        "number": number,
        "unix_secs": 1795531201.25 + number,
        "last_unix_secs": 1795531201.25 + number,
        "count": 1,
        "verb": "pause",
        "outcomes": [{"outcome": "ok", "count": 1}],
    }


def _log(numbers: range, damaged: int = 0) -> Callable[[str], Audit]:
    """Replies to queries as a daemon with these lines."""

    def request(rest: str) -> Audit:
        parameters = dict(it.split("=") for it in rest.partition("?")[2].split(";"))
        earlier = [it for it in numbers if it < int(parameters["before"])]
        page = {
            "node": "lab",
            "lines": [_line(it) for it in earlier[-int(parameters["limit"]) :]],
            "oldest": numbers[0] if numbers else None,
            "newest": numbers[-1] if numbers else 0,
            "damaged": damaged,
        }
        return msgspec.convert(page, Audit)

    return request


def test_the_newest_lines_are_read_page_by_page() -> None:
    log = _log(range(3, 2704))
    assert [line.number for line in newest_lines(log, "", 2)] == [2702, 2703]
    assert [line.number for line in newest_lines(log, "", None)] == list(range(3, 2704))
    assert [line.number for line in newest_lines(log, "", 1500)] == list(range(1204, 2704))
    assert newest_lines(_log(range(0)), "", None) == []
    (line,) = newest_lines(log, "", 1)
    assert line.when == datetime.fromtimestamp(1795531201.25 + 2703, UTC)
    for limit in (0, -1, 1.5):
        with pytest.raises(jostle.InvalidArgument, match="limit is"):
            newest_lines(log, "", limit)  # type: ignore[arg-type]


def test_damaged_lines_are_a_warning() -> None:
    with pytest.warns(RuntimeWarning, match="4 lines of the audit log cannot be read"):
        lines = newest_lines(_log(range(1, 1501), damaged=2), "", None)
    assert len(lines) == 1500


def test_times_have_a_zone_or_are_so_long_ago() -> None:
    ago = selection(None, None, None, None, timedelta(hours=2), None)
    now = datetime.now(UTC).timestamp()
    assert 7200.0 <= now - float(ago.removeprefix(";from_time=")) + 0.001 < 7260.0
    for when in (datetime(2026, 11, 28), 1795849200.0):
        with pytest.raises(jostle.InvalidArgument, match="with a time zone"):
            selection(None, None, None, None, when, None)  # type: ignore[arg-type]
    with pytest.raises(jostle.InvalidArgument, match="which is before since"):
        selection(None, None, None, None, timedelta(hours=2), timedelta(hours=3))
    for text in ("a;limit=1", "a" * 257):
        with pytest.raises(jostle.InvalidArgument, match="user is"):
            selection(text, None, None, None, None, None)
    # No text selects the lines without a user.
    assert selection("", None, None, None, None, None) == ";user="


def _entry(seq: int) -> dict[str, Any]:
    return {"seq": seq, "epoch": 1, "step": 0, "time": 0.0, "verb": "set", "args": {}}


def _journal(seqs: list[int], newest: int, next: int | None = None) -> Journal:
    stamp = {"swarm": "s", "epoch": 1, "step": 0, "time": 0.0, "phase": "paused", "seq": newest}
    page = {"entries": [_entry(seq) for seq in seqs], "newest": newest, "next": next}
    return msgspec.convert({**stamp, **page}, Journal)


def _replies(pages: dict[str, Journal]) -> Callable[[str], Journal]:
    """Replies to each query once."""
    return pages.pop


def test_a_journal_is_read_by_its_next_line() -> None:
    pages = {
        "after=0;limit=1000;verb=set": _journal([], 9, next=10_001),
        "after=0;limit=1000;verb=set;line=10001": _journal([4], 9, next=20_001),
        "after=0;limit=1000;verb=set;line=20001": _journal([7], 9),
    }
    entries = journal_entries(_replies(pages), 0, ";verb=set")
    assert [entry.seq for entry in entries] == [4, 7]
    # A daemon that names the same line again sends no page twice.
    pages = {
        "after=2;limit=1000": _journal([3], 9, next=5),
        "after=2;limit=1000;line=5": _journal([4], 9, next=5),
    }
    assert [entry.seq for entry in journal_entries(_replies(pages), 2, "")] == [3, 4]


def test_a_journal_of_an_earlier_daemon_is_read_by_seq() -> None:
    pages = {
        "after=0;limit=1000": _journal([1, 2], 3),
        "after=2;limit=1000": _journal([3], 3),
    }
    assert [entry.seq for entry in journal_entries(_replies(pages), 0, "")] == [1, 2, 3]
    # The newest command is not durable yet.
    pages = {"after=0;limit=1000": _journal([1], 2), "after=1;limit=1000": _journal([], 2)}
    assert [entry.seq for entry in journal_entries(_replies(pages), 0, "")] == [1]


class _Rejecting(Queries):
    """A swarm of a daemon that rejects every query."""

    def __init__(self, error: JostleError) -> None:
        self._error = error

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        raise self._error


def test_an_earlier_daemon_is_reported() -> None:
    known = {"field": "verb", "known": ["after", "limit"]}
    unknown = jostle.InvalidArgument("unknown parameter", details=known)
    with pytest.raises(jostle.Unavailable, match="earlier version, which only lists all commands"):
        _Rejecting(unknown).journal(verb="set")
    other = jostle.InvalidArgument("no verb of a swarm", details={"field": "verb"})
    with pytest.raises(jostle.InvalidArgument):
        _Rejecting(other).journal(verb="sets")

    def request(rest: str) -> Audit:
        raise jostle.NotFound('there is no "audit" to get', details={"known": ["hello"]})

    with pytest.raises(jostle.Unavailable, match="earlier version, which has no audit log"):
        newest_lines(request, "", None)
