"""Reads recordings of `jostle record` and converts them for other tools."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._atomic_file import atomic_file
from ._attachment import read_attachment
from ._checksums import CHECKSUMS, ParquetChecksums, check_mcap, damaged, reading
from ._extras import import_extra
from ._frame import KINDS, OF_EACH, OF_FRAME, OF_GROUP, Columns, columns_of, table_of
from ._state import State, read_state

if TYPE_CHECKING:
    import pandas

# Older builds recorded Parquet without these.
_LATER = (
    *("swarm", "phase", "informed", "drift"),
    *("stepped_unix_secs", "published_unix_secs"),
)

# The numbers that are None in a frame and NaN in a table if they are unknown.
_MAY_BE_UNKNOWN = ("drift", "worst_gap", "stepped_unix_secs", "published_unix_secs")

# The first and last bytes of MCAP.
_MCAP = b"\x89MCAP0\r\n"

# What errors call a file.
_WHAT = "recording"

# The approximate number of rows of MCAP in one table.
_TABLE_ROWS = 64 * 1024


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RecordedFrame:
    """A recorded state of a swarm at one step: n individuals as columns, ordered by id.

    Attributes:
        swarm: The swarm's name.
        epoch: Increases when `step` does not continue the previous frame.
        frame: The number of the state in the recording; if `about["source"]` is `published`, that
            of the published state.
        step: Number of steps since the start.
        time: `step · dt`, body sizes over free speed.
        phase: `paused`, `running` or `faulted`; None in Parquet of older builds.
        id: Shape (n,), uint32.
        x: Shape (n,), body sizes, absolute.
        y: Shape (n,), body sizes, absolute.
        alpha: Shape (n,), headings in radians, counter-clockwise from +x, never wrapped.
        weight: Shape (n,), weights of the preferred directions; 0 for the uninformed.
        direction: Shape (n,), preferred directions in radians; NaN for the uninformed.
        informed: Shape (n,), bool, whether the individual is informed.
        order: The order of the group, 0 to 1.
        drift: The group's velocity along the informed individuals' common direction, free speeds;
            None if there is none, and in Parquet of older builds.
        worst_gap: The smallest gap between two bodies, body sizes; None if no two are near.
        residual: Residual of the step that led here, body sizes.
        contacts: Number of contacts that constrained the step.
        stepped_unix_secs: When the step was taken, by the daemon's clock, seconds since 1970, UTC;
            None if it is not known, as before the first step, and in recordings of older builds.
        published_unix_secs: When the daemon published the state, which a recording by a client
            has; None otherwise, and in recordings of older builds.
    """

    swarm: str
    epoch: int
    frame: int
    step: int
    time: float
    phase: str | None
    id: NDArray[np.uint32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    alpha: NDArray[np.float64]
    weight: NDArray[np.float64]
    direction: NDArray[np.float64]
    informed: NDArray[np.bool_]
    order: float
    drift: float | None
    worst_gap: float | None
    residual: float
    contacts: int
    stepped_unix_secs: float | None
    published_unix_secs: float | None

    @property
    def n(self) -> int:
        """The size of the group."""
        return len(self.id)

    @property
    def position(self) -> NDArray[np.float64]:
        """Absolute positions, shape (n, 2), body sizes; a new array."""
        return np.column_stack((self.x, self.y))


class Recording:
    """A recording; `jostle.read_recording` opens one. Iterating over it yields its frames.

        for frame in jostle.read_recording("school.mcap"):
            print(frame.time, frame.order)

    It is read lazily, so a recording may be larger than memory; each loop begins at the first
    frame.

    Attributes:
        path: The file, or the folder of parts.
        about: Its metadata: `swarm`, `spec` and `parameters` as JSON, `version`, `frames`, and
            `missed`, the number of missing states. If the daemon lost some of them when it ended,
            `gaps` lists as JSON between which states they were. If `source` is `steps`, it has
            every other state whose step is a multiple of `every`; if it is `published`, the
            published states that were received.
    """

    path: Path
    about: Mapping[str, str]

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts = _parts(path)
        about: dict[str, str] = {}
        frames = 0
        for part in self._parts:
            about |= (of_part := _about(part))
            # Each part counts its own; all else is that of the recording up to its end.
            with reading(part, _WHAT):
                frames += int(of_part.get("frames", 0))
        if "frames" in about:
            about["frames"] = str(frames)
        self.about = about

    def __iter__(self) -> Iterator[RecordedFrame]:
        for columns in self._tables():
            yield from _frames(columns)

    def frame(self) -> pandas.DataFrame:
        """A table of all frames, with a row for each individual in each frame.

        Its columns are those of `RecordedFrame`, in their order, as in `jostle.frame` of states;
        unknown numbers are NaN.

        Raises:
            ImportError: pandas is missing: `pip install jostle[recording]`.
        """
        return table_of(list(self._tables()), "recording")

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Writes the table of `frame` as comma-separated text; replaces an existing file.

        Numbers have the shortest form that reads back exactly; unknown values are empty. pandas
        before 3.1 reads them exactly only with `float_precision="round_trip"`.

        Returns:
            The file.
        """
        with _text_file(path) as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(KINDS)
            for columns in self._tables():
                lists = [columns[name].tolist() for name in KINDS]
                for row in zip(*lists, strict=True):
                    # NaN is unknown.
                    rows.writerow(None if it != it else it for it in row)
        return Path(path)

    def to_extxyz(self, path: str | os.PathLike[str]) -> Path:
        """Writes extended XYZ, which ASE and OVITO read; replaces an existing file.

        Each body is an `X` in the plane z = 0 with its `id`, `alpha`, `weight` and `direction`,
        `nan` for the uninformed; the comment of a frame has `Time`, `step`, `epoch`, `frame` and
        `order`. There are no periodic boundaries.

        Returns:
            The file.
        """
        with _text_file(path) as file:
            for frame in self:
                file.write(
                    f"{frame.n}\nProperties=species:S:1:pos:R:3:id:I:1:alpha:R:1:weight:R:1:"
                    f'direction:R:1 pbc="F F F" Time={frame.time!r} step={frame.step} '
                    f"epoch={frame.epoch} frame={frame.frame} order={frame.order!r}\n"
                )
                columns = (frame.x, frame.y, frame.id, frame.alpha, frame.weight, frame.direction)
                for x, y, *others in zip(*(it.tolist() for it in columns), strict=True):
                    file.write(f"X {x!r} {y!r} 0.0 {' '.join(map(repr, others))}\n")
        return Path(path)

    def _tables(self) -> Iterator[Columns]:
        """All rows, in tables of complete frames."""
        for part in self._parts:
            if part.suffix == ".mcap":
                yield from _tables_of_mcap(part)
            else:
                yield from _tables_of_parquet(part, self.about.get("swarm", ""))

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r}, swarm={self.about.get('swarm')!r})"


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Opens a recording of `jostle record` or of a daemon.

        recording = jostle.read_recording("school.parquet")
        for frame in recording:
            print(frame.time, frame.order, frame.x.mean())
        recording.to_extxyz("school.xyz")

    Args:
        path: A file, `.parquet` or `.mcap`, or a folder of parts.

    Raises:
        ImportError: pyarrow (for Parquet) or mcap is missing: `pip install jostle[recording]`.
        InvalidArgument: It is not a recording, or unfinished: the message names
            `jostle record --recover FILE`, which completes it.
        OSError: It cannot be read.
    """
    return Recording(Path(path))


def _parts(path: Path) -> list[Path]:
    """The files of a recording."""
    parts = [path]
    if path.is_dir():
        parts = sorted(it for it in path.glob("part-*") if it.suffix in (".parquet", ".mcap"))
        if not parts:
            raise damaged(path, _WHAT, "the folder has no part of a recording that is complete")
    for part in parts:
        check_finished(part)
        if part.suffix not in (".parquet", ".mcap"):
            raise damaged(part, _WHAT, "its name ends in neither .parquet nor .mcap")
    return parts


def _about(part: Path) -> dict[str, str]:
    """The metadata of a file."""
    if part.suffix == ".mcap":
        reader = import_extra("mcap.reader", "recording")
        with part.open("rb") as file, reading(part, _WHAT):
            # All bytes: only the checksum of the data is over the metadata.
            check_mcap(file)
            file.seek(0)
            records = [
                it
                for it in reader.make_reader(file, validate_crcs=True).iter_metadata()
                if it.name == "jostle"
            ]
            if not records:
                raise ValueError("it has no swarm")
            return {key: value for record in records for key, value in record.metadata.items()}
    parquet = import_extra("pyarrow.parquet", "recording")
    with part.open("rb") as file, reading(part, _WHAT):
        ParquetChecksums(file, "recording")
        table = parquet.ParquetFile(file)
        known = (*table.schema_arrow.names, *_LATER)
        if missing := [name for name in KINDS if name not in known]:
            raise ValueError(f"it has no column {missing[0]!r}")
        pairs = table.metadata.metadata or {}
        about = {key.decode(): value.decode() for key, value in pairs.items()}
        about.pop(CHECKSUMS, None)
        return about


def _tables_of_parquet(part: Path, swarm: str) -> Iterator[Columns]:
    """The row groups of a file; each has complete frames."""
    parquet = import_extra("pyarrow.parquet", "recording")
    with part.open("rb") as file:
        with reading(part, _WHAT):
            checksums = ParquetChecksums(file, "recording")
            reader = parquet.ParquetFile(file)
        present = [name for name in KINDS if name in reader.schema_arrow.names]
        for index in range(reader.num_row_groups):
            with reading(part, _WHAT):
                checksums.check_group(index)
                group = reader.read_row_group(index, columns=present)
                columns = {
                    name: np.asarray(group.column(name).to_numpy(), KINDS[name]) for name in present
                }
                yield _completed(columns, swarm)


def _completed(columns: Columns, swarm: str) -> Columns:
    """Adds the columns that older builds did not record, as far as they are known."""
    informed = columns["weight"] > 0
    rows = len(informed)
    unknown = np.full(rows, np.nan)
    return {
        "swarm": np.full(rows, swarm, object),
        "phase": np.full(rows, None, object),
        "informed": informed,
        **dict.fromkeys(["drift", "stepped_unix_secs", "published_unix_secs"], unknown),
        **columns,
        # Older builds have 0 for the uninformed.
        "direction": np.where(informed, columns["direction"], np.nan),
    }


def _tables_of_mcap(part: Path) -> Iterator[Columns]:
    """The states of a file, in tables of about `_TABLE_ROWS` rows."""
    reader = import_extra("mcap.reader", "recording")
    states: list[State] = []
    with part.open("rb") as file:
        messages = reader.make_reader(file, validate_crcs=True).iter_messages(
            topics=["attachment", "state"], log_time_order=False
        )
        # What is attached to a state precedes it.
        attached = None
        while True:
            with reading(part, _WHAT):
                _, channel, message = next(messages, (None, None, None))
                if channel is not None and channel.topic == "attachment":
                    attached = message
                    continue
                if message is not None:
                    states.append(_with_attachment(read_state(message.data), message, attached))
                    attached = None
            is_enough = sum(state.n for state in states[-1:]) * len(states) >= _TABLE_ROWS
            if states and (message is None or is_enough):
                yield columns_of(states)
                states = []
            if message is None:
                return


def _with_attachment(state: State, message: Any, attached: Any | None) -> State:
    """A state with the message that was attached to it, unless that is of a state that was lost."""
    if attached is None or attached.sequence != message.sequence:
        return state
    if attached.log_time != message.log_time:
        return state
    return replace(state, attachment=read_attachment(attached.data))


def _frames(columns: Columns) -> Iterator[RecordedFrame]:
    """Splits rows into frames."""
    epoch, number = columns["epoch"], columns["frame"]
    changes = np.flatnonzero((np.diff(epoch) != 0) | (np.diff(number) != 0)) + 1
    bounds = [0, *changes.tolist(), len(epoch)] if len(epoch) else [0]
    for first, end in itertools.pairwise(bounds):
        names = (*OF_FRAME, *OF_GROUP)
        one = {name: columns[name][first : first + 1].tolist()[0] for name in names}
        each = {name: columns[name][first:end] for name in OF_EACH}
        unknown = {name: None for name in _MAY_BE_UNKNOWN if np.isnan(one[name])}
        yield RecordedFrame(**{**one, **each, **unknown})


@contextlib.contextmanager
def _text_file(path: str | os.PathLike[str]) -> Iterator[IO[str]]:
    """An atomic file of text."""
    with atomic_file(path) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="\n")
        yield text
        # Flushes it, and leaves the file open.
        text.detach()


def check_finished(path: Path) -> None:
    """Raises an error, with the remedy, if the recorder of a file was killed or is running.

    Raises:
        FileNotFoundError: There is no such file.
        InvalidArgument: It is incomplete.
    """
    if not path.exists() and path.suffix != ".partial":
        partial = path.with_name(f"{path.name}.partial")
        if not partial.exists():
            raise FileNotFoundError(errno.ENOENT, "there is no such recording", str(path))
        path = partial
    if path.suffix == ".partial" or (path.suffix != ".parquet" and _has_no_end(path)):
        raise damaged(
            path,
            _WHAT,
            "it is incomplete: its recorder was killed or is still running; if it was killed, "
            f"`jostle record --recover {path}` recovers it",
        )


def _has_no_end(path: Path) -> bool:
    """Whether a file is MCAP without an end."""
    with path.open("rb") as file:
        first = file.read(len(_MCAP))
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - len(_MCAP)))
        return first == _MCAP != file.read()
