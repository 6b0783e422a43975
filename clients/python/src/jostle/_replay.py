"""Recordings that a daemon shows as if they were swarms."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any

import msgspec

from ._arguments import check_name
from ._errors import InvalidArgument
from ._link import Link
from ._messages import Replay
from ._progress import Bar
from ._reading import read_reply
from ._recording import is_unfinished, unfinished

_PIECE_BYTES = 180 * 1024
"""In base64 it passes every daemon's limit."""

_PATIENCE_SECS = 60.0
"""A long recording takes its time to be looked through."""


class ReplayResult(msgspec.Struct, frozen=True, kw_only=True):
    """What a node did about a replay.

    Attributes:
        node: The daemon that told.
        uploaded: Bytes that have come; None once it is shown.
        replay: What is shown, once it is.
    """

    node: str
    uploaded: int | None = None
    replay: Replay | None = None


def check_finished(path: str | os.PathLike[str]) -> None:
    """Raises InvalidArgument, with the remedy, for a recording that has no end."""
    path = Path(path)
    partial = path.with_name(f"{path.name}.partial")
    if not path.exists() and partial.exists():
        path = partial
    if path.suffix == ".partial" or (path.suffix != ".parquet" and is_unfinished(path)):
        raise InvalidArgument(f"{path}: {unfinished(path)}", details={"field": "path"})


def upload(
    link: Link, node: str, path: str | os.PathLike[str], name: str, show: bool | None
) -> None:
    """Sends a file to the daemon, piece by piece."""
    path = Path(path)
    if path.suffix == ".parquet":
        raise InvalidArgument(
            f"{path} is Parquet, which is for data frames: record to .mcap what is to be replayed"
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
            send(link, node, {"upload": args})
            offset += len(piece)
            bar.show(offset / length if length else 1.0)
            if offset >= length or not piece:
                return


def open_replay(
    link: Link, node: str, name: str, recording: str | None, timeout: float | None
) -> None:
    """Has the daemon show what was uploaded, or what it has recorded itself."""
    args: dict[str, Any] = {"name": check_name("name", name)}
    if recording is not None:
        args["recording"] = check_name("recording", recording)
    timeout = _PATIENCE_SECS if timeout is None else timeout
    send(link, node, {"open": args}, timeout)


def send(
    link: Link,
    node: str,
    args: dict[str, Any],
    timeout: float | None = None,
) -> ReplayResult:
    """Sends `replay` to the daemon."""
    key = link.node_key(node, "cmd/replay")
    payload = link.command(key, args, swarm=None, timeout=timeout, request_id=None)
    return read_reply(payload, ReplayResult)
