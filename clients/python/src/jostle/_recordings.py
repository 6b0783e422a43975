"""Recordings that a daemon makes, in its data directory, whoever looks on."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from ._link import Link
from ._reading import read_reply
from ._show import Shown

RecordingFormat = Literal["mcap", "parquet"]
"""How a daemon writes a recording: what was published as it was, or a table."""

RecordingPhase = Literal["recording", "ended", "failed"]
"""What a recording is doing: it goes on, also when the daemon starts anew; it was stopped, or its
swarm was deleted; it cannot go on."""


class RecordingStatus(Shown, frozen=True, kw_only=True):
    """How a recording of a daemon's stands; of a deleted one, how it stood.

    Attributes:
        recording: Its name, and its folder's below `recordings` in the daemon's data directory.
        swarm: Whom it is of.
        format: How it is written.
        every: Only states at least so many steps apart are in it; None is all that were shown.
        phase: What it is doing.
        reason: Why it ended or failed.
        frames: States that were recorded.
        missed: States that came faster than they could be written.
        parts: Files that are whole.
        bytes: Theirs.
        began_unix_secs: When it began, in seconds since 1970.
    """

    recording: str
    swarm: str
    format: RecordingFormat
    every: int | None = None
    phase: RecordingPhase
    reason: str | None = None
    frames: int
    missed: int
    parts: int
    bytes: int
    began_unix_secs: int


class RecordingResult(RecordingStatus, frozen=True, kw_only=True):
    """How a recording of the daemon `node` stands."""

    node: str


class Recordings(msgspec.Struct, frozen=True, kw_only=True):
    """All that the daemon `node` has, ordered by name."""

    node: str
    recordings: list[RecordingStatus]


def send_record(
    link: Link,
    node: str,
    args: dict[str, Any],
    timeout: float | None = None,
    request_id: str | None = None,
) -> RecordingStatus:
    """Has a daemon do something with a recording."""
    key = link.node_key(node, "cmd/record")
    payload = link.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
    return read_reply(payload, RecordingResult)
