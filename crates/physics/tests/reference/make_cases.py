"""Writes `cases/*.json`: single steps for the settings of a step.

Run `python make_cases.py [FOLDER]`. The same versions of the dependencies write the same bytes.
"""

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from attraction import counted_by
from contacts import Body, crossed_pairs
from groups import (
    exact_case,
    group,
    jiggled,
    lattice,
    relaxed,
    run_until_crossed,
    scaled,
    scattered,
    specification,
    stack,
    turned_by,
)
from step import Solution, advance, configuration_of, ids_of, weights_of

HERE = Path(__file__).parent
TOUCHING = 0.0
# 1/64: exact in doubles, and small compared with a radius.
SLIVER = 2.0**-6
# A slack or a multiplier below this may be 0, up to rounding.
CLEAR = 1e-8
# With a smaller least singular value, multipliers would have fewer than ten digits.
INDEPENDENT = 1e-4
# Far below every length of a case and far above its rounding.
NUDGE = 1e-9
# Decimals written. Positions are of order ten: further digits are rounding.
DIGITS = 13


@dataclass
class Case:
    """Input of a case file. An `exact` case depends on ties, which a perturbation would resolve."""

    name: str
    spec: dict[str, Any]
    before: dict[str, Any]
    seed: int = 0
    step: int = 0
    exact: bool = field(default=False, kw_only=True)


