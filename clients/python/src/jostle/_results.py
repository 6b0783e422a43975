"""Replies of a daemon about experiments, as msgspec structs."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from ._extras import import_extra
from ._repr import HtmlStruct, bar_html

if TYPE_CHECKING:
    import pandas

ExperimentPhase = Literal["queued", "running", "paused", "finished", "cancelled", "failed"]
"""The phase of an experiment."""


class RunUnderWay(msgspec.Struct, frozen=True, kw_only=True):
    """A run that is being executed.

    Attributes:
        run: Its name.
        share: The finished share of its steps, 0 to 1.
    """

    run: str
    share: float


class Progress(msgspec.Struct, frozen=True, kw_only=True):
    """The progress of an experiment.

    Attributes:
        name: The experiment's name.
        phase: Its phase.
        runs: Number of runs.
        finished: Number of finished runs.
        faulted: Number of finished runs that ended early.
        share: The finished share of the work, 0 to 1, with that of the present runs.
        elapsed_secs: Seconds that it has run, without pauses.
        left_secs: Seconds that it will still take; None while there is no estimate.
        running: The runs that are being executed.
        message: Why it failed or the daemon paused it, or a remark on its runs.
    """

    name: str
    phase: ExperimentPhase
    runs: int
    finished: int
    faulted: int
    share: float
    elapsed_secs: float
    left_secs: float | None = None
    running: list[RunUnderWay]
    message: str | None = None

    def _summary(self) -> str:
        """The same as a text, without the share."""
        left = "" if self.left_secs is None or self.is_over else f", {self.left_secs:.0f} s left"
        faulted = f", {self.faulted} faulted" if self.faulted else ""
        why = f": {self.message}" if self.message else ""
        return f"{self.phase}, {self.finished} of {self.runs} runs{faulted}{left}{why}"

    def _repr_html_(self) -> str:
        return bar_html(self.share, f"{self.name} {100 * self.share:z.0f} %, {self._summary()}")

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self.phase in ("finished", "cancelled", "failed")


class RunCommand(msgspec.Struct, frozen=True, kw_only=True):
    """A command of a run.

    Attributes:
        at_step: The step before which it is executed; None if it is executed at once.
        verb: `batch` or `when`.
        args: The arguments of the verb.
    """

    at_step: int | None
    verb: str
    args: Any


class ExpandedRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run as the swarm and the commands that have its states.

    Attributes:
        run: Its name.
        spec: The spec of the swarm, with the seed of the run.
        snapshot: The snapshot from which the swarm is restored, in base64; None if it is created
            from its spec.
        steps: The number of its steps, at most.
        commands: The commands to send, in this order.
        stop: The condition that ends the run and pauses the swarm.
    """

    run: str
    spec: dict[str, Any]
    steps: int
    commands: list[RunCommand]
    stop: str | None
    snapshot: str | None = None


class ExperimentResult(msgspec.Struct, frozen=True, kw_only=True):
    """The reply to a command about an experiment.

    Attributes:
        node: The daemon's name.
        created: Whether the command created it.
        progress: Its progress.
        expanded: The run that was requested.
    """

    node: str
    created: bool
    progress: Progress
    expanded: ExpandedRun | None = None


class Experiments(msgspec.Struct, frozen=True, kw_only=True):
    """The experiments of the daemon `node`, in the order of submission."""

    node: str
    experiments: list[Progress]


class ExtraValue(msgspec.Struct, frozen=True, kw_only=True):
    """The value of a column that only some experiments have.

    Attributes:
        name: The column: a variable of the grid, `stopped_at`, or a measure such as `msd(5)`.
        value: `stopped_at` in time units, a measure in its unit; None if it is undefined.
    """

    name: str
    value: float | None = None


