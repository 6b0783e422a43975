"""Experiments: grids of runs that a daemon executes."""

from __future__ import annotations

import errno
import json
import os
import time
import tomllib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from ._arguments import check_name, check_seconds
from ._cancel import sleep
from ._decode import read_map, read_reply
from ._errors import (
    DeadlineExceeded,
    Faulted,
    IncorrectState,
    Internal,
    JostleError,
    Unavailable,
    invalid,
)
from ._outage import RECONNECT_TIMEOUT_SECS, Outage
from ._progress import Bar
from ._repr import HtmlList, error_html
from ._results import NO_COLUMNS, OrderSeries, SeriesColumns, of_rows, of_series, of_trajectory
from ._session import Session
from ._wire import ExperimentResult, OccasionalColumns, Progress, ResultRow, ResultsPage

if TYPE_CHECKING:
    import pandas

_POLL_INTERVAL_SECS = 0.5

_MAX_BYTES = 250_000_000
"""The largest file that an experiment names."""

EXPERIMENT = "experiment.toml"
"""The name of an experiment's file in a folder of results."""

POINTS = "experiment.points.csv"
"""The name of the CSV of its conditions there."""

SET_POINTS = "experiment.setpoints.csv"
"""The name of the CSV of the set-points of its runs there."""

START = "experiment.start.snapshot"
"""The name of the snapshot from which its runs start there."""

Source = str | os.PathLike[str] | Mapping[str, Any]
"""An experiment: a file, its text, or a mapping of its fields."""


