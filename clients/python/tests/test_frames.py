"""pandas tables of states, orders and events."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

import jostle
from conftest import MAX_WAIT_SECS

Create = Callable[..., jostle.Swarm]

COLUMNS = [
    *("swarm", "epoch", "frame", "step", "time", "phase", "id", "x", "y", "alpha", "weight"),
    *("direction", "informed", "order", "drift", "worst_gap", "residual", "contacts"),
    *("stepped_unix_secs", "published_unix_secs"),
]


def test_a_state_has_a_row_for_each_individual(create: Create) -> None:
    swarm = create(n=5)
    swarm.inform(jostle.ids([1, 3]), 0.5, weight=2.0)
    state = swarm.step(10, state=True)
    for table in (swarm.frame(), jostle.frame(state), jostle.frame([state])):
        assert list(table.columns) == COLUMNS
        assert (table.step == 10).all()
        assert list(table.id) == [0, 1, 2, 3, 4]
        assert np.array_equal(table[["x", "y"]].to_numpy(), state.position)
        assert np.array_equal(table.alpha.to_numpy(), state.alpha)
        assert list(table.id[table.informed]) == [1, 3]
        assert (table.direction.dropna() == 0.5).all()
        assert table.direction.isna().sum() == 3
        assert (table.order == state.order.order).all()
        assert (table.drift == state.order.drift).all()
        certificate = state.certificate
        assert (table.worst_gap == certificate.worst_gap).all()
        assert (table.residual == certificate.residual).all()
        assert (table.contacts == certificate.contacts).all()


def test_a_table_of_steps_misses_none_and_gives_the_same_states(create: Create) -> None:
    swarm = create(n=4, seed=3)
    table = swarm.frame(steps=25, every=10)
    assert list(table.step.unique()) == [0, 10, 20, 25]
    assert len(table) == 16
    assert table.drift.isna().all()
    alone = create(n=4, seed=3).step(25, state=True)
    assert np.array_equal(table[table.step == 25].x.to_numpy(), alone.position[:, 0])
    assert len(swarm.frame(steps=0)) == 4
    assert swarm.status().step == 25


def test_groups_that_change_are_one_table(create: Create) -> None:
    one, two = create(n=2), create(n=3)
    states = [one.state(), two.state()]
    one.inject(2)
    states.append(one.state())
    table = jostle.frame(states)
    assert list(table.groupby("swarm", observed=True).size()) == [6, 3]
    assert table.dtypes["id"] == np.uint32


def test_orders_have_a_row_each(create: Create) -> None:
    swarm = create(n=5, publish_every=1, rate=1.0)
    swarm.inform(jostle.count(5), 0.0)
    with swarm.orders(timeout=MAX_WAIT_SECS) as orders:
        swarm.run()
        samples = list(itertools.islice(orders, 5))
    table = jostle.frame(samples)
    assert len(table) == 5
    assert table.step.is_monotonic_increasing
    assert np.allclose(table.drift, table.velocity_x)
    # Each column has its own values: no two of them are equal.
    for number, name in enumerate(("velocity_x", "velocity_y")):
        assert table[name].tolist() == [sample.order.velocity[number] for sample in samples]
    for name in ("order", "drift", "mean_order", "mean_drift"):
        expected = np.array([getattr(sample.order, name) for sample in samples], float)
        np.testing.assert_array_equal(table[name], expected)
    assert table.residual.tolist() == [sample.certificate.residual for sample in samples]
    assert table.order.between(0.0, 1.0).all()


def test_states_up_to_the_end_of_a_swarm_are_kept(create: Create) -> None:
    swarm = create(n=3)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        seen = [next(states)]
        swarm.delete()
        assert len(jostle.frame([*seen, *states])) >= 3


def test_an_empty_list_is_a_table() -> None:
    assert list(jostle.frame([]).columns) == COLUMNS


def test_other_values_are_rejected_as_tables(create: Create) -> None:
    swarm = create(n=2, publish_every=1)
    with swarm.orders(timeout=MAX_WAIT_SECS) as orders:
        swarm.step()
        with pytest.raises(jostle.InvalidArgument, match="only states or only orders"):
            jostle.frame([swarm.state(), next(orders)])
    with pytest.raises(jostle.InvalidArgument, match="every"):
        swarm.frame(steps=3, every=0)
    with pytest.raises(jostle.InvalidArgument, match="steps"):
        swarm.frame(steps=-3)
    swarm.run()
    # `Conflict` if the running swarm steps between the query of its state and the command.
    with pytest.raises((jostle.IncorrectState, jostle.Conflict)):
        swarm.frame(steps=3)


def test_without_pandas_the_error_names_the_extra() -> None:
    code = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(['pandas', 'IPython', 'matplotlib']))\n"
        "import jostle, jostle.aio\n"
        "try:\n    jostle.frame([])\nexcept ImportError as error:\n    print(error)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert "pip install 'jostle[pandas]'" in ran.stdout
