"""Replies of a daemon about experiments, as msgspec structs."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from ._extras import import_extra
from ._wire import AXES, OccasionalColumns, ResultRow

if TYPE_CHECKING:
    import pandas

NO_COLUMNS = OccasionalColumns(varied=[], extra=[], series=[])
"""Those of a daemon of an earlier version, which does not name them."""


_AXES = {name: kind for name, kind in AXES.items() if name not in ResultRow.__struct_fields__}
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
