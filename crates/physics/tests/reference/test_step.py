"""Checks the reference implementation, and that it reproduces the committed cases."""

import json
import math
from fractions import Fraction
from itertools import combinations, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stream
from attraction import counted_by
from contacts import Body, pair_contacts
from step import CrossedBodies, advance, configuration_of, weights_of

HERE = Path(__file__).parent
CASES = sorted((HERE / "cases").glob("*.json"))
EXACT_CASES = sorted((HERE.parent / "cases").glob("*.json"))
EXACT_CONTACTS = "contacts_i_j_code_gap_nx_ny_ri_rj_lambda"
# A contact pushes if its multiplier is above this; below, a multiplier is rounding.
PUSHES = 1e-12
GOLDEN = [
    0x9174D24963FF5496,
    0xA26288986641C63B,
    0x172A9C7C8A003333,
    0x282B3E4698C9F2F3,
    0x5A3E68C4557F08AF,
    0x4DE628D792F90548,
    0x5614992B972E91B3,
    0xE7FE0C946A331B94,
    0xFA167FFB6020A977,
]


def test_the_streams_are_those_of_the_model() -> None:
    assert list(islice(stream.bits(1, 2, 3, 1), 9)) == GOLDEN
    assert stream.keystream_block(bytes(32), 0)[:8].hex() == "3e00ef2f895f40d6"


def test_noise_is_standard_normal() -> None:
    draws = np.array([stream.standard_normal(5, step, 3) for step in range(4000)])
    assert abs(draws.mean()) < 6 / math.sqrt(4000)
    assert abs(draws.var() - 1) < 6 * math.sqrt(2 / 4000)


@pytest.mark.parametrize("path", EXACT_CASES, ids=lambda path: path.stem)
def test_the_exact_cases_are_reproduced(path: Path) -> None:
    case = json.loads(path.read_text())
    params = case["params"]
    count, informed = params["n"], params["informed"]
    spec = {key: params[key] for key in ("pi1", "pi3", "pi4", "dt")} | {
        "contacts": "endpoints",
        "stepping": "position",
        "relinearise": 0,
        "attraction": {"kind": "all"},
        "noise": 0.0,
    }
    weight = params["c_p_informed"] / params["c_s"]
    before = case["before"] | {
        "weight": [weight] * informed + [0.0] * (count - informed),
        "direction": [math.atan2(*reversed(params["p_pref"]))] * count,
    }
    solution = advance(spec, before, 0, 0)
    after = configuration_of(case["after_exact"])
    np.testing.assert_allclose(solution.configuration, after, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        solution.free.ravel(), case["unconstrained_displacement"], rtol=0, atol=1e-15
    )
    expected = {tuple(entry[:3]): entry[3:] for entry in case[EXACT_CONTACTS] if entry[8] > PUSHES}
    found = {
        (c.i, c.j, c.code): [c.gap, *c.normal_i_to_j, c.lever_i, c.lever_j, multiplier]
        for c, multiplier in zip(solution.contacts, solution.multipliers, strict=True)
        if multiplier > PUSHES
    }
    # The multipliers of packed discs are not unique: compare only the motion.
    if params["pi1"] > 1.0:
        assert found.keys() == expected.keys()
        for identity, entry in found.items():
            np.testing.assert_allclose(entry, expected[identity], rtol=0, atol=1e-9)


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_committed_cases_are_reproduced(path: Path) -> None:
    case = json.loads(path.read_text())
    assert case["name"] == path.stem
    solution = advance(case["spec"], case["before"], case["seed"], case["step"])
    after = configuration_of(case["after"])
    np.testing.assert_allclose(solution.configuration, after, rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.free, case["free"], rtol=0, atol=1e-12)
    if case["contacts"] is not None:
        pushing = [
            [c.i, c.j, c.code, c.gap, *c.normal_i_to_j, c.lever_i, c.lever_j, multiplier]
            for c, multiplier in zip(solution.contacts, solution.multipliers, strict=True)
            if multiplier > 0.0
        ]
        assert [entry[:3] for entry in pushing] == [entry[:3] for entry in case["contacts"]]
        np.testing.assert_allclose(
            np.array(pushing).ravel(), np.array(case["contacts"]).ravel(), rtol=0, atol=1e-10
        )


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_solution_is_optimal(path: Path) -> None:
    case = json.loads(path.read_text())
    before = configuration_of(case["before"])
    solution = advance(case["spec"], case["before"], case["seed"], case["step"])
    pushed = (solution.configuration - before - solution.free).ravel()
    weights = weights_of(case["spec"], len(before))
    force = solution.rows.T @ solution.multipliers
    np.testing.assert_allclose(weights * pushed, force, rtol=0, atol=1e-12)
    residual = np.abs(np.minimum(solution.multipliers, solution.slacks)).max(initial=0.0)
    assert residual <= 1e-12


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_contacts_of_a_file_explain_its_motion(path: Path) -> None:
    case = json.loads(path.read_text())
    if case["contacts"] is None:
        pytest.skip("multipliers are not unique")
    before = configuration_of(case["before"])
    moved = before + np.array(case["free"])
    for i, j, _, _, *normal, lever_i, lever_j, multiplier in case["contacts"]:
        turn = multiplier * case["spec"]["pi4"]
        moved[i] += [-multiplier * normal[0], -multiplier * normal[1], -turn * lever_i]
        moved[j] += [multiplier * normal[0], multiplier * normal[1], turn * lever_j]
    np.testing.assert_allclose(moved, configuration_of(case["after"]), rtol=0, atol=1e-11)