class Experiment:
    """An experiment on a daemon; `experiment` and `Client.submit` make one.

        table = client.submit("order.toml").wait().frame()

    It continues without this object. The daemon never repeats a finished run.
    """

    def __init__(self, session: Session, node: str, name: str) -> None:
        self._session = session
        self._node = node
        self._name = check_name("experiment", name)

    @property
    def name(self) -> str:
        """Its name."""
        return self._name

    def __repr__(self) -> str:
        return f"Experiment({self._name!r} at {self._session.endpoint})"

    def _repr_html_(self) -> str:
        try:
            return self.progress()._repr_html_()
        except JostleError as error:
            return error_html(error)

    def progress(self) -> Progress:
        """Its progress.

        Raises:
            NotFound: There is no such experiment.
        """
        return self._progress(None)

    def wait(self, timeout: float | None = None, *, show: bool | None = None) -> Self:
        """Waits until it is finished, also across a restart of the daemon.

        Args:
            timeout: Seconds; None is no timeout.
            show: Show a progress bar; None shows it on a terminal and in a notebook.

        Raises:
            DeadlineExceeded: Not within `timeout`; it continues.
            IncorrectState: It was cancelled.
            Faulted: It failed. If another version of the model executed its finished runs,
                `details["model_version"]` is that version: `resume` does not continue it.
            Unavailable: The daemon is not reachable for more than a minute.
        """
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        began = time.monotonic()
        lost: float | None = None
        outage = Outage(self._session.endpoint, f"the wait for experiment {self._name!r}")
        with Bar(self._name, show) as bar:
            while True:
                left = None if seconds is None else began + seconds - time.monotonic()
                try:
                    progress = self._progress(left)
                    lost = None
                    outage.end()
                except Unavailable:
                    lost = lost or time.monotonic()
                    is_over = self._session.is_over()
                    if is_over or time.monotonic() - lost > RECONNECT_TIMEOUT_SECS:
                        raise
                    outage.begin()
                else:
                    bar.show(progress.share, progress._summary())
                    if progress.is_over:
                        return self._finished(progress)
                if seconds is not None and time.monotonic() - began >= seconds:
                    raise DeadlineExceeded(
                        f"experiment {self._name!r} continues, unfinished after {seconds} s",
                        details={"after_secs": seconds},
                    )
                sleep(_POLL_INTERVAL_SECS)

    def _finished(self, progress: Progress) -> Self:
        if progress.phase == "finished":
            return self
        kind = IncorrectState if progress.phase == "cancelled" else Faulted
        details: dict[str, Any] = {"phase": progress.phase}
        why = f" ({progress.message})" if progress.message else ""
        remedy = "`resume` continues it"
        if (version := progress.model_version) is not None:
            details["model_version"] = version
            why = ""
            remedy = (
                f"version {version} of the model executed them, and this daemon has another, which "
                "adds none; they remain readable, and `submit` with `again=True` executes all runs "
                "again"
            )
        raise kind(
            f"experiment {self._name!r} {'was ' if kind is IncorrectState else ''}"
            f"{progress.phase}{why}, {progress.finished} of {progress.runs} runs are finished: "
            f"{remedy}",
            details=details,
        )

    def pause(self) -> Progress:
        """Pauses its runs; the next experiment begins."""
        return self._command("pause")

    def resume(self) -> Progress:
        """Resumes it if it is paused, cancelled or failed, or finished and lacks files of runs.

        Raises:
            Conflict: Another version of the model executed its finished runs; the details are as
                those of `Client.submit`.
        """
        return self._command("resume")

    def cancel(self) -> Progress:
        """Cancels it; the results of finished runs are kept."""
        return self._command("cancel")

    def delete(self) -> Progress:
        """Deletes it and its results; returns its last progress.

        Raises:
            IncorrectState: It has not ended: cancel it first.
        """
        return self._command("delete")

    def rows(self) -> list[ResultRow]:
        """The rows of the finished runs, in the order of its plan."""
        return self._table()[0]

    def _table(self) -> tuple[list[ResultRow], OccasionalColumns]:
        """The rows of the finished runs, and the columns that not all experiments have."""
        rows: HtmlList[ResultRow] = HtmlList()
        after = 0
        while True:
            page = read_reply(self._get(f"results?after={after};limit=1000"), ResultsPage)
            rows += page.rows
            if page.next is None:
                return rows, page.columns or NO_COLUMNS
            after = page.next

    def frame(self) -> pandas.DataFrame:
        """The rows as a table of pandas, with the columns of `results.csv`, also before the first.

        If faults ended some runs, the last column is `fault`: the reason, None for the others.

        Raises:
            ImportError: pandas is missing: `pip install jostle[pandas]`.
        """
        rows, columns = self._table()
        return of_rows(rows, columns)

    def order(self, run: str) -> OrderSeries:
        """The order of one run over time, if the experiment measures it.

        Args:
            run: The name of the run, as in `rows`.

        Raises:
            InvalidArgument: The experiment does not measure the order.
            NotFound: There is no such run.
            IncorrectState: The run is not finished.
        """
        pages = [
            [_column(fields, name) for name in ("time", "order", "drift")]
            for fields in self._pages("order", run)
        ]
        # A run without informed individuals has no drift.
        pages = [
            [time, order, drift if drift.size else np.full(time.shape, np.nan)]
            for time, order, drift in pages
        ]
        return OrderSeries(run, *map(np.concatenate, zip(*pages, strict=True)))

    def series(self, run: str | None = None) -> pandas.DataFrame:
        """The measures over time as a table of pandas, if the experiment has `series_every`.

        The columns are `run`, the values that vary in the names of the runs (numbers, or text),
        `step`, `time` (body sizes over free speed), and a column for each measure in its unit, NaN
        where it is undefined. The rows are in the order of the plan and of time.

        Args:
            run: The name of a run, as in `rows`; None is every finished run.

        Raises:
            ImportError: pandas is missing: `pip install jostle[pandas]`.
            InvalidArgument: The experiment does not record measures over time.
            NotFound: There is no such run.
            IncorrectState: The run is not finished.
        """
        if run is not None:
            return of_series([(run, self._series(run))])
        rows, columns = self._table()
        return of_series([(row.run, self._series(row.run)) for row in rows], columns)

    def trajectory(self, run: str) -> pandas.DataFrame:
        """The trajectory of one run as a table of pandas, if the experiment has `record_every`.

        There is a row for each individual at each recorded step. The columns are `run`, the values
        that vary in the name of the run (numbers, or text), `step`, `time` (body sizes over free
        speed), `id`, which an individual keeps, its position `x` and `y` (body sizes), its heading
        `alpha` (radians) and `informed`. `attrs` has the metadata as texts: `spec` and `variables`
        (JSON), `seed`, `units` (JSON) and `version`.

        Args:
            run: The name of the run, as in `rows`.

        Raises:
            ImportError: pandas is missing: `pip install jostle[pandas]`.
            InvalidArgument: The experiment does not record trajectories.
            NotFound: There is no such run.
            IncorrectState: The run is not finished.
        """
        about: dict[str, str] = {}
        table = of_trajectory(run, self._series(run, ";of=individuals", about))
        table.attrs.update(about)
        return table

    def _series(self, run: str, of: str = "", about: dict[str, str] | None = None) -> SeriesColumns:
        """The columns of one run over time, by name; its metadata is added to `about`."""
        parts: dict[str, list[NDArray[np.float64]]] = {}
        for fields in self._pages("series", run, of):
            if about is not None:
                pairs = fields.get("about") or []
                about.update({str(it["key"]): str(it["value"]) for it in pairs})
            columns = {name: _column(fields, name) for name in ("step", "time")}
            for measure in fields.get("measures", []):
                columns[str(measure.get("name"))] = _column(measure, "value")
            for name, values in columns.items():
                parts.setdefault(name, []).append(values)
        return {name: np.concatenate(values) for name, values in parts.items()}

    def _pages(self, noun: str, run: str, of: str = "") -> Iterator[Mapping[str, Any]]:
        """The pages of a run's time series."""
        if ";" in run:
            raise invalid("run", f"invalid name of a run {run!r}: `rows` has the names")
        after: int | None = 0
        while after is not None:
            fields = read_map(self._get(f"{noun}?run={run};after={after}{of}"))
            after = fields.get("next")
            yield fields

    def _command(self, what: Literal["pause", "resume", "cancel", "delete"]) -> Progress:
        args: dict[str, Any] = {what: {"name": self._name}}
        return self._session.node_command(self._node, "experiment", args, ExperimentResult).progress

    def _progress(self, timeout: float | None) -> Progress:
        """Its progress; the request takes at most `timeout` seconds, or the client's."""
        if timeout is not None:
            timeout = min(max(timeout, 0.001), self._session.timeout)
        return read_reply(self._get("progress", timeout), Progress)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        key = self._session.node_key(self._node, f"experiment/{self._name}/{rest}")
        return self._session.get(key, swarm=None, timeout=timeout)


