"""What happened to a swarm, as msgspec structs."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from ._errors import ErrorMessage
from ._messages import Phase, Reply
from ._show import Shown


class Dated(Shown, frozen=True, kw_only=True):
    """A message that says when something happened by the daemon's wall clock.

    Attributes:
        unix_secs: Seconds since 1970, UTC, to the millisecond; None if it is not known, as of what
            older daemons journaled.
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
    """Something that happened to a swarm.

    What it tells beside when it happened depends on its `kind`; the rest is None:

    - `created`: the swarm was created, which is the first event of each.
    - `phase`: its phase changed: `reason`.
    - `command`: a command was applied: `seq, verb, args, client, request_id`.
    - `scheduled`: one waits for its step: `applies_at_step, verb, args, client, request_id`.
    - `refused`: one that waited was not carried out: `error, verb, args, client, request_id`.
    - `lapsed`: individuals informed for a time are uninformed again: `ids`.
    - `fault`: a step failed, the last good state is kept: `reason`.
    - `recording_failed`: a recording of it by the daemon has failed, what was recorded before is
      kept: `recording, reason`.
    - `deleted`: the swarm was deleted, which is the last event.

    A newer daemon may tell of other kinds.

    Attributes:
        swarm: The swarm's name.
        number: Counts the swarm's events from 1.
        epoch: Grows whenever `step` does not continue what was published before.
        step: The step it happened at.
        time: `step · dt`.
        phase: What the swarm does from then on.
        unix_secs: When it happened by the daemon's wall clock, seconds since 1970, UTC; None if it
            is not known. `when` is the same as a datetime.
        kind: What happened, see above.
        reason: Why.
        seq: Counts the swarm's applied commands.
        applies_at_step: The step that the command waits for.
        verb: The command's verb.
        args: Its arguments as they came.
        client: Who says to have sent it.
        request_id: What the sender called it.
        error: Why it was not carried out.
        ids: Whom it is about, ascending.
        recording: The daemon's recording that it is about.
        skipped: How many events lie between the one before and this that could not be had any
            more: a daemon remembers the last thousand or so.
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
    """Some of the events that a daemon still has of a swarm.

    Attributes:
        events: As many as one answer holds, oldest first.
        oldest: The number of the oldest there is; None if there is none.
        newest: The number of the newest; 0 before the first.
    """

    events: list[Event]
    oldest: int | None = None
    newest: int


class JournalEntry(Dated, frozen=True, kw_only=True):
    """A command that a swarm applied.

    Attributes:
        seq: Counts the swarm's applied commands; a `batch` counts each of its changes and stands
            here with the last.
        epoch: The epoch it was applied in.
        step: The step it was applied at.
        time: `step · dt`.
        unix_secs: When it was applied by the daemon's wall clock, seconds since 1970, UTC; None if
            it is not known, as of what older daemons journaled. `when` is the same as a datetime.
        verb: Its verb.
        args: Its arguments as they came.
        client: Who says to have sent it.
        request_id: What the sender called it.
        skipped: How many commands lie between the one before and this that the daemon has
            forgotten.
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
    """Some of the commands that a swarm applied and its daemon still has.

    Attributes:
        entries: As many as one answer holds, oldest first.
        oldest: The `seq` of the oldest there is; None if there is none.
        newest: The `seq` of the newest; 0 before the first.
    """

    entries: list[JournalEntry]
    oldest: int | None = None
    newest: int
