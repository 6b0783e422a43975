"""The measures that a swarm publishes: in its orders, in `/metrics`, and after a restart."""

from __future__ import annotations

import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

import jostle
from conftest import Daemon

Create = Callable[..., jostle.Swarm]

NAMES = ["drift", "milling", "clusters.count(0.1)"]


def one_order(swarm: jostle.Swarm) -> jostle.OrderSample:
    """The order after one more step."""
    with swarm.orders(timeout=10) as orders:
        swarm.step(1)
        while (order := next(orders)).step < swarm.status().step:
            pass
    return order


def test_orders_contain_the_chosen_measures(create: Create) -> None:
    swarm = create(30, seed=4, measures=["order"])
    assert swarm.status().parameters.measures == ["order"]
    swarm.inform({"fraction": 0.3}, direction=0.7)
    result = swarm.set(measures=NAMES)
    assert (result.before.measures, result.now.measures) == (["order"], NAMES)
    swarm.step(200)
    order = one_order(swarm)
    assert order.measures == swarm.measures(*NAMES)
    # The defaults are in their normal form, and an empty list ends it.
    assert swarm.set(measures=["clusters.count(0.001)"]).now.measures == ["clusters.count"]
    assert swarm.set(measures=[]).now.measures is None
    assert one_order(swarm).measures is None
    # A reset returns to the spec.
    swarm.reset()
    assert swarm.status().parameters.measures == ["order"]


def test_measures_change_no_step(create: Create) -> None:
    plain, measured = create(40, seed=9), create(40, seed=9, measures=NAMES)
    for swarm in (plain, measured):
        swarm.step(300)
    assert plain.status().state_hash == measured.status().state_hash
    assert one_order(plain).measures is None


def test_forks_and_batches_keep_the_measures(create: Create) -> None:
    swarm = create(10, seed=2)
    swarm.batch([jostle.Set(measures=["milling"]), jostle.Set(noise=0.1)])
    fork = swarm.fork(f"{swarm.name}-fork")
    assert fork.status().parameters.measures == ["milling"]
    fork.delete()


def test_invalid_measures_change_nothing(create: Create) -> None:
    swarm = create(3, measures=["milling"])
    for names, part in [
        (["ordr"], "did you mean `order`"),
        (["msd(5)"], "states of earlier steps"),
        (["order", "order"], "named twice"),
        ([f"clusters.count({k / 100})" for k in range(17)], "at most 16"),
        (["clusters.count(9)"], "0 to 2 body sizes"),
    ]:
        with pytest.raises(jostle.InvalidArgument, match=part) as error:
            swarm.set(measures=names)
        assert error.value.details["field"] == "measures"
        with pytest.raises(jostle.InvalidArgument, match=part):
            swarm.batch([jostle.Set(noise=0.5), jostle.Set(measures=names)])
        with pytest.raises(jostle.InvalidArgument, match=part):
            create(3, measures=names)
    with pytest.raises(jostle.InvalidArgument, match="is no list of measures"):
        swarm.set(measures="milling")
    assert swarm.status().parameters.measures == ["milling"]
    assert swarm.status().parameters.noise == 0


def test_a_restart_keeps_the_measures(tmp_path: Path) -> None:
    for is_killed in (False, True):
        first = Daemon(tmp_path)
        with jostle.connect(first.endpoint) as client:
            name = f"kept-{is_killed}".lower()
            swarm = client.create(name, {"n": 12, "seed": 5, "measures": ["order"]})
            swarm.set(measures=NAMES)
            swarm.step(20)
        if is_killed:
            first.kill()
        else:
            assert first.stop() == 0
        second = Daemon(tmp_path)
        with jostle.connect(second.endpoint) as client:
            swarm = client.swarm(name)
            assert swarm.status().parameters.measures == NAMES
            assert one_order(swarm).measures == swarm.measures(*NAMES)
        assert second.stop() == 0


def test_metrics_contain_the_measures(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, http="127.0.0.1:0")
    with jostle.connect(daemon.endpoint) as client:
        swarm = client.create("a", {"n": 20, "seed": 6, "measures": ["milling", "drift"]})
        swarm.step(50)

        def lines() -> list[str]:
            with urllib.request.urlopen(f"{daemon.http}/metrics") as reply:
                text = reply.read().decode()
            return [line for line in text.splitlines() if 'swarm="a",measure=' in line]

        # `drift` is undefined without informed individuals.
        (line,) = lines()
        series, value = line.split(" ")
        assert series == 'jostle_swarm_measure{swarm="a",measure="milling"}'
        assert float(value) == swarm.measure("milling")
        swarm.set(measures=[])
        assert lines() == []
    assert daemon.stop() == 0
