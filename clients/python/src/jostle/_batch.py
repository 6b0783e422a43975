"""The changes of a `batch` as on the wire."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ._changes import Change
from ._errors import invalid


def encode_changes(changes: Iterable[Change | Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The changes of a `batch` as on the wire.

    Raises:
        InvalidArgument: They are no iterable, or one of them is no change.
    """
    if not isinstance(changes, Iterable):
        raise invalid(
            "commands",
            f"commands is {changes!r}, but must be several changes, such as [jostle.Set(pi3=2)]",
        )
    encoded = []
    for index, change in enumerate(changes):
        if isinstance(change, Change):
            encoded.append({"verb": change.verb, "args": change})
        elif isinstance(change, Mapping):
            encoded.append(dict(change))
        else:
            raise invalid(
                f"commands[{index}]",
                f"commands[{index}] is {change!r}, but must be a change such as jostle.Set(pi3=2)",
            )
    return encoded
