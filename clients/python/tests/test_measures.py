"""Measures of swarms against formulas in NumPy and Shapely, written from docs/measures.md."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

import jostle
from conftest import Daemon
from jostle import aio

Column = NDArray[np.float64]
Create = Callable[..., jostle.Swarm]

GAPS = [0.001, 0.05, 0.3]
"""The gaps of clusters and contacts; the first is the default."""

QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}


class Group:
    """A state as shapes: an axis for each individual."""

    def __init__(self, state: jostle.State, pi1: float) -> None:
        self.position = np.column_stack((state.x, state.y))
        self.heading = np.column_stack((np.cos(state.alpha), np.sin(state.alpha)))
        self.informed = state.weight > 0
        self.direction = state.direction
        # docs/model.md, A body.
        self.radius = 1 / (1 + pi1)
        half = (pi1 - 1) / (1 + pi1) * self.heading
        if pi1 == 1:
            self.axes = shapely.points(self.position)
        else:
            ends = np.stack((self.position - half, self.position + half), axis=1)
            self.axes = shapely.linestrings(ends)

    @property
    def n(self) -> int:
        """The size of the group."""
        return len(self.position)

    def gaps(self) -> Column:
        """The gap of each pair, shape (n, n): the distance of the axes less the width."""
        apart = shapely.distance(self.axes[:, None], self.axes[None, :])
        return np.asarray(apart - 2 * self.radius)

    def distances(self) -> Column:
        """The distance of each pair of centres, shape (n, n)."""
        centres = shapely.points(self.position)
        return np.asarray(shapely.distance(centres[:, None], centres[None, :]))

    def clusters(self, gap: float) -> list[int]:
        """The sizes of the sets of individuals that gaps of at most `gap` connect."""
        sizes = []
        left = set(range(self.n))
        near = self.gaps() <= gap
        while left:
            cluster = {left.pop()}
            new = set(cluster)
            while new:
                new = {int(j) for i in new for j in np.flatnonzero(near[i])} & left
                left -= new
                cluster |= new
            sizes.append(len(cluster))
        return sizes


def nearest(pairs: Column) -> Column:
    """The least value of each individual over the others, shape (n,)."""
    pairs = pairs.copy()
    np.fill_diagonal(pairs, np.inf)
    return np.asarray(pairs.min(axis=1))


def cross(a: Column, b: Column) -> Column:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def of_all(group: Group) -> dict[str, float | None]:
    """The measures that do not depend on neighbours."""
    centred = group.position - group.position.mean(axis=0)
    away = np.linalg.norm(centred, axis=1)
    unit = centred / np.where(away > 1e-9, away, np.inf)[:, None]
    angle = np.arctan2(group.heading[:, 1], group.heading[:, 0])
    values: dict[str, float | None] = {
        "order": abs(np.exp(1j * angle).mean()),
        "nematic": abs(np.exp(2j * angle).mean()),
        "milling": abs(cross(unit, group.heading).mean()),
        "radius_of_gyration": np.sqrt((away**2).mean()),
        "spread": shapely.MultiPoint(group.position).convex_hull.area,
        "drift": None,
        "front": None,
    }
    if not group.informed.any():
        return values
    (direction,) = set(group.direction[group.informed])
    along = np.array([np.cos(direction), np.sin(direction)])
    values["drift"] = float(group.heading.mean(axis=0) @ along)
    if group.n > 1:
        place = group.position @ along
        below = (place[None, :] < place[:, None]).sum(axis=1)
        ties = (place[None, :] == place[:, None]).sum(axis=1) - 1
        rank = below + ties / 2
        values["front"] = float(rank[group.informed].mean() / (group.n - 1))
    return values


def of_neighbours(group: Group) -> dict[str, float | None]:
    """The measures that depend on neighbours."""
    values: dict[str, float | None] = {}
    gaps, distances = group.gaps(), group.distances()
    for quantile, share in QUANTILES.items():
        for name, pairs in (("neighbour_distance", distances), ("neighbour_gap", gaps)):
            value = float(np.quantile(nearest(pairs), share)) if group.n > 1 else None
            values[f"{name}.{quantile}"] = value
    for gap in GAPS:
        argument = "" if gap == GAPS[0] else f"({gap})"
        sizes = np.array(group.clusters(gap))
        values[f"clusters.count{argument}"] = len(sizes)
        values[f"clusters.largest{argument}"] = sizes.max()
        values[f"clusters.n_eff{argument}"] = (sizes**2).sum() / group.n
        pairs_near = np.triu(gaps <= gap, k=1).sum()
        values[f"contacts_per_body{argument}"] = 2 * pairs_near / group.n
    return values


RING = np.linspace(0, 2 * np.pi, 12, endpoint=False)

SWARMS: dict[str, dict[str, Any]] = {
    "default": {"n": 50},
    "discs": {"n": 60, "pi1": 1},
    "needles": {"n": 40, "pi1": 12},
    "scattered": {"n": 90, "attraction": {"kind": "metric", "radius": 1.5}},
    "voronoi": {"n": 70, "pi1": 2, "attraction": {"kind": "voronoi"}, "noise": 0.3},
    "two": {"n": 2},
    "one": {"n": 1},
    "far": {
        "n": 12,
        "start": {
            "kind": "given",
            "x": list(40_000 + 4 * np.cos(RING)),
            "y": list(-70_000 + 4 * np.sin(RING)),
            "alpha": list(RING + np.pi / 2),
        },
    },
}
"""Specs, with individuals apart, in contact, of other shapes, and far from the origin."""


@pytest.mark.parametrize("name", SWARMS)
@pytest.mark.parametrize("steps", [0, 400])
def test_measures_are_those_of_the_formulas(name: str, steps: int, create: Create) -> None:
    fields = {"seed": 5, **SWARMS[name]}
    swarm = create(**fields)
    if steps:
        swarm.inform({"fraction": 0.3}, direction=0.7)
        swarm.step(steps)
    group = Group(swarm.state(), fields.get("pi1", 4))
    expected = of_all(group) | of_neighbours(group)
    measured = swarm.measures(*expected)
    assert list(measured) == list(expected)
    for measure, value in measured.items():
        formula = expected[measure]
        if value is None or formula is None:
            assert value is formula, measure
            continue
        assert value == pytest.approx(formula, rel=1e-9, abs=1e-9), measure
    # All of one state, without names, are the same numbers.
    every = swarm.measures()
    assert {it: measured[it] for it in every} == every


def test_a_ring_mills(create: Create) -> None:
    swarm = create(**SWARMS["far"])
    assert swarm.measure("milling") == pytest.approx(1, abs=1e-9)
    assert swarm.measure("order") == pytest.approx(0, abs=1e-9)


def test_measures_reject_what_is_none(create: Create) -> None:
    swarm = create(3)
    for name, part in [
        ("ordr", "did you mean `order`"),
        ("msd(5)", "states of earlier steps"),
        ("turning_rate", "states of earlier steps"),
        ("clusters.count(9)", "0 to 2 body sizes"),
        ("order,drift", "give each name of its own"),
        ("", "unknown measure"),
    ]:
        with pytest.raises(jostle.InvalidArgument, match=part.replace("(", r"\(")):
            swarm.measure(name)
    with pytest.raises(jostle.InvalidArgument, match="named twice"):
        swarm.measures("order", "order")
    with pytest.raises(jostle.InvalidArgument):
        swarm.measure(3)  # type: ignore[arg-type]
    assert swarm.measures("clusters.count(0.001)", "order").keys() == {
        "clusters.count(0.001)",
        "order",
    }


def test_measures_can_be_awaited(create: Create, daemon: Daemon) -> None:
    swarm = create(6)

    async def measured() -> tuple[float | None, dict[str, float | None]]:
        async with aio.connect(daemon.endpoint) as client:
            there = client.swarm(swarm.name)
            return await there.measure("order"), await there.measures("order", "drift")

    order, both = asyncio.run(measured())
    assert both == {"order": order, "drift": None}
    assert order == swarm.status().order.order
