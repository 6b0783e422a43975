"""The base of messages with a time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

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
