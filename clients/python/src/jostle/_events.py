"""Events and journal entries of swarms, as msgspec structs."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from ._errors import ErrorMessage
from ._messages import Phase, Reply
from ._repr import HtmlStruct


class Dated(HtmlStruct, frozen=True, kw_only=True):
    """A message with the time of the daemon's wall clock.

    Attributes:
        unix_secs: Seconds since 1970, UTC, to the millisecond; None if it is not known, as in
            entries of older daemons.
    """

    unix_secs: float | None = None

    @property
    def when(self) -> datetime | None:
        """`unix_secs` as an aware datetime, UTC; None if it is not known or beyond year 9999."""
        if self.unix_secs is None:
            return None
        try:
            since = timedelta(milliseconds=round(self.unix_secs * 1000))
            return datetime(1970, 1, 1, tzinfo=UTC) + since
        except (OverflowError, ValueError):
            return None


class Event(Dated, frozen=True, kw_only=True):
    """An event of a swarm.

    The fields of each `kind`, beside those of all; the other fields are None:

    - `created`: the swarm was created; its first event: `verb, client, request_id`.
    - `phase`: its phase changed: `reason`.
    - `command`: a command was applied: `seq, verb, args, client, request_id`.
    - `scheduled`: a command waits for its step: `applies_at_step, verb, args, client, request_id`.
    - `refused`: a scheduled command was rejected: `error, verb, args, client, request_id`.
    - `lapsed`: the time of informed individuals ended, and they are uninformed: `ids`.
    - `fault`: a step failed; the swarm keeps its last good state: `reason`.
    - `recording_failed`: a recording of the daemon failed; its files are kept: `recording, reason`.
    - `deleted`: the swarm was deleted; its last event: `client, request_id`.

    A newer daemon may send other kinds.

    Attributes:
        swarm: The swarm's name.
        number: The number of the event, from 1.
        epoch: Increases when `step` does not continue what was published before.
        step: The step of the event.
        time: `step · dt`, body sizes over free speed.
        phase: The phase after the event.
        unix_secs: The daemon's wall clock, seconds since 1970, UTC; None if it is not known. `when`
            is the same as a datetime.
        kind: The kind of event, see above.
        reason: The cause.
        seq: Number of commands applied to the swarm.
        applies_at_step: The step that the command waits for.
        verb: The command's verb.
        args: The command's arguments as they were sent.
        client: The name of the client that sent the command.
        request_id: The id of the request.
        error: Why the command was rejected.
        ids: The ids of the individuals concerned, ascending.
        recording: The name of the daemon's recording.
        skipped: Number of events between the previous one and this that the daemon no longer
            stores; it stores about a thousand.
    """

    swarm: str
    number: int
    epoch: int
    step: int
    time: float
    phase: Phase
    kind: str
    reason: str | None = None
    seq: int | None = None
    applies_at_step: int | None = None
    verb: str | None = None
    args: Any = None
    client: str | None = None
    request_id: str | None = None
    error: ErrorMessage | None = None
    ids: list[int] | None = None
    recording: str | None = None
    skipped: int = 0


class Events(Reply, frozen=True, kw_only=True):
    """A page of the events that a daemon stores of a swarm.

    Attributes:
        events: The events of the page, oldest first.
        oldest: The number of the oldest stored event; None if there is none.
        newest: The number of the newest event; 0 before the first.
    """

    events: list[Event]
    oldest: int | None = None
    newest: int


class JournalEntry(Dated, frozen=True, kw_only=True):
    """A command that a swarm applied.

    Attributes:
        seq: The number of the command; each change of a `batch` has one, and its entry has that of
            the last.
        epoch: The epoch in which it was applied.
        step: The step at which it was applied.
        time: `step · dt`, body sizes over free speed.
        unix_secs: The daemon's wall clock, seconds since 1970, UTC; None if it is not known, as in
            entries of older daemons. `when` is the same as a datetime.
        verb: Its verb.
        args: Its arguments as they were sent.
        client: The name of the client that sent it.
        request_id: The id of the request.
        skipped: Number of commands between the previous entry and this that the daemon no longer
            stores; 0 if only some commands were selected.
    """

    seq: int
    epoch: int
    step: int
    time: float
    verb: str
    args: Any = None
    client: str | None = None
    request_id: str | None = None
    skipped: int = 0


class Journal(Reply, frozen=True, kw_only=True):
    """A page of the commands that a daemon stores of a swarm.

    Attributes:
        entries: The entries of the page, oldest first.
        oldest: The `seq` of the oldest stored entry; None if there is none.
        newest: The `seq` of the newest entry; 0 before the first.
        next: The line of the journal at which the next page begins; None after the last page, and
            from an earlier daemon.
    """

    entries: list[JournalEntry]
    oldest: int | None = None
    newest: int
    next: int | None = None