class ResultRow(HtmlStruct, frozen=True, kw_only=True):
    """The result of one run of an experiment: a row of the table of results.

    Lengths are in body sizes, speeds in free speeds, times in body sizes over free speed.

    Attributes:
        run: The run's name within its experiment: the varied parameters, then the replicate.
        seed: The seed of all random draws.
        n: Number of individuals.
        pi1: Length over width of a body.
        pi2: Weight of the informed individuals' own preference.
        pi3: Body size over turning radius.
        pi4: Translational over rotational drag.
        informed: Number of informed individuals.
        contacts: The contact rule: "endpoints", "closest" or "clamped".
        dt: The time step.
        time: Duration of the run; less than that of the experiment if the run faulted.
        v: Time mean of the centroid's speed, eq. (8).
        v_pd: Mean drift along the informed individuals' direction; None without informed ones.
        ordered_intervals: Number of intervals with an order of at least 2/3, including those that
            the run's ends cut.
        ordered_time: Total time of the ordered intervals.
        unordered_intervals: Number of intervals with an order below 2/3, including those that the
            run's ends cut.
        unordered_time: Total time of the unordered intervals.
        worst_overlap: The deepest overlap of any two bodies, 0 or more.
        crossed_share: The share of time in which any two axes crossed.
        worst_residual: The largest residual of any step.
        degraded: Number of degraded steps: less accurate than the target, but acceptable.
        fallbacks: Number of steps that the fallback solved because the exact solver missed its
            target.
        steps: Number of steps.
        state_hash: The hash of the last state, BLAKE3 in hexadecimal.
        fault: Why the run ended early, if a fault ended it; else None. The other values are then
            those of the time before the fault.
        extra: The columns that only some experiments have: variables of the grid, `stopped_at`, and
            the means of chosen measures; None without such a column.
    """

    run: str
    seed: int
    n: int
    pi1: float
    pi2: float
    pi3: float
    pi4: float
    informed: int
    contacts: str
    dt: float
    time: float
    v: float
    v_pd: float | None = None
    ordered_intervals: int
    ordered_time: float
    unordered_intervals: int
    unordered_time: float
    worst_overlap: float
    crossed_share: float
    worst_residual: float
    degraded: int
    fallbacks: int
    steps: int
    state_hash: str
    fault: str | None = None
    extra: list[ExtraValue] | None = None


class OccasionalColumns(msgspec.Struct, frozen=True, kw_only=True):
    """The columns that only the tables of some experiments have, in their order.

    Attributes:
        varied: The values that vary in the names of the runs.
        extra: Those of the table of results: variables, `stopped_at`, and means of measures.
        series: The measures over time.
    """

    varied: list[str]
    extra: list[str]
    series: list[str]


NO_COLUMNS = OccasionalColumns(varied=[], extra=[], series=[])
"""Those of a daemon of an earlier version, which does not name them."""


_AXES = {
    "informed_fraction": float,
    "stepping": str,
    "relinearise": float,
    "attraction": str,
    "noise": float,
}
"""Axes of a grid that are no fields of a row: their values are in the names of the runs."""


def of_rows(rows: Sequence[ResultRow], columns: OccasionalColumns = NO_COLUMNS) -> pandas.DataFrame:
    """Rows as a table of pandas; `fault` is the last column, if a run has one, and None for others.

    `columns` are those that only some experiments have: the table has them even if no row does.

    Raises:
        ImportError: pandas is missing; `pip install jostle[pandas]` installs it.
    """
    pd = import_extra("pandas", "pandas")
    *fixed, _, _ = ResultRow.__struct_fields__
    table: pandas.DataFrame = pd.DataFrame(
        [msgspec.structs.astuple(row)[:-2] for row in rows], columns=fixed
    )
    if not rows:
        # Without values pandas would make columns of objects.
        kinds = {float: "float64", int: "int64"}
        fields = {it.name: kinds.get(it.type) for it in msgspec.structs.fields(ResultRow)}
        table = table.astype({name: kind for name, kind in fields.items() if kind is not None})
    # Daemons of earlier versions accepted a variable with the name of the last column.
    values = [
        {"fault_" if it.name == "fault" else it.name: it.value for it in row.extra or []}
        for row in rows
    ]
    named_by_run = [dict(_values(row.run)) for row in rows]
    varied = {*columns.varied, *(name for named in named_by_run for name in named)}
    for name, kind in _AXES.items():
        if name in varied:
            texts = [named.get(name) for named in named_by_run]
            table[name] = [None if text is None else kind(text) for text in texts]
    extra = dict.fromkeys([*columns.extra, *(name for named in values for name in named)])
    for name in (it for it in extra if it not in _AXES):
        table[name] = [named.get(name) for named in values]
    # If every value is None, pandas would make a column of objects.
    numbers = [it for it in ("v_pd", *_AXES, *extra) if it in table and _AXES.get(it) is not str]
    table = table.astype(dict.fromkeys(numbers, "float64"))
    faults = [row.fault for row in rows]
    if any(fault is not None for fault in faults):
        table["fault"] = pd.Series(faults, dtype=object)
    return table


