"""Measures of recorded states by freud and movement: writes `measures.json` beside this file.

python measures.py            # with jostle, jostled, freud-analysis and movement installed
python measures.py --check    # recomputes the values of the states in the file, and compares
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import freud
import numpy as np
import xarray as xr
from movement.kinematics import compute_pairwise_distances

FIXTURE = Path(__file__).with_name("measures.json")

SIDE = 4096.0
"""The side of freud's periodic box, so large that no image of a group is near it."""

BINS, MAX = 40, 6.0

RADIUS = 1.0
"""Discs of pi1 = 1 have this diameter: their gap is the distance of the centres minus 1."""


def by_freud(state: dict[str, Any]) -> dict[str, Any]:
    alpha = np.array(state["alpha"])
    points = np.column_stack([state["x"], state["y"], np.zeros(len(alpha))])
    points = points - points.mean(axis=0)
    box = freud.box.Box.square(SIDE)
    # A nematic tensor of directors in the plane has the eigenvalues (1 + 3 S)/4, (1 - 3 S)/4 and
    # -1/2; freud's order is the largest one.
    directors = np.column_stack([np.cos(alpha), np.sin(alpha), np.zeros(len(alpha))])
    nematic = freud.order.Nematic()
    nematic.compute(directors)
    rdf = freud.density.RDF(bins=BINS, r_max=MAX, normalization_mode="exact")
    rdf.compute((box, points))
    found: dict[str, Any] = {
        "nematic": (4 * float(nematic.order) - 1) / 3,
        "pairs": [int(count) for count in rdf.bin_counts],
        "rdf": [float(value) for value in rdf.rdf],
    }
    if state["pi1"] == 1:
        cluster = freud.cluster.Cluster()
        cluster.compute((box, points), neighbors={"r_max": RADIUS + 0.3, "exclude_ii": True})
        sizes = np.bincount(cluster.cluster_idx)
        found |= {
            "clusters.count(0.3)": int(cluster.num_clusters),
            "clusters.largest(0.3)": int(sizes.max()),
        }
    return found


def by_movement(state: dict[str, Any]) -> dict[str, Any]:
    # movement 0.15 has distances and no polarization.
    n = len(state["alpha"])
    position = np.array([state["x"], state["y"]])
    names = [str(k) for k in range(n)]
    centres = xr.DataArray(
        position[None, :, :, None],
        dims=("time", "space", "individuals", "keypoints"),
        coords={
            "time": [0],
            "space": ["x", "y"],
            "individuals": names,
            "keypoints": ["centroid"],
        },
    )
    distances = compute_pairwise_distances(centres, "individuals", "all")
    nearest = np.full(n, np.inf)
    for key, distance in distances.items():
        for one in map(int, key.removeprefix("dist_").split("_")):
            nearest[one] = min(nearest[one], float(distance.squeeze()))
    return {
        "neighbour_distance.median": float(np.median(nearest)),
        "neighbour_distance.q05": float(np.quantile(nearest, 0.05)),
        "neighbour_distance.q95": float(np.quantile(nearest, 0.95)),
    }


def states() -> list[dict[str, Any]]:
    import jostle

    found = []
    with jostle.local() as client:
        for k, (n, pi1, steps) in enumerate([(40, 4.0, 300), (60, 1.0, 200), (25, 8.0, 20)]):
            swarm = client.create(f"oracle-{k}", {"n": n, "pi1": pi1, "seed": 7 + k})
            swarm.step(steps)
            state = swarm.state()
            columns = {name: getattr(state, name).tolist() for name in ("x", "y", "alpha")}
            found.append({"pi1": pi1, **columns})
            swarm.delete()
    return found


def main() -> int:
    is_check = "--check" in sys.argv
    before = json.loads(FIXTURE.read_text()) if is_check else None
    of = [it["state"] for it in before["states"]] if before else states()
    rows = [{"state": it, "freud": by_freud(it), "movement": by_movement(it)} for it in of]
    versions = {name: version(name) for name in ("freud-analysis", "movement", "numpy")}
    document = {
        "script": "clients/python/tests/oracles/measures.py",
        "versions": versions,
        "bins": BINS,
        "max": MAX,
        "side": SIDE,
        "states": rows,
    }
    if before is None:
        FIXTURE.write_text(json.dumps(document) + "\n")
        return 0
    for old, new in zip(before["states"], rows, strict=True):
        for tool in ("freud", "movement"):
            assert old[tool].keys() == new[tool].keys()
            for name, value in new[tool].items():
                np.testing.assert_allclose(value, old[tool][name], rtol=1e-6, err_msg=name)
    print(f"freud and movement give the values of {FIXTURE.name}: {versions}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
