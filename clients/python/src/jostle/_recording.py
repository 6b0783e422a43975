"""Recordings: what a swarm published, as `jostle record` wrote it, for other people's tools."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._errors import Internal, InvalidArgument
from ._extras import need
from ._state import ORIGIN_UNIT, State, read_state

if TYPE_CHECKING:
    import pandas

_Columns = dict[str, NDArray[Any]]

# The columns of a recording, in their order; those of a frame first, then those of its members.
_OF_FRAME = {"epoch": np.int64, "frame": np.int64, "step": np.int64, "time": np.float64}
_OF_EACH = {
    "id": np.uint32,
    **dict.fromkeys(["x", "y", "alpha", "weight", "direction"], np.float64),
}
_OF_GROUP = {"order": float, "worst_gap": float, "residual": float, "contacts": np.int64}
_KINDS: dict[str, type[Any]] = {**_OF_FRAME, **_OF_EACH, **_OF_GROUP}

# Rows of MCAP that are put together to one table, about.
_ROWS = 64 * 1024


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RecordedFrame:
    """A swarm at one step, as it was recorded: n individuals as columns, ordered by id.

    Attributes:
        epoch: Grows whenever `step` does not continue what was before.
        frame: The number of the published state.
        step: The number of steps since the start.
        time: `step · dt`.
        id: Shape (n,), uint32.
        x: Shape (n,), body sizes, absolute.
        y: Shape (n,), body sizes, absolute.
        alpha: Shape (n,), headings in radians, counter-clockwise from +x, never wrapped.
        weight: Shape (n,), of the preferred directions; 0 for the uninformed.
        direction: Shape (n,), preferred directions in radians; 0 for the uninformed.
        order: The polar order parameter of the group.
        worst_gap: The smallest gap between two bodies; None if no two are near.
        residual: Of the step that led here.
        contacts: How many constrained it.
    """

    epoch: int
    frame: int
    step: int
    time: float
    id: NDArray[np.uint32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    alpha: NDArray[np.float64]
    weight: NDArray[np.float64]
    direction: NDArray[np.float64]
    order: float
    worst_gap: float | None
    residual: float
    contacts: int

    @property
    def n(self) -> int:
        """The size of the group."""
        return len(self.id)

    @property
    def position(self) -> NDArray[np.float64]:
        """Absolute positions, shape (n, 2), body sizes; a new array."""
        return np.column_stack((self.x, self.y))


class Recording:
    """A recording; `jostle.read_recording` opens one. Iterating it yields each frame in turn.

    It is read as it is asked for, so a recording may be longer than memory; each loop begins anew.

    Attributes:
        path: The file, or the folder of parts.
        about: What it says of itself: `swarm`, `spec` and `parameters` as JSON, `version`,
            `frames`, and `missed`, the number of states that were published and are not in it.
    """

    path: Path
    about: Mapping[str, str]

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts = _parts(path)
        about: dict[str, str] = {}
        for part in self._parts:
            about |= _about(part)
        self.about = about

    def __iter__(self) -> Iterator[RecordedFrame]:
        for columns in self._tables():
            yield from _frames(columns)

    def frame(self) -> pandas.DataFrame:
        """A table of all of it, with a row for each individual in each frame.

        Its columns are those of `RecordedFrame`, in their order; `worst_gap` is NaN where it is
        not known.

        Raises:
            ImportError: pandas is missing; `pip install jostle[recording]` brings it.
        """
        pd = need("pandas", "recording")
        tables = [*self._tables(), {name: np.empty(0, kind) for name, kind in _KINDS.items()}]
        columns = {name: np.concatenate([it[name] for it in tables]) for name in _KINDS}
        table: pandas.DataFrame = pd.DataFrame(columns)
        return table

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Writes the same table as comma-separated text, replacing what is there.

        Numbers are in the shortest form that reads back to the bit; what is not known is empty.
        pandas before 3.1 reads them exactly only with `float_precision="round_trip"`.

        Returns:
            The file.
        """
        with _draft(path) as file:
            file.write(",".join(_KINDS) + "\n")
            for columns in self._tables():
                lists = [columns[name].tolist() for name in _KINDS]
                for row in zip(*lists, strict=True):
                    # Not a number is what is not known.
                    file.write(",".join("" if it != it else repr(it) for it in row) + "\n")
        return Path(path)

    def to_extxyz(self, path: str | os.PathLike[str]) -> Path:
        """Writes extended XYZ, as ASE and OVITO read it, replacing what is there.

        A frame after another, each body an `X` in the plane z = 0 with its `id`, `alpha`, `weight`
        and `direction`; `Time`, `step`, `epoch`, `frame` and `order` stand in the comment. Nothing
        is periodic.

        Returns:
            The file.
        """
        with _draft(path) as file:
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

    def _tables(self) -> Iterator[_Columns]:
        """All rows, some whole frames at a time."""
        for part in self._parts:
            yield from _tables_of_mcap(part) if part.suffix == ".mcap" else _tables_of_parquet(part)

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r}, swarm={self.about.get('swarm')!r})"


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Opens a recording that `jostle record` wrote.

        recording = jostle.read_recording("school.parquet")
        for frame in recording:
            print(frame.time, frame.order, frame.x.mean())
        recording.to_extxyz("school.xyz")

    Args:
        path: A file, `.parquet` or `.mcap`, or a folder of parts.

    Raises:
        ImportError: Of Parquet pyarrow and of MCAP mcap is missing; `pip install
            jostle[recording]` brings both.
        InvalidArgument: It is no recording, or one that was never ended.
        OSError: It cannot be read.
    """
    return Recording(Path(path))


def _parts(path: Path) -> list[Path]:
    """The files a recording consists of."""
    if path.is_dir():
        parts = sorted(it for it in path.glob("part-*") if it.suffix in (".parquet", ".mcap"))
        if not parts:
            raise _wrong(path, "the folder has no part of a recording that is whole")
        return parts
    if path.suffix == ".partial":
        raise _wrong(path, "this recording was never ended")
    if path.suffix not in (".parquet", ".mcap") and path.exists():
        raise _wrong(path, "its name ends in neither .parquet nor .mcap")
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, "there is no such recording", str(path))
    return [path]


def _about(part: Path) -> dict[str, str]:
    """What a file says of itself."""
    if part.suffix == ".mcap":
        reader = need("mcap.reader", "recording")
        with part.open("rb") as file, _whole(part):
            records = [
                it
                for it in reader.make_reader(file, validate_crcs=True).iter_metadata()
                if it.name == "jostle"
            ]
            if not records:
                raise ValueError("it holds no swarm")
            return {key: value for record in records for key, value in record.metadata.items()}
    parquet = need("pyarrow.parquet", "recording")
    with part.open("rb") as file, _whole(part):
        table = parquet.ParquetFile(file)
        if missing := [name for name in _KINDS if name not in table.schema_arrow.names]:
            raise ValueError(f"it has no column {missing[0]!r}")
        pairs = table.metadata.metadata or {}
        return {key.decode(): value.decode() for key, value in pairs.items()}


def _tables_of_parquet(part: Path) -> Iterator[_Columns]:
    """The groups of rows of a file; each holds whole frames."""
    parquet = need("pyarrow.parquet", "recording")
    with part.open("rb") as file:
        reader = parquet.ParquetFile(file)
        for index in range(reader.num_row_groups):
            with _whole(part):
                group = reader.read_row_group(index, columns=list(_KINDS))
                yield {
                    name: np.asarray(group.column(name).to_numpy(), kind)
                    for name, kind in _KINDS.items()
                }


def _tables_of_mcap(part: Path) -> Iterator[_Columns]:
    """The states of a file, some at a time."""
    reader = need("mcap.reader", "recording")
    states: list[State] = []
    with part.open("rb") as file:
        messages = reader.make_reader(file, validate_crcs=True).iter_messages(
            topics=["state"], log_time_order=False
        )
        while True:
            with _whole(part):
                _, _, message = next(messages, (None, None, None))
                if message is not None:
                    states.append(read_state(message.data))
            is_enough = sum(state.n for state in states[-1:]) * len(states) >= _ROWS
            if states and (message is None or is_enough):
                yield _columns(states)
                states = []
            if message is None:
                return


def _columns(states: list[State]) -> _Columns:
    """The rows of states, as Parquet holds them."""
    counts = [state.n for state in states]
    origins = [state.origin for state in states]
    single = {
        **{name: [getattr(state, name) for state in states] for name in _OF_FRAME},
        "order": [state.order.order for state in states],
        "worst_gap": [
            np.nan if state.certificate.worst_gap is None else state.certificate.worst_gap
            for state in states
        ],
        "residual": [state.certificate.residual for state in states],
        "contacts": [state.certificate.contacts for state in states],
    }
    columns = {
        name: np.repeat(np.array(values, _KINDS[name]), counts) for name, values in single.items()
    }
    for name in _OF_EACH:
        columns[name] = np.concatenate([getattr(state, name) for state in states])
    for axis, name in enumerate(("x", "y")):
        columns[name] += np.repeat([ORIGIN_UNIT * origin[axis] for origin in origins], counts)
    return columns


def _frames(columns: _Columns) -> Iterator[RecordedFrame]:
    """Takes rows apart where the frame changes."""
    epoch, number = columns["epoch"], columns["frame"]
    changes = np.flatnonzero((np.diff(epoch) != 0) | (np.diff(number) != 0)) + 1
    bounds = [0, *changes.tolist(), len(epoch)] if len(epoch) else [0]
    for first, end in itertools.pairwise(bounds):
        one = {name: columns[name][first].item() for name in (*_OF_FRAME, *_OF_GROUP)}
        each = {name: columns[name][first:end] for name in _OF_EACH}
        gap = one["worst_gap"]
        yield RecordedFrame(**{**one, **each, "worst_gap": None if np.isnan(gap) else gap})


@contextlib.contextmanager
def _draft(path: str | os.PathLike[str]) -> Iterator[IO[str]]:
    """A file that gets its name when all of it is written."""
    path = Path(path)
    draft = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with draft.open("x", encoding="utf-8", newline="\n") as file:
            yield file
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


@contextlib.contextmanager
def _whole(part: Path) -> Iterator[None]:
    """Says of which file it is that a reader could not read it."""
    try:
        yield
    except (OSError, ImportError, InvalidArgument):
        raise
    except Exception as error:
        # Each reader has a tree of errors of its own.
        if isinstance(error, ValueError | Internal) or type(error).__module__.startswith("mcap"):
            raise _wrong(part, str(error)) from error
        raise


def _wrong(path: Path, problem: str) -> InvalidArgument:
    return InvalidArgument(
        f"{path}: this is no whole recording: {problem}", details={"field": "path"}
    )