class Files(msgspec.Struct, frozen=True, omit_defaults=True):
    """The contents of an experiment's files, as the daemon takes them."""

    toml: str
    points: str | None = None
    start: bytes | None = None
    setpoints: str | None = None

    def store(self, folder: Path) -> Path:
        """Writes them into a folder, where `jostled run` finds them; returns the TOML's path."""
        for name, contents in self._contents().items():
            if contents is not None:
                (folder / name).write_bytes(contents)
        return folder / EXPERIMENT

    def is_stored(self, folder: Path) -> bool:
        """Whether a folder contains them, and no others."""
        return all(
            _bytes_of(folder / name) == contents for name, contents in self._contents().items()
        )

    def _contents(self) -> dict[str, bytes | None]:
        def encoded(text: str | None) -> bytes | None:
            return None if text is None else text.encode()

        return {
            POINTS: encoded(self.points),
            SET_POINTS: encoded(self.setpoints),
            START: self.start,
            EXPERIMENT: self.toml.encode(),
        }


def read_files(source: Source) -> Files:
    """The contents of an experiment's file and of those that it names.

    Names are relative to the folder of the file, or to the current one if `source` is no file. A
    file outside that folder has a warning.

    Raises:
        InvalidArgument: A field of a mapping has a value that TOML does not have.
        OSError: A file cannot be read.
    """
    toml = to_toml(source)
    try:
        fields = tomllib.loads(toml)
    except tomllib.TOMLDecodeError:
        # The daemon names the line.
        return Files(toml)
    folder, is_copy = Path(), False
    if not isinstance(source, Mapping) and not (isinstance(source, str) and "\n" in source):
        folder, is_copy = Path(source).parent, Path(source).name == EXPERIMENT

    outside: list[str] = []

    def contents(key: str, copy: Path) -> bytes | None:
        named = fields.get(key)
        # A text with line breaks is the set-points themselves.
        if not isinstance(named, str) or "\n" in named:
            return None
        if is_copy and copy.is_file():
            return _read(copy)
        if Path(named).is_absolute() or ".." in Path(named).parts:
            outside.append(f"{key} = {json.dumps(named)}")
        return _read(folder / named)

    def text(key: str, copy: Path) -> str | None:
        found = contents(key, copy)
        # Line breaks stay as they are.
        return None if found is None else found.decode()

    files = Files(
        toml,
        text("points", folder / POINTS),
        contents("start", folder / START),
        text("setpoints", folder / SET_POINTS),
    )
    for named in outside:
        warnings.warn(
            f"{named} is outside the folder of the experiment: its content becomes a part of the "
            "experiment, and another machine may not have it",
            RuntimeWarning,
            stacklevel=3,
        )
    return files


