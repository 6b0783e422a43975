"""How the files of a finished part get from the worker of its task to the caller of `sweep`.

A part may be larger than any memory, so a task returns at most `MAX_RETURNED` bytes of files. It
moves larger ones into the caller's folder of parts if the worker sees that folder, and otherwise
keeps them on the disk of a Dask worker, from which the caller reads them in pieces. An executor
that is neither has no other way back than the result.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import sys
import tarfile
import tempfile
import uuid
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from ._atomic_file import sync_folder
from ._errors import Conflict, Faulted, StorageFull
from ._experiment import EXPERIMENT, POINTS, SET_POINTS, START

RUNS = "runs.jsonl"
"""The name of the list of finished runs."""

TRAJECTORIES = "trajectories"
"""The folder of the trajectories, which the lists of earlier versions do not name."""

LOCK = "sweep.lock"
"""The name of the file in the folder of parts that a sweep locks; it contains the sweep's token."""

PIECE = 4 << 20
"""Bytes that are read from a Dask worker at once; they are in the memory of the scheduler, too."""

MAX_RETURNED = 64 << 20
"""Bytes of files that a task returns; on Dask, whose client reads pieces, at most `PIECE`."""

# The files that every part has. Its tables are left out: merging writes them.
_FILES = (EXPERIMENT, RUNS)
# Those that only some experiments have.
_OPTIONAL_FILES = (POINTS, SET_POINTS, START)


class Target(msgspec.Struct, frozen=True):
    """Where the caller of `sweep` stores parts.

    Attributes:
        folder: The absolute path of the folder of parts, on the caller's machine.
        token: The content of its file `LOCK`.
        reads_workers: Whether the caller can read files of the worker: it has a client of Dask.
    """

    folder: str
    token: str
    reads_workers: bool = False

    def is_here(self) -> bool:
        """Whether this process can write into the folder, and the sweep goes on."""
        try:
            is_same = Path(self.folder, LOCK).read_text() == self.token
        except (OSError, UnicodeDecodeError):
            return False
        return is_same and os.access(self.folder, os.W_OK)


class TooLarge(Exception):
    """The files of a part are larger than what a task may return."""


class Lost(Exception):
    """The files of a part are gone, with the worker that kept them."""


class Returned:
    """The files of a part as a compressed tar archive."""

    def __init__(self, archive: bytes) -> None:
        self.archive = archive


class Stored:
    """A part whose files are in a hidden folder among the caller's parts."""

    def __init__(self, name: str) -> None:
        self.name = name


class Kept:
    """A part whose files are on the disk of a Dask worker.

    They are there as long as this object is: Dask keeps it until the caller forgets the task, or
    is gone. A copy, which the caller gets, owns no files.
    """

    def __init__(
        self,
        worker: str,
        part: str,
        lengths: dict[str, int],
        owned: tempfile.TemporaryDirectory[str] | None = None,
    ) -> None:
        self.worker = worker
        self.part = part
        self.lengths = lengths
        self._owned = owned

    def __reduce__(self) -> tuple[type[Kept], tuple[str, str, dict[str, int]]]:
        return Kept, (self.worker, self.part, self.lengths)


class _Line(msgspec.Struct, frozen=True):
    """A finished run: any line of the list but the first.

    `files` are the bytes of each of its files by the path in the folder; None in lines of earlier
    versions.
    """

    files: dict[str, int] | None = None
    row: msgspec.Raw = msgspec.Raw(b"null")


def dask_worker() -> Any | None:
    """The Dask worker that executes the task of this thread; None if there is none."""
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return None
    try:
        return distributed.get_worker()
    except ValueError:
        return None


def deliver(
    part: Path, target: Target, worker: Any | None, owned: tempfile.TemporaryDirectory[str]
) -> Returned | Stored | Kept:
    """Delivers the files of a part to the caller of `sweep`.

    Args:
        part: The folder of the part.
        target: Where the caller stores parts.
        worker: The Dask worker whose files the caller can read, if any.
        owned: The temporary folder that contains `part`. The caller of this function must not
            remove it if the result is `Kept`.

    Raises:
        TooLarge: There is no way to deliver as many bytes.
        StorageFull: The caller's disk is full.
        OSError: A file cannot be read or written.
    """
    lengths = _lengths(part)
    if target.is_here():
        return Stored(_store(part, lengths, Path(target.folder)))
    size = sum(lengths.values())
    if size <= (MAX_RETURNED if worker is None else PIECE):
        archive = io.BytesIO()
        with tarfile.open(fileobj=archive, mode="w:gz", compresslevel=1) as tar:
            for name in lengths:
                tar.add(part / name, arcname=name)
        return Returned(archive.getvalue())
    if worker is not None:
        return Kept(worker.address, str(part), lengths, owned)
    raise TooLarge(
        f"the files have {size} bytes, and a task returns at most {MAX_RETURNED}: use a `folder` "
        "on a disk that the workers share, at the same path, or a client of Dask"
    )