def test_gradients_are_the_slopes_of_gaps() -> None:
    body, nudge, compared = Body.of_aspect_ratio(4.0), 1e-6, 0
    draws = np.random.Generator(np.random.PCG64(3))
    for _ in range(200):
        pair = draws.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 6.0], (2, 3))
        direction = draws.uniform(-1.0, 1.0, (2, 3))
        here, ahead, behind = (
            {c.code: c for c in pair_contacts(body, pair + sign * nudge * direction, 0, 1)}
            for sign in (0, 1, -1)
        )
        for code in here.keys() & ahead.keys() & behind.keys():
            slope = (ahead[code].gap - behind[code].gap) / (2 * nudge)
            assert slope == pytest.approx(here[code].row(2) @ direction.ravel(), abs=1e-6)
            compared += 1
    assert compared > 400


def test_the_nearest_end_is_always_listed() -> None:
    body = Body.of_aspect_ratio(4.0)
    draws = np.random.Generator(np.random.PCG64(4))
    for _ in range(300):
        pair = draws.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 6.0], (2, 3))
        listed = min(contact.gap for contact in pair_contacts(body, pair, 0, 1))
        distances = [
            _distance(body, pair[a], pair[b], sign) for a, b in ((0, 1), (1, 0)) for sign in (1, -1)
        ]
        assert listed == pytest.approx(min(distances) - 2 * body.radius, abs=1e-12)


def test_crossed_bodies_are_a_fault_under_endpoints() -> None:
    case = json.loads((HERE / "cases" / "closest_crossed_overlap.json").read_text())
    with pytest.raises(CrossedBodies):
        advance(case["spec"] | {"contacts": "endpoints"}, case["before"], 0, 0)


def test_voronoi_neighbours_have_an_empty_circle() -> None:
    draws = np.random.Generator(np.random.PCG64(5))
    for count in (3, 5, 9):
        x, y = draws.uniform(0.0, 5.0, (2, count)).tolist()
        found = counted_by({"kind": "voronoi"}, list(range(count)), x, y)
        pairs = {(i, j) for i in range(count) for j in found[i] if i < j}
        assert pairs == _delaunay_edges(x, y)


@pytest.mark.parametrize("other", ["power_0", "all"])
def test_a_power_of_zero_is_all(other: str) -> None:
    case = json.loads((HERE / "cases" / f"attraction_{other}_scattered.json").read_text())
    power = {"kind": "power", "exponent": 0.0}
    solution = advance(case["spec"] | {"attraction": power}, case["before"], 0, 0)
    np.testing.assert_allclose(solution.free, case["free"], rtol=0, atol=1e-13)


def _distance(body: Body, end_of: np.ndarray, other: np.ndarray, sign: int) -> float:
    """Returns the distance of an end of one axis (sign 1: head) from the other axis."""
    heading = np.array([math.cos(end_of[2]), math.sin(end_of[2])])
    end = end_of[:2] + sign * body.half_length * heading
    along = np.array([math.cos(other[2]), math.sin(other[2])])
    nearest = np.clip((end - other[:2]) @ along, -body.half_length, body.half_length)
    return float(np.linalg.norm(end - other[:2] - nearest * along))


def _delaunay_edges(x: list[float], y: list[float]) -> set[tuple[int, int]]:
    """Returns the edges of all triangles with an empty circumcircle; points in general position."""
    points = [(Fraction(a), Fraction(b)) for a, b in zip(x, y, strict=True)]
    edges: set[tuple[int, int]] = set()
    for corners in combinations(range(len(points)), 3):
        others = [k for k in range(len(points)) if k not in corners]
        if all(_in_circle(*(points[k] for k in corners), points[other]) < 0 for other in others):
            edges |= set(combinations(corners, 2))
    return edges


def _in_circle(a: Any, b: Any, c: Any, point: Any) -> Fraction:
    """Returns a number that is positive inside the circle through a, b, c, in any orientation."""
    rows = [(p[0] - point[0], p[1] - point[1]) for p in (a, b, c)]
    lifted = [(u, v, u * u + v * v) for u, v in rows]
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = lifted
    determinant = a0 * (b1 * c2 - b2 * c1) - a1 * (b0 * c2 - b2 * c0) + a2 * (b0 * c1 - b1 * c0)
    turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return determinant if turn > 0 else -determinant
