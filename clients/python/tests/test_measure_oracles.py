"""Measures and histograms against values of freud and movement in `oracles/measures.json`."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

import jostle
from conftest import Daemon
from jostle import aio

Create = Callable[..., jostle.Swarm]

FIXTURE = json.loads((Path(__file__).parent / "oracles" / "measures.json").read_text())


@pytest.mark.parametrize("row", FIXTURE["states"])
def test_the_registry_has_the_values_of_freud_and_movement(
    row: dict[str, dict[str, object]], create: Create
) -> None:
    state, freud, movement = row["state"], dict(row["freud"]), row["movement"]
    start = {"kind": "given", **{name: state[name] for name in ("x", "y", "alpha")}}
    n = len(np.array(state["x"]))
    swarm = create(n, pi1=state["pi1"], start=start, contacts="closest")
    pairs, rdf = np.array(freud.pop("pairs")), np.array(freud.pop("rdf"))
    measured = swarm.measures(*freud, *movement)
    for name, value in movement.items():
        assert measured[name] == pytest.approx(value, rel=1e-9), name
    # freud computes with 32-bit floats.
    for name, value in freud.items():
        assert measured[name] == pytest.approx(value, rel=1e-5, abs=1e-6), name
    edges, g = swarm.histogram("pair_correlation", bins=FIXTURE["bins"], max=FIXTURE["max"])
    assert edges == pytest.approx(np.linspace(0, FIXTURE["max"], FIXTURE["bins"] + 1))
    # freud's area is that of its box, ours that of the convex hull.
    centres = np.column_stack((np.array(state["x"]), np.array(state["y"])))
    area = shapely.convex_hull(shapely.multipoints(centres)).area
    assert g * FIXTURE["side"] ** 2 / area == pytest.approx(rdf, rel=1e-5)
    annuli = np.pi * np.diff(edges**2)
    assert g * n**2 * annuli / area == pytest.approx(pairs, rel=1e-9)


def test_the_density_of_neighbours_is_that_of_numpy(create: Create) -> None:
    swarm = create(30, seed=3)
    swarm.step(200)
    state = swarm.state()
    edges, density = swarm.histogram("neighbour_density", bins=8, max=2.0)
    assert (edges.shape, density.shape) == ((9,), (8, 8))
    dx = state.x[None, :] - state.x[:, None]
    dy = state.y[None, :] - state.y[:, None]
    cos, sin = np.cos(state.alpha)[:, None], np.sin(state.alpha)[:, None]
    others = ~np.eye(30, dtype=bool)
    ahead, left = (dx * cos + dy * sin)[others], (dy * cos - dx * sin)[others]
    counts, _, _ = np.histogram2d(ahead, left, bins=8, range=[[-2, 2], [-2, 2]])
    assert density == pytest.approx(counts / (30 * 0.25), rel=1e-9)


def test_histograms_reject_what_they_cannot_compute(create: Create) -> None:
    swarm = create(5)
    for name, bins, longest, part in [
        ("rdf", 5, 1.0, "pair_correlation and neighbour_density"),
        ("pair_correlation", 0, 1.0, "from 1 to 10000"),
        ("neighbour_density", 201, 1.0, "to 200"),
        ("pair_correlation", 5, 0.0, "above 0"),
        ("pair_correlation", 5, float("nan"), "above 0"),
    ]:
        with pytest.raises(jostle.InvalidArgument, match=part):
            swarm.histogram(name, bins=bins, max=longest)
    line = {"kind": "given", "x": [0.0, 3.0], "y": [0.0, 0.0], "alpha": [0.0, 0.0]}
    with pytest.raises(jostle.IncorrectState, match="on one line"):
        create(2, start=line).histogram("pair_correlation")


def test_the_asyncio_form_returns_the_same_histogram(create: Create, daemon: Daemon) -> None:
    swarm = create(12, seed=2)
    edges, values = swarm.histogram("pair_correlation", bins=6, max=4.0)

    async def awaited() -> tuple[np.ndarray, np.ndarray]:
        async with aio.connect(daemon.endpoint) as again:
            return await again.swarm(swarm.name).histogram("pair_correlation", bins=6, max=4.0)

    again = asyncio.run(awaited())
    assert np.array_equal(again[0], edges)
    assert np.array_equal(again[1], values)
    assert edges.shape == (7,)
    assert values.sum() > 0
