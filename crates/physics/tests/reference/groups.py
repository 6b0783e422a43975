"""Specifications and initial states of the cases."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from contacts import Body, crossed_pairs
from step import advance, configuration_of

EXACT_CASES = Path(__file__).parent.parent / "cases"
# Steps: 200 time units at dt = 0.1, several times what a group needs until axes cross.
MAX_STEPS = 2000
DEFAULTS: dict[str, Any] = {
    "pi1": 4.0,
    "pi3": 1.0,
    "pi4": 10.0,
    "dt": 0.02,
    "contacts": "endpoints",
    "stepping": "position",
    "relinearise": 0,
    "attraction": {"kind": "all"},
    "noise": 0.0,
}


def specification(**changes: Any) -> dict[str, Any]:
    """Returns the default specification with `changes`."""
    return DEFAULTS | changes


def exact_case(number: int, **changes: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns specification and state of one of the twenty exact cases."""
    (path,) = EXACT_CASES.glob(f"case_{number:02}_*.json")
    case = json.loads(path.read_text())
    params = case["params"]
    spec = specification(**{key: params[key] for key in ("pi1", "pi3", "pi4", "dt")}) | changes
    informed, count = params["informed"], params["n"]
    before = rounded(case["before"], 10)
    before["weight"] = [params["c_p_informed"] / params["c_s"]] * informed + [0.0] * (
        count - informed
    )
    before["direction"] = [math.atan2(*reversed(params["p_pref"]))] * count
    return spec, before


def relaxed(spec: dict[str, Any], before: dict[str, Any], steps: int) -> dict[str, Any]:
    """Returns the state `steps` steps later, computed without `relinearise`."""
    for step in range(steps):
        after = advance(spec | {"relinearise": 0}, before, 0, step).configuration
        before = before | dict(zip(("x", "y", "alpha"), after.T.tolist(), strict=True))
    return rounded(before, 8)


def run_until_crossed(spec: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """Returns the state three steps after the first state with crossed axes."""
    body = Body.of_aspect_ratio(spec["pi1"])
    for _ in range(MAX_STEPS):
        before = relaxed(spec, before, 1)
        if crossed_pairs(body, configuration_of(before)):
            return relaxed(spec, before, 3)
    raise ValueError(f"no axes cross within {MAX_STEPS} steps")


def rounded(before: dict[str, Any], digits: int) -> dict[str, Any]:
    """Rounds positions and angles to `digits` decimals, which keeps the files short."""
    return before | {
        key: [round(value, digits) for value in before[key]] for key in ("x", "y", "alpha")
    }


def jiggled(before: dict[str, Any]) -> dict[str, Any]:
    """Turns each individual by up to 0.003 rad.

    In a settled group bodies are flush with gaps of 0: the nearest end and the sign of a gap would
    depend on rounding.
    """
    draws = np.random.Generator(np.random.PCG64(2))
    turned = np.array(before["alpha"]) + draws.uniform(-3e-3, 3e-3, len(before["alpha"]))
    return rounded(before | {"alpha": turned.tolist()}, 6)


def scaled(before: dict[str, Any], factor: float) -> dict[str, Any]:
    """Scales the positions about the origin by `factor`."""
    return rounded(
        before | {key: [factor * value for value in before[key]] for key in ("x", "y")}, 10
    )


def group(x: list[float], y: list[float], alpha: list[float]) -> dict[str, Any]:
    """Returns a state of uninformed individuals."""
    return {"x": x, "y": y, "alpha": alpha, "weight": [0.0] * len(x), "direction": [0.0] * len(x)}


def stack(x: list[float], *gaps: float) -> dict[str, Any]:
    """Returns a stack of parallel bodies of pi1 = 3 with given x and gaps; the last gap repeats."""
    width, y = 0.5, [0.0]
    for k in range(len(x) - 1):
        y.append(y[-1] + width + gaps[min(k, len(gaps) - 1)])
    return group(x, y, [0.0] * len(x))


def lattice(ticks: list[float]) -> dict[str, Any]:
    """Returns a square grid of bodies with different headings."""
    points = [(x, y) for y in ticks for x in ticks]
    return group(
        [p[0] for p in points], [p[1] for p in points], [0.7 * k for k in range(len(points))]
    )


def turned_by(angle: float, before: dict[str, Any]) -> dict[str, Any]:
    """Rotates the positions of a group about the origin, up to rounding."""
    cos, sin = math.cos(angle), math.sin(angle)
    points = list(zip(before["x"], before["y"], strict=True))
    turned = [(cos * x - sin * y, sin * x + cos * y) for x, y in points]
    return before | {"x": [point[0] for point in turned], "y": [point[1] for point in turned]}


def scattered(count: int, seed: int) -> dict[str, Any]:
    """Draws a group without contacts: all distances exceed 2."""
    draws = np.random.Generator(np.random.PCG64(seed))
    side, points = 2.6 * math.sqrt(count), []
    while len(points) < count:
        point = np.round(draws.uniform(0.0, side, 2), 3)
        if all(np.hypot(*(point - other)) > 2.0 for other in points):
            points.append(point)
    x, y = np.array(points).T.tolist()
    return group(x, y, np.round(draws.uniform(0.0, 2.0 * math.pi, count), 3).tolist())
