"""Recordings of a daemon: every k-th state of a swarm, in its data directory."""

from __future__ import annotations

import base64
import os
import warnings
from pathlib import Path
from typing import Literal

import msgspec

from ._decode import read_reply
from ._errors import IncorrectState, InvalidArgument, invalid
from ._progress import Bar
from ._repr import HtmlStruct
from ._session import Session

RecordingFormat = Literal["mcap", "parquet"]
"""The format of a recording: published messages, or a table."""

RecordingPhase = Literal["recording", "ended", "failed"]
"""The phase of a recording: it is running, and resumes after a restart of the daemon; it has ended,
for `reason`; or it has failed, or lacks files."""


class RecordedAt(HtmlStruct, frozen=True, kw_only=True):
    """The epoch and step of a state in a recording."""

    epoch: int
    step: int


class RecordingGap(HtmlStruct, frozen=True, kw_only=True):
    """States that a recording lost because the daemon ended before their file was complete.

    Attributes:
        after: The state up to which none is missing; None if the recording begins with the gap.
        until: The state at which the recording continues.
        missed: Number of missing states.
    """

    after: RecordedAt | None
    until: RecordedAt
    missed: int


class RecordingStatus(HtmlStruct, frozen=True, kw_only=True):
    """The status of a recording of a daemon; of a deleted one, its last status.

    Attributes:
        recording: Its name, and that of its folder in `recordings` of the daemon's data directory.
        swarm: The name of the recorded swarm.
        format: `mcap`, or `parquet` if an earlier version recorded it.
        every: It has the states whose step is a multiple of this; None is the published states, of
            an earlier version.
        phase: Its phase.
        reason: Why it ended or failed, and which of its files are missing or damaged.
        frames: Number of recorded states.
        missed: Number of missing states: those that were dropped because the disk was too slow,
            and those in `lost`.
        lost: Number of them that were lost because the daemon ended before their file was complete.
        gap: Where the last of these were; None if none was lost.
        lost_parts: Number of finished files that are missing or damaged; `frames`, `parts` and
            `bytes` are those of the others then.
        parts: Number of complete files.
        bytes: Bytes of these files.
        began_unix_secs: Its beginning, seconds since 1970.
        drop_when_behind: Whether it drops states while the disk is too slow; otherwise the swarm
            waits.
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
    lost: int
    gap: RecordingGap | None = None
    lost_parts: int
    parts: int
    bytes: int
    began_unix_secs: int
    drop_when_behind: bool
    max_bytes: int | None = None
    temporary: bool


class RecordingResult(RecordingStatus, frozen=True, kw_only=True):
    """The status of a recording of the daemon `node`."""

    node: str


class Recordings(msgspec.Struct, frozen=True, kw_only=True):
    """The recordings of the daemon `node`, ordered by name."""

    node: str
    recordings: list[RecordingStatus]


class RecordingPiece(msgspec.Struct, frozen=True, kw_only=True):
    """A piece of a complete part of a recording.

    Attributes:
        node: The daemon's name.
        recording: The name of the recording.
        part: The number of the part, from 0.
        parts: Number of complete parts.
        offset: The offset of the piece in the part, bytes.
        length: The length of the part, bytes.
        bytes: The piece, as base64; empty at the end of the part.
    """

    node: str
    recording: str
    part: int
    parts: int
    offset: int
    length: int
    bytes: str


def fetch(
    session: Session,
    node: str,
    status: RecordingStatus,
    path: str | os.PathLike[str],
    show: bool | None,
) -> Path:
    """Fetches the missing parts of an ended recording, and warns if the daemon lacks some."""
    if status.phase == "recording":
        raise IncorrectState(
            f"{status.recording} is running: `stop_recording({status.recording!r})` ends it"
        )
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    fetched = 0
    with Bar(status.recording, show) as bar:
        for part in range(status.parts):
            name = f"part-{part:05}.{status.format}"
            partial = folder / f".{name}.partial"
            selector = (
                f"{session.node_key(node, 'get/recording')}?name={status.recording};part={part}"
            )
            if (folder / name).exists():
                size = (folder / name).stat().st_size
                piece = _piece(session, f"{selector};offset={size}", folder / name)
                if piece.length != size:
                    raise _other(folder / name)
                fetched += size
                continue
            with partial.open("ab") as file:
                while True:
                    offset = file.tell()
                    piece = _piece(session, f"{selector};offset={offset}", partial)
                    content = base64.b64decode(piece.bytes)
                    file.write(content)
                    bar.show((fetched + offset) / status.bytes if status.bytes else 1.0)
                    if not content or offset + len(content) >= piece.length:
                        break
                file.flush()
                os.fsync(file.fileno())
                fetched += file.tell()
            partial.rename(folder / name)
    if status.lost_parts:
        warnings.warn(
            f"{status.recording} is fetched without {status.lost_parts} of its parts, which the "
            f"daemon lacks: {status.reason}",
            RuntimeWarning,
            stacklevel=3,
        )
    return folder


def _piece(session: Session, selector: str, path: Path) -> RecordingPiece:
    """The next piece of a file."""
    try:
        return read_reply(session.get(selector, swarm=None), RecordingPiece)
    except InvalidArgument as error:
        # The file is longer than the part.
        raise _other(path) from error


def _other(path: Path) -> InvalidArgument:
    return invalid("path", f"{path} is part of another recording: choose another folder")
