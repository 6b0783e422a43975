"""Recordings of a daemon: every k-th state of a swarm, in its data directory."""

from __future__ import annotations

import base64
import os
import warnings
from pathlib import Path

from ._decode import read_reply
from ._errors import IncorrectState, InvalidArgument, invalid
from ._progress import Bar
from ._session import Session
from ._wire import RecordingPiece, RecordingStatus


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
