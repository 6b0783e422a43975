"""Recordings that a daemon makes: every k-th state of a swarm, in its data directory."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any, Literal

import msgspec

from ._errors import IncorrectState, InvalidArgument
from ._link import Link
from ._progress import Bar
from ._reading import read_reply
from ._show import Shown

RecordingFormat = Literal["mcap", "parquet"]
"""How a daemon writes a recording: messages as they are published, or a table."""

RecordingPhase = Literal["recording", "ended", "failed"]
"""The phase of a recording: it is running, and resumes after a restart of the daemon; it has ended,
for `reason`; or it has failed."""


class RecordingStatus(Shown, frozen=True, kw_only=True):
    """How a recording of a daemon's stands; of a deleted one, how it stood.

    Attributes:
        recording: Its name, and its folder's below `recordings` in the daemon's data directory.
        swarm: Whom it is of.
        format: `mcap`, or `parquet` if an earlier version recorded it.
        every: The states whose step is a multiple of this are in it; None is what was published, by
            an earlier version.
        phase: What it is doing.
        reason: Why it ended or failed.
        frames: States that were recorded.
        missed: States that it left out because the disk did not keep up.
        parts: Files that are whole.
        bytes: Theirs.
        began_unix_secs: When it began, in seconds since 1970.
        drop_when_behind: Whether it leaves states out while the disk does not keep up; otherwise
            the swarm waits.
        max_bytes: The size in bytes at which it ends; None for a recording of an earlier version,
            which has no limit.
        temporary: Whether the client that fetches it is to delete it afterwards.
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
    drop_when_behind: bool
    max_bytes: int | None = None
    temporary: bool


class RecordingResult(RecordingStatus, frozen=True, kw_only=True):
    """How a recording of the daemon `node` stands."""

    node: str


class Recordings(msgspec.Struct, frozen=True, kw_only=True):
    """All that the daemon `node` has, ordered by name."""

    node: str
    recordings: list[RecordingStatus]


class RecordingPiece(msgspec.Struct, frozen=True, kw_only=True):
    """A piece of a whole part of a recording.

    Attributes:
        node: The daemon that has it.
        recording: Its name.
        part: The number of the part, from 0.
        parts: Parts that are whole now.
        offset: Where in the part the piece begins, in bytes.
        length: How long the part is, in bytes.
        bytes: The piece, as base64; empty where the part ends.
    """

    node: str
    recording: str
    part: int
    parts: int
    offset: int
    length: int
    bytes: str


def fetch(
    link: Link, node: str, status: RecordingStatus, path: str | os.PathLike[str], show: bool | None
) -> Path:
    """Fetches what a folder does not have of a recording that is over."""
    if status.phase == "recording":
        raise IncorrectState(
            f"{status.recording} still records: `stop_recording({status.recording!r})` ends it"
        )
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    fetched = 0
    with Bar(status.recording, show) as bar:
        for part in range(status.parts):
            name = f"part-{part:05}.{status.format}"
            partial = folder / f".{name}.partial"
            selector = f"{link.node_key(node, 'get/recording')}?name={status.recording};part={part}"
            if (folder / name).exists():
                size = (folder / name).stat().st_size
                piece = _piece(link, f"{selector};offset={size}", folder / name)
                if piece.length != size:
                    raise _other(folder / name)
                fetched += size
                continue
            with partial.open("ab") as file:
                while True:
                    offset = file.tell()
                    piece = _piece(link, f"{selector};offset={offset}", partial)
                    content = base64.b64decode(piece.bytes)
                    file.write(content)
                    bar.show((fetched + offset) / status.bytes if status.bytes else 1.0)
                    if not content or offset + len(content) >= piece.length:
                        break
                file.flush()
                os.fsync(file.fileno())
                fetched += file.tell()
            partial.rename(folder / name)
    return folder


def _piece(link: Link, selector: str, path: Path) -> RecordingPiece:
    """What follows what a file has already."""
    try:
        return read_reply(link.get(selector, swarm=None), RecordingPiece)
    except InvalidArgument as error:
        # The file is longer than the part.
        raise _other(path) from error


def _other(path: Path) -> InvalidArgument:
    return InvalidArgument(
        f"{path} is of another recording: choose another folder", details={"field": "path"}
    )


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
