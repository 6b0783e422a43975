"""Tables of pandas, made of what a swarm tells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._errors import InvalidArgument
from ._extras import need
from ._messages import OrderSample
from ._state import State

if TYPE_CHECKING:
    import pandas


def frame(records: State | OrderSample | Iterable[State | OrderSample]) -> pandas.DataFrame:
    """Makes a table of states or orders.

        jostle.frame(itertools.islice(swarm.states(), 100))

    Of states it has a row for each individual in each: `swarm, epoch, frame, step, time, phase,
    id, x, y` (absolute), `alpha, weight, direction` (NaN for the uninformed), `informed, order,
    drift` (of the group; NaN if there is no common direction). Of orders it has a row for each:
    `swarm, epoch, frame, step, time, phase, n, informed, order, drift, mean_order, mean_drift,
    velocity_x, velocity_y, worst_gap, residual`. Units are those of `State` and `Order`.

    Args:
        records: One or any number, such as a list or what is left of a stream, to its end.

    Raises:
        ImportError: pandas is missing; `pip install jostle[pandas]` brings it.
        InvalidArgument: They are not all states or all orders.
    """
    records = [records] if isinstance(records, State | OrderSample) else list(records)
    states = [it for it in records if isinstance(it, State)]
    if len(states) == len(records):
        return of_states(states)
    orders = [it for it in records if isinstance(it, OrderSample)]
    if len(orders) == len(records):
        return of_orders(orders)
    raise InvalidArgument(
        "a table is made of states alone or of orders alone, as `states()` and `orders()` yield",
        details={"field": "records"},
    )


def of_states(states: Sequence[State]) -> pandas.DataFrame:
    """A row for each individual in each state."""
    pd = need("pandas", "pandas")
    counts = [state.n for state in states]

    def each(values: list[Any], dtype: type[Any]) -> NDArray[Any]:
        return np.repeat(np.array(values, dtype), counts)

    def all_of(columns: list[NDArray[Any]], dtype: type[Any]) -> NDArray[Any]:
        return np.concatenate([np.empty(0, dtype), *columns])

    def words(values: list[str]) -> Any:
        kinds = sorted(set(values))
        return pd.Categorical.from_codes(each([kinds.index(it) for it in values], int), kinds)

    positions = [state.position for state in states]
    informed = all_of([state.informed for state in states], bool)
    direction = all_of([state.direction for state in states], float)
    columns = {
        "swarm": words([state.swarm for state in states]),
        **_when(states, each),
        "phase": words([state.phase for state in states]),
        "id": all_of([state.id for state in states], np.uint32),
        "x": all_of([position[:, 0] for position in positions], float),
        "y": all_of([position[:, 1] for position in positions], float),
        "alpha": all_of([state.alpha for state in states], float),
        "weight": all_of([state.weight for state in states], float),
        "direction": np.where(informed, direction, np.nan),
        "informed": informed,
        "order": each([state.order.order for state in states], float),
        "drift": each([_number(state.order.drift) for state in states], float),
    }
    table: pandas.DataFrame = pd.DataFrame(columns)
    return table


def of_orders(samples: Sequence[OrderSample]) -> pandas.DataFrame:
    """A row for each order."""
    pd = need("pandas", "pandas")
    orders = [sample.order for sample in samples]
    columns = {
        "swarm": pd.Categorical([sample.swarm for sample in samples]),
        **_when(samples, np.array),
        "phase": pd.Categorical([sample.phase for sample in samples]),
        "n": np.array([sample.n for sample in samples], int),
        "informed": np.array([sample.informed for sample in samples], int),
        **{
            name: np.array([_number(getattr(order, name)) for order in orders], float)
            for name in ("order", "drift", "mean_order", "mean_drift")
        },
        "velocity_x": np.array([order.velocity[0] for order in orders], float),
        "velocity_y": np.array([order.velocity[1] for order in orders], float),
        "worst_gap": np.array([_number(it.certificate.worst_gap) for it in samples], float),
        "residual": np.array([it.certificate.residual for it in samples], float),
    }
    table: pandas.DataFrame = pd.DataFrame(columns)
    return table


def _when(records: Sequence[State | OrderSample], column: Any) -> dict[str, Any]:
    """The columns that say when each was."""
    kinds = {"epoch": int, "frame": int, "step": int, "time": float}
    return {
        name: column([getattr(record, name) for record in records], kind)
        for name, kind in kinds.items()
    }


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
