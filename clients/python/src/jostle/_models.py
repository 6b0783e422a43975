"""Results of which another version of the model executed the runs: no run is added to them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from ._delivery import RUNS
from ._errors import Conflict
from ._part import Header


def other_model(folders: Iterable[Path], ours: int) -> int | None:
    """The newest other version than `ours` that executed the runs of a folder; None without one."""
    versions = {_version(folder) for folder in folders} - {None, ours}
    return max((it for it in versions if it is not None), default=None)


def _version(folder: Path) -> int | None:
    try:
        with (folder / RUNS).open("rb") as lines:
            return msgspec.json.decode(lines.readline(), type=Header).model_version
    except (FileNotFoundError, NotADirectoryError, msgspec.DecodeError):
        return None


def model_conflict(folder: Path, theirs: int, ours: int) -> Conflict:
    """The error if another version of the model executed runs of a sweep or a search.

    `details["again"]` is the folder in which this version executes all of them again. Nothing is
    executed again under an earlier version.
    """
    problem = f"{folder} has runs of version {theirs} of the model, and this program has {ours}"
    details = {"field": "folder", "model_version": theirs}
    if theirs > ours:
        return Conflict(
            f"{problem}: use the version of jostle that executed them, or choose another folder",
            details=details,
        )
    again = folder.with_name(f"{folder.name}-model{ours}")
    return Conflict(
        f"{problem}: they remain readable, and none is added; pass `again=True` to execute all of "
        f"them again in {again}",
        details={**details, "again": str(again)},
    )