SeriesColumns = dict[str, NDArray[np.float64]]
"""The step, the time and the measures of a run, each of shape (m,)."""


def of_series(
    runs: Sequence[tuple[str, SeriesColumns]], empty: OccasionalColumns | None = None
) -> pandas.DataFrame:
    """Measures over time, by the names of the runs, as a table of pandas.

    Without runs the table has the columns of `empty`.

    Raises:
        ImportError: pandas is missing; `pip install jostle[pandas]` installs it.
    """
    pd = import_extra("pandas", "pandas")
    tables = []
    for run, columns in runs:
        table: pandas.DataFrame = pd.DataFrame(columns).astype({"step": "int64"})
        values = [(name, _number_or_text(value)) for name, value in _values(run)]
        for place, (name, value) in enumerate([("run", run), *values]):
            table.insert(place, _beside(columns, name), value)
        tables.append(table)
    if tables:
        joined: pandas.DataFrame = pd.concat(tables, ignore_index=True)
        return joined
    empty = empty or NO_COLUMNS
    measured = ["step", "time", *empty.series]
    named = [_beside(measured, name) for name in ("run", *empty.varied)]
    nothing: pandas.DataFrame = pd.DataFrame(columns=[*named, *measured])
    return nothing.astype({"step": "int64"} | dict.fromkeys(measured[1:], "float64"))


def _values(run: str) -> Iterator[tuple[str, str]]:
    """The values in the name of a run, each with its name."""
    for pair in run.split(" "):
        name, separator, value = pair.partition("=")
        if separator:
            yield name, value


def _beside(columns: Container[str], name: str) -> str:
    """The column of a value in the names of runs: a variable may have the name of another."""
    return f"{name}_of_run" if name in columns else name


def of_trajectory(run: str, columns: SeriesColumns) -> pandas.DataFrame:
    """The trajectory of a run as a table of pandas.

    Raises:
        ImportError: pandas is missing; `pip install jostle[pandas]` installs it.
    """
    kinds = {"step": "int64", "id": "uint32", "informed": "bool"}
    return of_series([(run, columns)]).astype(kinds)


def _number_or_text(text: str) -> float | int | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


class ResultsPage(msgspec.Struct, frozen=True, kw_only=True):
    """A page of rows; `next` is the number to request the next page after.

    Daemons of earlier versions do not send `columns`.
    """

    name: str
    rows: list[ResultRow]
    next: int | None = None
    finished: int
    columns: OccasionalColumns | None = None


@dataclass(frozen=True, eq=False)
class OrderSeries:
    """The order of one run over time.

    Attributes:
        run: The name of the run.
        time: The times, shape (m,), body sizes over free speed.
        order: The order at each time, shape (m,), 0 to 1.
        drift: The drift along the informed individuals' direction at each time, shape (m,), free
            speeds, NaN where it is undefined.
    """

    run: str
    time: NDArray[np.float64]
    order: NDArray[np.float64]
    drift: NDArray[np.float64]