def to_toml(source: Source) -> str:
    """The text of an experiment's file.

    Raises:
        InvalidArgument: A field of a mapping has a value that TOML does not have.
        OSError: The file cannot be read.
    """
    if isinstance(source, Mapping):
        try:
            return _dumps(msgspec.to_builtins(source, str_keys=True, enc_hook=_builtin))
        except (TypeError, ValueError) as error:
            raise invalid(
                "toml",
                f"invalid experiment: {error}: use numbers, texts, booleans, lists and mappings",
            ) from error
    if isinstance(source, str) and "\n" in source:
        return source
    return Path(source).read_text(encoding="utf-8")


def _read(path: Path) -> bytes:
    """The contents of a file that is not too large: a device has no end."""
    with path.open("rb") as file:
        contents = file.read(_MAX_BYTES + 1)
    if len(contents) > _MAX_BYTES:
        raise OSError(errno.EFBIG, "it has more than 250 MB", str(path))
    return contents


def _bytes_of(file: Path) -> bytes | None:
    return file.read_bytes() if file.exists() else None


def _dumps(fields: dict[str, Any]) -> str:
    """The text of a mapping, in which the keys of each `[[at]]` keep their order.

    The commands of a block are executed in that order, and `tomli_w` writes tables last.
    """
    text = tomli_w.dumps(fields)
    blocks = fields.get("at")
    if not isinstance(blocks, list) or not all(isinstance(block, dict) for block in blocks):
        return text
    written = tomllib.loads(text).get("at", [])
    if [list(block) for block in blocks] == [list(block) for block in written]:
        return text
    lines = [tomli_w.dumps({key: value for key, value in fields.items() if key != "at"})]
    for block in blocks:
        lines.append("\n[[at]]\n")
        lines += [f"{_key(key)} = {_inline(value)}\n" for key, value in block.items()]
    return "".join(lines)


def _inline(value: Any) -> str:
    """A value in one line of TOML."""
    if isinstance(value, dict):
        entries = ", ".join(f"{_key(key)} = {_inline(it)}" for key, it in value.items())
        return f"{{ {entries} }}" if entries else "{}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    return tomli_w.dumps({"v": value}).removeprefix("v = ").rstrip("\n")


def _key(key: str) -> str:
    return tomli_w.dumps({key: 0}).removesuffix(" = 0\n")


def _builtin(value: Any) -> Any:
    """A value of another library as one of Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, range):
        return list(value)
    raise TypeError(f"{value!r} has no form in TOML")


def _column(fields: Mapping[str, Any], name: str) -> NDArray[np.float64]:
    column = fields.get(name)
    data = getattr(column, "value", None)
    if not isinstance(data, bytes):
        raise Internal(f"the daemon sent a time series whose {name} is not a column")
    return np.frombuffer(data, "<f8")
