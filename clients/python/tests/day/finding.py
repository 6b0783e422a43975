"""What a judge finds."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """What was seen of a promise.

    Attributes:
        holds: Whether nothing contradicts it; None if the day has not come to what it is about.
        seen: What was seen, in words.
        cases: How many cases were judged; of too few of them no promise holds.
    """

    holds: bool | None
    seen: str
    cases: int