def main() -> None:
    """Writes every case, and prints their total size."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    total = 0
    for case in cases():
        solution = advance(case.spec, case.before, case.seed, case.step)
        if not case.exact:
            _check_perturbed(case, solution)
        text = written(case, solution)
        (folder / f"{case.name}.json").write_text(text)
        total += len(text)
    print(f"{total} bytes")


def cases() -> Iterator[Case]:
    """Yields all cases, by subject."""
    yield from closest_in_packed_groups()
    yield from closest_at_ties()
    yield from closest_with_crossed_axes()
    yield from closest_without_normals()
    yield from velocity()
    yield from relinearised()
    yield from attraction_in_random_groups()
    yield from attraction_at_edges()
    yield from attraction_of_coincident_centres()
    yield from noise()


def written(case: Case, solution: Solution) -> str:
    """Returns the text of a case, one line per key."""
    before = configuration_of(case.before)
    entries = {
        "name": case.name,
        "spec": case.spec,
        "seed": case.seed,
        "step": case.step,
        "before": case.before,
        "free": _cut(solution.free),
        "contacts": contact_entries(case.spec, solution),
        "crossed_before": crossed_pairs(Body.of_aspect_ratio(case.spec["pi1"]), before),
        "after": dict(zip(("x", "y", "alpha"), _cut(solution.configuration.T), strict=True)),
    }
    lines = [
        f'"{key}": {json.dumps(value, separators=(",", ":"))}' for key, value in entries.items()
    ]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def contact_entries(spec: dict[str, Any], solution: Solution) -> list[list[float]] | None:
    """Returns the contacts that push, or None if the multipliers are not unique."""
    tight = solution.slacks < CLEAR
    if tight.any():
        scaled = solution.rows[tight] / np.sqrt(weights_of(spec, len(solution.free)))
        if (
            len(scaled) > scaled.shape[1]
            or np.linalg.svd(scaled, compute_uv=False)[-1] < INDEPENDENT
        ):
            return None
        # A tight contact without a clear multiplier may push in another implementation.
        if solution.multipliers[tight].min() < CLEAR:
            return None
    return [
        [c.i, c.j, c.code, *_cut([c.gap, *c.normal_i_to_j, c.lever_i, c.lever_j, multiplier])]
        for c, multiplier in zip(solution.contacts, solution.multipliers, strict=True)
        if multiplier > 0.0
    ]


def closest_in_packed_groups() -> Iterator[Case]:
    """Groups settled under `endpoints`, and groups that overlap or cross under `closest`."""
    for number, pi1 in ((4, "1.5"), (10, "3"), (13, "4"), (17, "8")):
        spec, before = exact_case(number, contacts="closest")
        yield Case(f"closest_packed_pi{pi1}_n{len(before['x'])}", spec, jiggled(before))
    spec, before = exact_case(1, contacts="closest")
    yield Case("closest_discs_packed", spec, before)
    yield Case("closest_discs_overlapping", spec, scaled(before, 0.97))
    for number, steps in ((7, 40), (12, 60)):
        spec, before = exact_case(number, contacts="closest", dt=0.1)
        name = f"closest_relaxed_pi{spec['pi1']:g}_n{len(before['x'])}_after_{steps}"
        yield Case(name, spec, relaxed(spec, jiggled(before), steps))
    for number in (14, 17, 18):
        spec, before = exact_case(number, contacts="closest", dt=0.1)
        name = f"closest_run_until_crossed_pi{spec['pi1']:g}_n{len(before['x'])}"
        yield Case(name, spec, run_until_crossed(spec, jiggled(before)))


def closest_at_ties() -> Iterator[Case]:
    """Parallel bodies with two equal gaps: the lower code is kept."""
    spec = specification(pi1=3.0, contacts="closest")
    for word, gap in (("touching", TOUCHING), ("overlapping", -SLIVER), ("apart", SLIVER / 8)):
        yield Case(f"closest_tie_shifted_{word}", spec, stack([0.0, 0.25], gap), exact=True)
    yield Case("closest_tie_shifted_back", spec, stack([0.25, 0.0], TOUCHING), exact=True)
    yield Case("closest_tie_flush", spec, stack([0.0, 0.0], -SLIVER), exact=True)
    yield Case(
        "closest_tie_stack_of_four", spec, stack([0.0, 0.25, -0.125, 0.125], -SLIVER), exact=True
    )
    yield Case(
        "closest_tie_end_to_end",
        spec,
        group([0.0, 1.5 - SLIVER], [0.0, 0.0], [0.0, 0.0]),
        exact=True,
    )


def closest_with_crossed_axes() -> Iterator[Case]:
    """Crossed pairs: the nearest end is a contact, whose gradient may point the wrong way."""
    spec = specification(contacts="closest")
    near_an_end = group([0.0, 0.38], [0.0, 0.5], [0.1, 1.3])
    yield Case("closest_crossed_overlap", spec, near_an_end)
    slim = specification(pi1=8.0, contacts="closest")
    yield Case("closest_crossed_positive_gap", slim, group([0.0, 0.1], [0.0, 0.52], [0.0, 1.3]))
    yield Case("closest_crossed_out_of_reach", slim, group([0.0, 0.05], [0.0, 0.03], [0.1, 1.6]))
    three = group([0.0, 0.3, -0.35], [0.0, 0.45, 0.3], [0.1, 1.3, 2.2])
    yield Case("closest_crossed_beside_a_third", spec, three)
    yield Case("closest_crossed_relinearised", spec | {"relinearise": 1}, three)
    yield Case("closest_crossed_velocity", spec | {"stepping": "velocity"}, three)


def closest_without_normals() -> Iterator[Case]:
    """Contacts with two coincident points: they are left out."""
    spec = specification(pi1=3.0, contacts="closest")
    yield Case(
        "closest_axes_in_one_line",
        spec,
        group([0.0, 0.25, 2.5], [0.0, 0.0, 0.5], [0.0, 0.0, 2.0]),
        exact=True,
    )
    yield Case("closest_end_on_end", spec, group([0.0, 1.0], [0.0, 0.0], [0.0, 0.0]), exact=True)
    discs = specification(pi1=1.0, contacts="closest")
    yield Case(
        "closest_discs_in_one_place",
        discs,
        group([0.0, 0.0, 0.75], [0.0, 0.0, 0.5], [0.0, 1.0, 3.0]),
        exact=True,
    )


def velocity() -> Iterator[Case]:
    """Contacts with a gap of at most 0 constrain velocities as if it were 0; others do not."""
    for rule in ("endpoints", "closest"):
        spec = specification(pi1=3.0, contacts=rule, stepping="velocity")
        for word, gap in (("touching", TOUCHING), ("overlapping", -SLIVER), ("apart", 2.0**-12)):
            yield Case(f"velocity_{rule}_{word}", spec, stack([0.0, 0.25], gap), exact=True)
        mixed = stack([0.0, 0.25, -0.125, 0.125], TOUCHING, -SLIVER, 2.0**-12)
        yield Case(f"velocity_{rule}_mixed_stack", spec, mixed, exact=True)
        for number in (12, 17):
            spec, before = exact_case(number, contacts=rule, stepping="velocity")
            yield Case(f"velocity_{rule}_packed_pi{spec['pi1']:g}", spec, jiggled(before))
    discs = specification(pi1=1.0, stepping="velocity")
    yield Case(
        "velocity_discs_head_on", discs, group([0.0, 1.0], [0.0, 0.0], [0.0, math.pi]), exact=True
    )


def relinearised() -> Iterator[Case]:
    """A second QP, linearised about the state that the first one predicts."""
    for number in (12, 17):
        for rule in ("endpoints", "closest"):
            spec, before = exact_case(number, contacts=rule, relinearise=1, dt=0.05)
            yield Case(
                f"relinearise_{rule}_pi{spec['pi1']:g}_n{len(before['x'])}", spec, jiggled(before)
            )
    discs, before = exact_case(1, relinearise=1, dt=0.05)
    yield Case("relinearise_discs", discs, before)


def attraction_in_random_groups() -> Iterator[Case]:
    """Every law without ties: scattered groups without contacts, and packed groups."""
    laws = {
        "all": {"kind": "all"},
        "voronoi": {"kind": "voronoi"},
        "metric": {"kind": "metric", "radius": 5.0},
        "topological": {"kind": "topological", "neighbours": 6},
        "power_minus_1": {"kind": "power", "exponent": -1.0},
        "power_0": {"kind": "power", "exponent": 0.0},
        "power_2": {"kind": "power", "exponent": 2.0},
    }
    for name, law in laws.items():
        yield Case(f"attraction_{name}_scattered", specification(attraction=law), scattered(9, 11))
    yield Case(
        "attraction_voronoi_scattered_n50",
        specification(attraction=laws["voronoi"]),
        scattered(50, 12),
    )
    for name in ("voronoi", "topological", "power_2"):
        # The squares of distances would make all individuals turn many times as fast.
        spec, before = exact_case(12, attraction=laws[name], pi3=0.05 if name == "power_2" else 1.0)
        yield Case(f"attraction_{name}_cluster", spec, before)


def attraction_at_edges() -> Iterator[Case]:
    """Few individuals, and ties that are exact in doubles."""
    laws = edge_laws()
    alone, two = group([0.5], [0.25], [0.4]), group([0.0, 3.0], [0.0, 1.0], [0.4, 2.5])
    for law in laws:
        yield Case(f"attraction_{law['kind']}_n1", specification(attraction=law), alone, exact=True)
        yield Case(f"attraction_{law['kind']}_n2", specification(attraction=law), two, exact=True)
    voronoi = specification(attraction={"kind": "voronoi"})
    along = [0.0, 8.0, 2.0, 12.0, 5.0]
    turned = [0.3, 1.1, 2.9, -0.7, 4.0]
    yield Case(
        "attraction_voronoi_collinear",
        voronoi,
        group(along, [0.5 * x for x in along], turned),
        exact=True,
    )
    yield Case(
        "attraction_voronoi_collinear_upright", voronoi, group([1.0] * 5, along, turned), exact=True
    )
    yield Case(
        "attraction_voronoi_three", voronoi, group([0.0, 3.0, 1.0], [0.0, 0.5, 4.0], turned[:3])
    )
    grid = lattice([0.0, 2.0, 4.0])
    yield Case("attraction_voronoi_grid", voronoi, grid, exact=True)
    # After a rotation the four sites of a cell are not exactly cocircular: the last bits of the
    # coordinates determine which diagonals are neighbours.
    turned_grid = turned_by(0.3, lattice([0.0, 2.0, 4.0]))
    yield Case("attraction_voronoi_grid_not_quite", voronoi, turned_grid, exact=True)
    octagon = [(5, 0), (4, 3), (0, 5), (-3, 4), (-5, 0), (-4, -3), (3, -4), (0, -5)]
    circle = group(
        [p[0] * 1.0 for p in octagon], [p[1] * 1.0 for p in octagon], [0.7 * k for k in range(8)]
    )
    yield Case("attraction_voronoi_common_circle", voronoi, circle, exact=True)
    yield Case(
        "attraction_metric_at_the_radius",
        specification(attraction={"kind": "metric", "radius": 2.5}),
        group([0.0, 1.5, -2.0, 2.5, 0.0], [0.0, 2.0, -1.5, 0.0, -2.5 - 2.0**-40], turned),
        exact=True,
    )
    yield Case(
        "attraction_metric_none_inside",
        specification(attraction={"kind": "metric", "radius": 1.5}),
        grid,
        exact=True,
    )
    for neighbours in (1, 2, 3, 5):
        law = {"kind": "topological", "neighbours": neighbours}
        named = {"id": [2, 3, 5, 8, 13, 21, 34, 55, 89], **grid}
        yield Case(
            f"attraction_topological_ties_{neighbours}",
            specification(attraction=law),
            named,
            exact=True,
        )
    law = {"kind": "topological", "neighbours": 40}
    yield Case(
        "attraction_topological_more_than_there_are",
        specification(attraction=law),
        scattered(5, 13),
    )


def attraction_of_coincident_centres() -> Iterator[Case]:
    """Coincident individuals are counted and contribute 0; coincident discs have no contact."""
    points = [(0.0, 0.0), (3.0, 1.0), (0.0, 0.0), (-2.0, 3.0), (3.0, 1.0), (3.0, 1.0), (5.0, 5.0)]
    before = group([p[0] for p in points], [p[1] for p in points], [0.9 * k for k in range(7)])
    for law in edge_laws():
        spec = specification(pi1=1.0, contacts="closest", attraction=law)
        yield Case(f"attraction_{law['kind']}_coincident", spec, before, exact=True)
    pair = group([0.5, 0.5], [0.25, 0.25], [0.0, 2.0])
    for law in edge_laws():
        spec = specification(pi1=1.0, contacts="closest", attraction=law)
        yield Case(f"attraction_{law['kind']}_all_in_one_place", spec, pair, exact=True)


def noise() -> Iterator[Case]:
    """Noise by seed, step and id, alone and with informed individuals and contacts."""
    before = scattered(4, 14)
    noisy = specification(noise=0.1)
    yield Case("noise_seed_0_step_0", noisy, before, 0, 0)
    yield Case("noise_seed_0_step_1", noisy, before, 0, 1)
    yield Case("noise_seed_7_step_123456", noisy, before, 7, 123456)
    yield Case("noise_largest_seed", noisy, before, 2**64 - 1, 2**40 + 3)
    yield Case(
        "noise_ids_with_holes",
        noisy | {"dt": 0.05, "noise": 2.0},
        {"id": [0, 3, 17, 4000000000], **before},
        7,
        9,
    )
    informed = before | {"weight": [0.5, 0.0, 2.0, 0.25], "direction": [0.3, 0.0, -2.0, 9.0]}
    yield Case("informed_scattered", specification(pi3=0.7), informed)
    yield Case("informed_with_noise", noisy | {"pi3": 0.7}, {"id": [1, 2, 6, 9], **informed}, 3, 77)
    spec, packed = exact_case(13, noise=0.3)
    yield Case("informed_with_noise_packed", spec, packed, 5, 1000)
    spec, packed = exact_case(
        13, noise=0.3, contacts="closest", attraction={"kind": "voronoi"}, relinearise=1
    )
    named = {"id": list(range(5, 25, 2)), **jiggled(packed)}
    yield Case("everything_at_once", spec, named, 5, 1000)


def edge_laws() -> list[dict[str, Any]]:
    """Returns each law once, with parameters that affect small groups."""
    return [
        {"kind": "all"},
        {"kind": "voronoi"},
        {"kind": "metric", "radius": 4.0},
        {"kind": "topological", "neighbours": 2},
        {"kind": "power", "exponent": -1.0},
    ]


def _cut(values: Any) -> list:
    return np.round(values, DIGITS).tolist()


def _check_perturbed(case: Case, solution: Solution) -> None:
    """Raises ValueError if a perturbation of NUDGE changes neighbours, contacts or the result."""
    draws = np.random.Generator(np.random.PCG64(1))
    nudged = dict(case.before)
    for key in ("x", "y", "alpha"):
        nudged[key] = (
            np.array(nudged[key]) + draws.uniform(-NUDGE, NUDGE, len(nudged[key]))
        ).tolist()
    law = case.spec["attraction"]
    counted = [
        counted_by(law, ids_of(state), state["x"], state["y"]) for state in (case.before, nudged)
    ]
    other = advance(case.spec, nudged, case.seed, case.step)
    moved = np.abs(other.configuration - solution.configuration).max()
    listed = [[(c.i, c.j, c.code) for c in found.contacts] for found in (solution, other)]
    if counted[0] != counted[1] or listed[0] != listed[1] or moved > 1e3 * NUDGE:
        raise ValueError(f"{case.name} depends on a tie: a perturbation moves it by {moved}")


if __name__ == "__main__":
    main()
