"""What is attached to a published state, and when it was received."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from ._decode import convert, read_map
from ._errors import Internal
from ._wire import Attachment


class Arrival(NamedTuple):
    """When this process received a message, nanoseconds since 1970, and what is attached to it."""

    unix_nanos: int
    attachment: bytes | None


def read_attachment(attachment: bytes | None) -> Attachment | None:
    """Reads an attachment; None if there is none, or one that this version does not know."""
    if attachment is None:
        return None
    try:
        return convert(read_map(attachment), Attachment)
    except Internal:
        # The state is complete without it.
        return None


def time_of(unix_nanos: int | None) -> datetime | None:
    """A time as an aware datetime, UTC, to the microsecond; None if it is beyond year 9999."""
    if unix_nanos is None:
        return None
    try:
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=unix_nanos // 1000)
    except OverflowError:
        return None


def unix_secs(unix_nanos: int | None) -> float:
    """A time in seconds since 1970, NaN if it is unknown, as the tables of recordings have it."""
    return float("nan") if unix_nanos is None else unix_nanos / 1e9
