"""Playbacks: recordings that a daemon plays back as swarms."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any

from ._arguments import check_name
from ._errors import InvalidArgument
from ._progress import Bar
from ._session import Session
from ._wire import ReplayResult

_PIECE_BYTES = 180 * 1024
"""Bytes of a message of an upload; in base64 they are below every daemon's limit."""

_OPEN_TIMEOUT_SECS = 60.0
"""Seconds that a daemon may take to index a long recording."""


def upload(
    session: Session, node: str, path: str | os.PathLike[str], name: str, show: bool | None
) -> None:
    """Uploads a file to the daemon in pieces."""
    path = Path(path)
    if path.suffix == ".parquet":
        raise InvalidArgument(
            f"{path} is Parquet, which is for data frames: record to .mcap to replay it"
        )
    length, offset = path.stat().st_size, 0
    with path.open("rb") as file, Bar(name, show) as bar:
        while True:
            piece = file.read(_PIECE_BYTES)
            args = {
                "name": name,
                "offset": offset,
                "length": length,
                "bytes": base64.b64encode(piece).decode(),
            }
            session.node_command(node, "replay", {"upload": args}, ReplayResult)
            offset += len(piece)
            bar.show(offset / length if length else 1.0)
            if offset >= length or not piece:
                return


def open_replay(
    session: Session, node: str, name: str, recording: str | None, timeout: float | None
) -> None:
    """Opens what was uploaded, or a recording of the daemon."""
    args: dict[str, Any] = {"name": check_name("name", name)}
    if recording is not None:
        args["recording"] = check_name("recording", recording)
    timeout = _OPEN_TIMEOUT_SECS if timeout is None else timeout
    session.node_command(node, "replay", {"open": args}, ReplayResult, timeout)
