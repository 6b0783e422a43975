"""Objective functions: a measure of an experiment, for optimisers such as Optuna."""

from __future__ import annotations

import hashlib
import math
import os
import re
import statistics
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ._cancel import sleep
from ._errors import Conflict, Faulted, InvalidArgument, invalid
from ._experiment import Source, to_toml
from ._models import model_conflict, other_model
from ._plan import Programs
from ._sweep import UNNAMED, Sweep, source_label, sweep
from ._wire import ResultRow

_RETRY_INTERVAL_SECS = 0.2
# Fields of a grid that a spec does not have.
_OF_GRID = ("informed", "informed_fraction")
# Integers of TOML are below it.
_INT_LIMIT = 2**63


class Objective:
    """An objective function: the mean of a measure over the runs of an experiment.

        objective = jostle.Objective("order.toml", "v_pd", folder="search")
        trial = study.ask()
        study.tell(trial, objective(informed=trial.suggest_int("informed", 1, 10)))

    The results of each set of values are stored in the folder: the same values give the same number
    without executing a run, in this process and in later ones. After an interruption a call
    executes only the missing runs. All values but `informed` and `informed_fraction` leave the
    seeds of the runs unchanged, so two values are compared with common random numbers. For that, a
    value replaces the axis of the same name in the file's grid: the names of the runs do not
    contain it, so their seeds differ from those of the file's runs with that value.
    """

    def __init__(
        self,
        source: Source,
        measure: str,
        *,
        folder: str | os.PathLike[str],
        executor: Any = None,
        task_secs: float = 30.0,
        jostled: str | os.PathLike[str] | None = None,
        again: bool = False,
    ) -> None:
        """Creates an objective function.

        Args:
            source: The experiment: a file, the text of one, or a mapping of its fields.
            measure: A column of the results, such as `v` or `v_pd`, or one of the file's
                `[measure] columns`, such as `drift`, as it is written there.
            folder: The folder of all results.
            executor: As in `sweep`.
            task_secs: As in `sweep`.
            jostled: As in `sweep`.
            again: If an earlier version of the model executed runs in the folder, execute all of
                the search again beside it, in `FOLDER-model2` under version 2.

        Raises:
            InvalidArgument: The source is not TOML, has `points`, `setpoints` or `start`, or there
                is no such measure.
            OSError: The file cannot be read.
        """
        try:
            self._fields = tomllib.loads(to_toml(source))
        except tomllib.TOMLDecodeError as error:
            raise invalid("source", f"invalid experiment: {error}") from None
        if named := [key for key in ("points", "setpoints", "start") if key in self._fields]:
            raise invalid(
                "source",
                f"an objective function takes no other files: leave out {named[0]}, or use `sweep`",
            )
        measures = [
            name
            for name, kind in ResultRow.__annotations__.items()
            if kind in ("int", "float", "float | None")
        ]
        columns = _columns(self._fields)
        if measure not in (*measures, *columns):
            raise invalid(
                "measure",
                f"unknown measure {measure!r}: use one of {', '.join((*columns, *measures))}, or "
                "add it to `columns` in [measure]",
            )
        self._name = source_label(source)
        self._measure = measure
        self._folder = Path(folder)
        self._executor = executor
        self._task_secs = task_secs
        self._jostled = jostled
        self._again = again
        # Whether no other version of the model executed runs in the folder.
        self._is_of_model = False

    def __repr__(self) -> str:
        return f"Objective({self._measure!r} in {str(self._folder)!r})"

    def __call__(self, **values: float | str) -> float:
        """Returns the mean over all runs with these values.

        Args:
            values: Fields of the spec, such as `pi1=4.0`, or `informed` or `informed_fraction`.

        Raises:
            InvalidArgument: A value is invalid; the message names the field.
            Faulted: A run ended early, or the measure is not finite in every run.
            Conflict: As of `rows`.
        """
        rows = self.rows(**values)
        found = [_number(row, self._measure) for row in rows]
        finite = [value for value in found if value is not None and math.isfinite(value)]
        bad = len(found) - len(finite)
        if bad or not found:
            needs = "; v_pd needs informed individuals" if self._measure == "v_pd" else ""
            raise Faulted(
                f"no finite {self._measure!r} in {bad} of {len(found)} runs: choose another "
                f"measure or other values{needs}",
                details={"measure": self._measure},
            )
        return statistics.fmean(finite)

    def rows(self, **values: float | str) -> list[ResultRow]:
        """Returns the rows of all runs with these values.

        Takes the arguments of `__call__`.

        Raises:
            InvalidArgument: A value is invalid; the message names the field.
            Faulted: A run ended early.
            Conflict: Another version of the model executed runs in the folder: values of both
                cannot be compared. The details are as those of `sweep`.
        """
        self._check_model()
        fields = self._substitute(values)
        name = hashlib.blake2b(to_toml(fields).encode(), digest_size=12).hexdigest()
        try:
            task = self._sweep(fields, self._folder / name)
        except InvalidArgument as error:
            given = ", ".join(f"{field}={value!r}" for field, value in values.items())
            named = f"{self._name} with {given}" if given else self._name
            # The caller did not write the lines of the mapping's text.
            message = re.sub(
                rf"^{UNNAMED}(: line \d+, column \d+)?", lambda _: named, error.message
            )
            raise InvalidArgument(message, details=error.details) from None
        with task:
            task.wait(show=False)
            if faults := task.faults():
                run, reason = next(iter(faults.items()))
                raise Faulted(
                    f"{len(faults)} runs ended early, the first is {run!r}: {reason}; choose other "
                    "values",
                    details={"faults": faults},
                )
            return task.rows()

    def _check_model(self) -> None:
        """Checks the folder once, or goes to another one with `again`."""
        if self._is_of_model:
            return
        results = [*self._folder.glob("*"), *self._folder.glob("*.parts/runs-*")]
        ours = Programs(self._jostled).model_version()
        theirs = other_model(results, ours)
        if theirs is not None:
            error = model_conflict(self._folder, theirs, ours)
            if not self._again or "again" not in error.details:
                raise error
            self._folder = Path(error.details["again"])
        self._is_of_model = True

    def _sweep(self, fields: Mapping[str, Any], folder: Path) -> Sweep:
        """Creates the sweep of these values.

        While another process holds the lock of its folder, it retries, without a timeout.
        """
        while True:
            try:
                return sweep(
                    fields,
                    self._executor,
                    folder=folder,
                    task_secs=self._task_secs,
                    jostled=self._jostled,
                )
            except Conflict as error:
                if "model_version" in error.details:
                    raise
                sleep(_RETRY_INTERVAL_SECS)

    def _substitute(self, values: Mapping[str, float | str]) -> dict[str, Any]:
        """The fields of the experiment with these values. Equal values give equal fields."""
        if all(name in values for name in _OF_GRID):
            raise invalid(
                "informed",
                "informed and informed_fraction exclude each other: leave out one of them",
            )
        spec = dict(self._fields.get("spec", {}))
        grids = [dict(grid) for grid in self._fields.get("grid", [])]
        for name in sorted(values):
            value = _canonical(name, values[name])
            for grid in grids:
                grid.pop(name, None)
            if name in _OF_GRID:
                grids = grids or [{}]
                for grid in grids:
                    for other in _OF_GRID:
                        grid.pop(other, None)
                    grid[name] = value
            else:
                spec[name] = value
        fields = {**self._fields, "spec": spec, "grid": [grid for grid in grids if grid]}
        return {name: it for name, it in fields.items() if it != []}


def _columns(fields: Mapping[str, Any]) -> list[str]:
    """The measures that the file adds to the table; none if it is invalid, which `sweep` says."""
    measure = fields.get("measure")
    columns = measure.get("columns") if isinstance(measure, Mapping) else None
    return [it for it in columns if isinstance(it, str)] if isinstance(columns, list) else []


def _number(row: ResultRow, measure: str) -> float | None:
    if measure in ResultRow.__annotations__:
        number: float | None = getattr(row, measure)
        return number
    return next((it.value for it in row.extra or () if it.name == measure), None)


def _canonical(name: str, value: float | str) -> float | str:
    """Converts integral floats to int, so that 2.0 and 2 have the same text and folder."""
    if isinstance(value, str):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise invalid(name, f"{name} is {value!r}, but must be a finite number or text")
    is_int = number.is_integer() and abs(number) < _INT_LIMIT
    return int(number) if is_int else number