def _lengths(part: Path) -> dict[str, int]:
    """The files of a part that the caller needs: their lengths by their path in its folder."""
    names = [name for name in _OPTIONAL_FILES if (part / name).exists()]
    names += [
        str(path.relative_to(part)) for path in sorted(part.glob(f"{TRAJECTORIES}/*.parquet"))
    ]
    lengths = {name: (part / name).stat().st_size for name in (*_FILES, *names)}
    for line in _lines(part):
        lengths.update(line.files or {})
    return lengths


def _lines(part: Path) -> Iterator[_Line]:
    with (part / RUNS).open("rb") as lines:
        # The first line is the header.
        next(lines, None)
        for line in lines:
            yield msgspec.json.decode(line, type=_Line)


def _store(part: Path, lengths: dict[str, int], folder: Path) -> str:
    """Moves the files into a new hidden folder of the caller, and returns its name."""
    # Another worker may execute the same task.
    draft = folder / f".runs-{uuid.uuid4().hex}"
    try:
        draft.mkdir()
        for name in lengths:
            _move(part / name, draft / name)
    except BaseException as error:
        shutil.rmtree(draft, ignore_errors=True)
        raise_full(folder, error)
        raise
    return draft.name


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(exist_ok=True)
    try:
        # `jostled` has made the files durable.
        source.rename(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with source.open("rb") as original:
            _write(target, iter(partial(original.read, PIECE), b""))


def _write(target: Path, pieces: Iterator[bytes]) -> None:
    """Writes a durable file."""
    target.parent.mkdir(exist_ok=True)
    with target.open("xb") as file:
        for piece in pieces:
            file.write(piece)
        file.flush()
        os.fsync(file.fileno())


def raise_full(folder: Path, error: BaseException) -> None:
    """Raises StorageFull if `error` is that of a full disk with the caller's folder of parts."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        raise StorageFull(
            f"failed to write a part to {folder}: {error}; free disk space, and call `sweep` again "
            "with the same folder"
        ) from error


def receive(
    result: object, folder: Path, draft: Path, runs: str, read: Callable[[str, str, int], bytes]
) -> Path:
    """Writes the files of a result of a task, or finds them. They are durable on return.

    Args:
        result: The result.
        folder: The folder of parts.
        draft: A hidden folder in it, which does not exist.
        runs: The numbers of the runs of the task.
        read: Reads a piece of a file of a Dask worker: see `Tasks.read`.

    Returns:
        The folder with the files, `draft` or another hidden one.

    Raises:
        Conflict: The worker has another version of jostle.
        Lost: The files are gone.
        OSError: A file cannot be written.
    """
    if isinstance(result, Stored):
        draft = folder / result.name
    else:
        draft.mkdir()
        if isinstance(result, Returned):
            _unpack(result.archive, draft)
        elif isinstance(result, Kept):
            for name, length in result.lengths.items():
                path = str(Path(result.part, name))
                _write(draft / name, _pieces(result.worker, path, length, read))
    for name in _FILES:
        if not (draft / name).exists():
            raise Conflict(
                f"the result of runs {runs} has no {name}: install the same version of jostle on "
                "all workers"
            )
    for inner in (*(path for path in draft.iterdir() if path.is_dir()), draft):
        sync_folder(inner)
    return draft


def _pieces(
    worker: str, path: str, length: int, read: Callable[[str, str, int], bytes]
) -> Iterator[bytes]:
    offset = 0
    while offset < length:
        piece = read(worker, path, offset)
        if not piece:
            raise Lost(f"{path} on {worker} has {offset} bytes instead of {length}")
        offset += len(piece)
        yield piece


def read_piece(path: str, offset: int) -> bytes:
    """Reads a piece of a file, on a Dask worker."""
    with Path(path).open("rb") as file:
        file.seek(offset)
        return file.read(PIECE)


def _unpack(archive: bytes, folder: Path) -> None:
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        for member in tar:
            source = tar.extractfile(member)
            if source is not None:
                _write(folder / member.name, iter(partial(source.read, PIECE), b""))


def check(part: Path, runs: str) -> None:
    """Checks the files of a received part.

    Raises:
        Faulted: A file is missing, or has another length than the list of runs says.
    """
    lack = missing(part, records=False)
    if lack is not None:
        raise Faulted(f"runs {runs}: {lack}", details={"runs": runs})


def missing(part: Path, records: bool) -> str | None:
    """What a part lacks of the files of its runs; None if it is complete.

    Args:
        part: The folder of the part.
        records: Whether the experiment has trajectories.
    """
    unnamed = 0
    for line in _lines(part):
        if line.files is None:
            unnamed += bytes(line.row) != b"null"
        for name, length in (line.files or {}).items():
            with contextlib.suppress(FileNotFoundError):
                found = (part / name).stat().st_size
                if found == length:
                    continue
                return f"{name} has {found} bytes instead of {length}"
            return f"there is no {name}"
    if records and len(list(part.glob(f"{TRAJECTORIES}/*.parquet"))) < unnamed:
        # Sweeps of earlier versions did not receive them.
        return f"{TRAJECTORIES} is incomplete"
    return None
