"""Objective functions: a measure of an experiment, for optimisers such as Optuna."""

from __future__ import annotations

import hashlib
import math
import os
import statistics
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ._cancel import rest
from ._errors import Conflict, Faulted, InvalidArgument
from ._experiment import Source, to_toml
from ._results import ResultRow
from ._sweep import Sweep, sweep

_RETRY_INTERVAL_SECS = 0.2
# Fields of a grid that a spec does not have.
_OF_GRID = ("informed", "informed_fraction")


class Objective:
    """An objective function: the mean of a measure over the runs of an experiment.

        objective = jostle.Objective("order.toml", "v_pd", folder="search")
        trial = study.ask()
        study.tell(trial, objective(informed=trial.suggest_int("informed", 1, 10)))

    The results of each set of values are stored in the folder: the same values give the same number
    without executing a run, in this process and in later ones. After an interruption a call
    executes only the missing runs. All values but `informed` and `informed_fraction` leave the
    seeds of the runs unchanged, so two values are compared with common random numbers.
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
    ) -> None:
        """Creates an objective function.

        Args:
            source: The experiment: a file, the text of one, or a mapping of its fields.
            measure: A column of the results, such as `v` or `v_pd`.
            folder: The folder of all results.
            executor: As in `sweep`.
            task_secs: As in `sweep`.
            jostled: As in `sweep`.

        Raises:
            InvalidArgument: The source is not TOML, or there is no such measure.
            OSError: The file cannot be read.
        """
        try:
            self._fields = tomllib.loads(to_toml(source))
        except tomllib.TOMLDecodeError as error:
            raise InvalidArgument(
                f"invalid experiment: {error}", details={"field": "source"}
            ) from None
        measures = [
            name
            for name, kind in ResultRow.__annotations__.items()
            if kind in ("int", "float", "float | None")
        ]
        if measure not in measures:
            raise InvalidArgument(
                f"unknown measure {measure!r}: use one of {', '.join(measures)}",
                details={"field": "measure"},
            )
        self._measure = measure
        self._folder = Path(folder)
        self._executor = executor
        self._task_secs = task_secs
        self._jostled = jostled

    def __repr__(self) -> str:
        return f"Objective({self._measure!r} in {str(self._folder)!r})"

    def __call__(self, **values: float | str) -> float:
        """Returns the mean over all runs with these values.

        Args:
            values: Fields of the spec, such as `pi1=4.0`, or `informed` or `informed_fraction`.

        Raises:
            InvalidArgument: A value is invalid; the message names the field.
            Faulted: A run ended early, or the measure is not finite in every run.
        """
        rows = self.rows(**values)
        found = [getattr(row, self._measure) for row in rows]
        bad = sum(value is None or not math.isfinite(value) for value in found)
        if bad or not found:
            needs = "; v_pd needs informed individuals" if self._measure == "v_pd" else ""
            raise Faulted(
                f"no finite {self._measure!r} in {bad} of {len(found)} runs: choose another "
                f"measure or other values{needs}",
                details={"measure": self._measure},
            )
        return statistics.fmean(found)

    def rows(self, **values: float | str) -> list[ResultRow]:
        """Returns the rows of all runs with these values.

        Takes the arguments of `__call__`.

        Raises:
            InvalidArgument: A value is invalid; the message names the field.
            Faulted: A run ended early.
        """
        toml = to_toml(self._with(values))
        name = hashlib.blake2b(toml.encode(), digest_size=12).hexdigest()
        with self._sweep(toml, self._folder / name) as task:
            task.wait(show=False)
            if faults := task.faults():
                run, reason = next(iter(faults.items()))
                raise Faulted(
                    f"{len(faults)} runs ended early, the first is {run!r}: {reason}; choose other "
                    "values",
                    details={"faults": faults},
                )
            return task.rows()

    def _sweep(self, toml: str, folder: Path) -> Sweep:
        """Creates the sweep of these values.

        While another process holds the lock of its folder, it retries, without a timeout.
        """
        while True:
            try:
                return sweep(
                    toml,
                    self._executor,
                    folder=folder,
                    task_secs=self._task_secs,
                    jostled=self._jostled,
                )
            except Conflict:
                rest(_RETRY_INTERVAL_SECS)

    def _with(self, values: Mapping[str, float | str]) -> dict[str, Any]:
        """The fields of the experiment with these values. Equal values give equal fields."""
        if all(name in values for name in _OF_GRID):
            raise InvalidArgument(
                "informed and informed_fraction exclude each other: leave out one of them",
                details={"field": "informed"},
            )
        spec = dict(self._fields.get("spec", {}))
        grids = [dict(grid) for grid in self._fields.get("grid", [])]
        for name in sorted(values):
            value = _canonical(values[name])
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


def _canonical(value: float | str) -> float | str:
    """Converts integral floats to int, so that 2.0 and 2 have the same text and folder."""
    if isinstance(value, str):
        return value
    number = float(value)
    return int(number) if number.is_integer() else number
