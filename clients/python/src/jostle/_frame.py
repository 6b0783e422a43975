"""Tables of pandas, made of states and orders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._attachment import unix_secs
from ._errors import invalid
from ._extras import import_extra
from ._state import State
from ._wire import Attachment, OrderSample

if TYPE_CHECKING:
    import pandas

Columns = dict[str, NDArray[Any]]

# The columns of a table of states, live or recorded: of a frame, of each individual, of the group.
OF_FRAME: dict[str, type[Any]] = {
    "swarm": object,
    **dict.fromkeys(["epoch", "frame", "step"], np.int64),
    "time": np.float64,
    "phase": object,
}
OF_EACH: dict[str, type[Any]] = {
    "id": np.uint32,
    **dict.fromkeys(["x", "y", "alpha", "weight", "direction"], np.float64),
    "informed": np.bool_,
}
OF_GROUP: dict[str, type[Any]] = {
    **dict.fromkeys(["order", "drift", "worst_gap", "residual"], np.float64),
    "contacts": np.int64,
    **dict.fromkeys(["stepped_unix_secs", "published_unix_secs"], np.float64),
}
KINDS: dict[str, type[Any]] = {**OF_FRAME, **OF_EACH, **OF_GROUP}


def frame(records: State | OrderSample | Iterable[State | OrderSample]) -> pandas.DataFrame:
    """Makes a table of states or orders.

        jostle.frame(itertools.islice(swarm.states(), 100))

    Of states it has a row for each individual in each, with the columns of a recording's table:
    `swarm, epoch, frame, step, time, phase, id, x, y` (absolute), `alpha, weight, direction` (NaN
    for the uninformed), `informed`, and of the group `order, drift` (NaN if there is no common
    direction), `worst_gap` (NaN if no two bodies are near), `residual, contacts`, and in seconds
    since 1970, NaN if unknown, `stepped_unix_secs, published_unix_secs`. Of orders it has a row for
    each: `swarm, epoch, frame, step, time, phase, n, informed, order, drift, mean_order,
    mean_drift, velocity_x, velocity_y, worst_gap, residual`, and the measures that the swarm
    publishes. Units are those of `State` and
    `Order`.

    Args:
        records: One, or an iterable of them, such as a list or a stream, which is read to its end.

    Raises:
        ImportError: pandas is missing: `pip install jostle[pandas]`.
        InvalidArgument: They are neither only states nor only orders.
    """
    records = [records] if isinstance(records, State | OrderSample) else list(records)
    states = [it for it in records if isinstance(it, State)]
    if len(states) == len(records):
        return of_states(states)
    orders = [it for it in records if isinstance(it, OrderSample)]
    if len(orders) == len(records):
        return of_orders(orders)
    raise invalid(
        "records", "a table needs only states or only orders: use `states()` or `orders()`"
    )


def of_states(states: Sequence[State]) -> pandas.DataFrame:
    """A row for each individual in each state."""
    return table_of([columns_of(states)], "pandas")


def columns_of(states: Sequence[State]) -> Columns:
    """The columns of a table of states, with a value for each individual in each."""
    counts = [state.n for state in states]

    def each(name: str, values: list[Any]) -> NDArray[Any]:
        return np.repeat(np.array(values, KINDS[name]), counts)

    def all_of(name: str, columns: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([np.empty(0, KINDS[name]), *columns])

    positions = [state.position for state in states]
    certificates = [state.certificate for state in states]
    attachments = [state.attachment or Attachment(sequences={}) for state in states]
    single = {
        **{name: [getattr(state, name) for state in states] for name in OF_FRAME},
        "order": [state.order.order for state in states],
        "drift": [_number(state.order.drift) for state in states],
        "worst_gap": [_number(it.worst_gap) for it in certificates],
        "residual": [it.residual for it in certificates],
        "contacts": [it.contacts for it in certificates],
        "stepped_unix_secs": [unix_secs(it.stepped_unix_nanos) for it in attachments],
        "published_unix_secs": [unix_secs(it.published_unix_nanos) for it in attachments],
    }
    informed = all_of("informed", [state.informed for state in states])
    direction = all_of("direction", [state.direction for state in states])
    columns = {
        **{name: each(name, values) for name, values in single.items()},
        "id": all_of("id", [state.id for state in states]),
        "x": all_of("x", [position[:, 0] for position in positions]),
        "y": all_of("y", [position[:, 1] for position in positions]),
        "alpha": all_of("alpha", [state.alpha for state in states]),
        "weight": all_of("weight", [state.weight for state in states]),
        "direction": np.where(informed, direction, np.nan),
        "informed": informed,
    }
    return {name: columns[name] for name in KINDS}


def table_of(parts: Sequence[Columns], extra: str) -> pandas.DataFrame:
    """Concatenates the parts into a table; `extra` names the extra that installs pandas."""
    columns = {
        name: np.concatenate([np.empty(0, kind), *(part[name] for part in parts)])
        for name, kind in KINDS.items()
    }
    return _table(columns, extra)


def of_orders(samples: Sequence[OrderSample]) -> pandas.DataFrame:
    """A row for each order."""
    orders = [sample.order for sample in samples]
    kinds = {**OF_FRAME, "n": np.int64, "informed": np.int64}
    numbers = {
        **{
            name: [_number(getattr(order, name)) for order in orders]
            for name in ("order", "drift", "mean_order", "mean_drift")
        },
        "velocity_x": [order.velocity[0] for order in orders],
        "velocity_y": [order.velocity[1] for order in orders],
        "worst_gap": [_number(sample.certificate.worst_gap) for sample in samples],
        "residual": [sample.certificate.residual for sample in samples],
    }
    columns = {
        **{
            name: np.array([getattr(sample, name) for sample in samples], kind)
            for name, kind in kinds.items()
        },
        **{name: np.array(values, float) for name, values in numbers.items()},
        **_measures(samples),
    }
    return _table(columns, "pandas")


def _measures(samples: Sequence[OrderSample]) -> Columns:
    """A column for each published measure, NaN where a sample has no value."""
    found = [sample.measures or {} for sample in samples]
    names = dict.fromkeys(name for measures in found for name in measures)
    # `order` and `drift` have columns already, of the same values.
    return {
        name: np.array([_number(measures.get(name)) for measures in found])
        for name in names
        if name not in ("order", "drift")
    }


def _table(columns: Columns, extra: str) -> pandas.DataFrame:
    pd = import_extra("pandas", extra)
    table: pandas.DataFrame = pd.DataFrame(
        {name: pd.Categorical(it) if it.dtype == object else it for name, it in columns.items()}
    )
    return table


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
