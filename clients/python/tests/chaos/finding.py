"""The result of a judge."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """What a judge found out about a guarantee.

    Attributes:
        holds: Whether no case violates it; None if the run had no case of it.
        seen: The cases and violations, in words.
        cases: How many cases were judged; with too few of them the guarantee is not confirmed.
    """

    holds: bool | None
    seen: str
    cases: int
