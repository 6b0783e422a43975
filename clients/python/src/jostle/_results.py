"""What a daemon tells of experiments, as msgspec structs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from ._extras import need
from ._show import Shown, bar

if TYPE_CHECKING:
    import pandas

ExperimentPhase = Literal["queued", "running", "paused", "finished", "cancelled", "failed"]
"""What an experiment is doing."""


class RunUnderWay(msgspec.Struct, frozen=True, kw_only=True):
    """A run that is being carried out.

    Attributes:
        run: Its name.
        share: Of its steps that is done.
    """

    run: str
    share: float


class Progress(msgspec.Struct, frozen=True, kw_only=True):
    """How far an experiment is.

    Attributes:
        name: The experiment's name.
        phase: What it is doing.
        runs: How many it has.
        finished: How many are over.
        faulted: How many of them ended early.
        share: Of the work that is done, the work of runs under way included.
        elapsed_secs: How long it has been running, pauses aside.
        left_secs: How long it will still take; None while that cannot be told.
        running: The runs under way.
        message: Why it failed, or what is to be said of its runs.
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

    def _told(self) -> str:
        """The same in words, but for the share."""
        left = "" if self.left_secs is None or self.is_over else f", {self.left_secs:.0f} s left"
        faulted = f", {self.faulted} faulted" if self.faulted else ""
        why = f": {self.message}" if self.message else ""
        return f"{self.phase}, {self.finished} of {self.runs} runs{faulted}{left}{why}"

    def _repr_html_(self) -> str:
        return bar(self.share, f"{self.name} {100 * self.share:.0f} %, {self._told()}")

    @property
    def is_over(self) -> bool:
        """Whether nothing more happens to it by itself."""
        return self.phase in ("finished", "cancelled", "failed")


class ExperimentResult(msgspec.Struct, frozen=True, kw_only=True):
    """What the daemon `node` did with an experiment.

    Attributes:
        node: The daemon's name.
        created: Whether it was not there before.
        progress: How it stands now.
    """

    node: str
    created: bool
    progress: Progress


class Experiments(msgspec.Struct, frozen=True, kw_only=True):
    """All that the daemon `node` has, in the order in which they were submitted."""

    node: str
    experiments: list[Progress]


class ResultRow(Shown, frozen=True, kw_only=True):
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


def of_rows(rows: Sequence[ResultRow]) -> pandas.DataFrame:
    """Rows as a table of pandas.

    Raises:
        ImportError: pandas is missing; `pip install jostle[pandas]` installs it.
    """
    pd = need("pandas", "pandas")
    table: pandas.DataFrame = pd.DataFrame(
        [msgspec.structs.astuple(row) for row in rows], columns=ResultRow.__struct_fields__
    )
    # Without any number the column would be one of objects.
    return table.astype({"v_pd": "float64"})


class ResultsPage(msgspec.Struct, frozen=True, kw_only=True):
    """Some rows of a table of results, and after which number to ask on."""

    name: str
    rows: list[ResultRow]
    next: int | None = None
    finished: int


@dataclass(frozen=True, eq=False)
class OrderSeries:
    """The order of one run over time.

    Attributes:
        run: Its name.
        time: Of each entry.
        order: The polar order parameter at each.
        drift: Along the informed individuals' direction at each; empty if nobody is informed.
    """

    run: str
    time: NDArray[np.float64]
    order: NDArray[np.float64]
    drift: NDArray[np.float64]
