"""A measure of an experiment as a function of its parameters, for a search such as Optuna's."""

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

_LOOK_AGAIN_SECS = 0.2
# Fields of a grid that a spec does not have.
_OF_GRID = ("informed", "informed_fraction")


class Objective:
    """The mean of a measure over the runs of an experiment, as a function of parameters.

        objective = jostle.Objective("order.toml", "v_pd", folder="search")
        trial = study.ask()
        study.tell(trial, objective(informed=trial.suggest_int("informed", 1, 10)))

    The results of each set of values are kept in the folder: the same values give the same number
    at no cost, in this process and in later ones. After an interruption a call continues with the
    missing runs. Values that are only in the spec leave the seeds as they are, so that two of them
    are compared with the same random numbers.
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
        """Prepares a search.

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
            raise InvalidArgument(f"the experiment: {error}", details={"field": "source"}) from None
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
            InvalidArgument: A value is invalid; the message has the line.
            Faulted: A run ended early, or has no such measure.
        """
        rows = self.rows(**values)
        found = [getattr(row, self._measure) for row in rows]
        if not found or any(value is None or not math.isfinite(value) for value in found):
            raise Faulted(
                f"not every run has the measure {self._measure!r}: v_pd needs informed individuals",
                details={"measure": self._measure},
            )
        return statistics.fmean(found)

    def rows(self, **values: float | str) -> list[ResultRow]:
        """Returns the rows of all runs with these values, as `__call__` takes them."""
        toml = to_toml(self._with(values))
        name = hashlib.blake2b(toml.encode(), digest_size=12).hexdigest()
        with self._sweep(toml, self._folder / name) as task:
            task.wait(show=False)
            if faults := task.faults():
                run, reason = next(iter(faults.items()))
                raise Faulted(
                    f"{len(faults)} runs ended early: {run}: {reason}", details={"faults": faults}
                )
            return task.rows()

    def _sweep(self, toml: str, folder: Path) -> Sweep:
        """The sweep of these values, once no other process executes it."""
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
                rest(_LOOK_AGAIN_SECS)

    def _with(self, values: Mapping[str, float | str]) -> dict[str, Any]:
        """The fields of the experiment with these values. Equal values give equal fields."""
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
    """The number 2.0 as 2: both are the same value, and have the same text then."""
    if isinstance(value, str):
        return value
    number = float(value)
    return int(number) if number.is_integer() else number
