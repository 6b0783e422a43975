"""The specifications and states that the cases start from."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from contacts import Body, crossed_pairs
from step import advance, configuration_of

EXACT_CASES = Path(__file__).parent.parent / "cases"
# Two hundred time units at dt = 0.1: several times what crossing takes in a group that crosses.
LONGEST_RUN = 2000
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
    """Returns the default specification with some settings changed."""
    return DEFAULTS | changes


def exact_case(number: int, **changes: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns specification and state of one of the twenty exact cases."""
    (path,) = EXACT_CASES.glob(f"case_{number:02}_*.json")
    known = json.loads(path.read_text())
    params = known["params"]
    spec = specification(**{key: params[key] for key in ("pi1", "pi3", "pi4", "dt")}) | changes
    informed, count = params["informed"], params["n"]
    before = rounded(known["before"], 10)
    before["weight"] = [params["c_p_informed"] / params["c_s"]] * informed + [0.0] * (
        count - informed
    )
    before["direction"] = [math.atan2(*reversed(params["p_pref"]))] * count
    return spec, before


def relaxed(spec: dict[str, Any], before: dict[str, Any], steps: int) -> dict[str, Any]:
    """Returns a state some steps later."""
    for step in range(steps):
        after = advance(spec | {"relinearise": 0}, before, 0, step).configuration
        before = before | dict(zip(("x", "y", "alpha"), after.T.tolist(), strict=True))
    return rounded(before, 8)


def run_until_crossed(spec: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """Returns the state some steps after the first in which axes cross."""
    body = Body.of_aspect_ratio(spec["pi1"])
    for _ in range(LONGEST_RUN):
        before = relaxed(spec, before, 1)
        if crossed_pairs(body, configuration_of(before)):
            return relaxed(spec, before, 3)
    raise ValueError("nobody crossed")


def rounded(before: dict[str, Any], digits: int) -> dict[str, Any]:
    """Cuts digits, which keeps the files short."""
    return before | {
        key: [round(value, digits) for value in before[key]] for key in ("x", "y", "alpha")
    }


def jiggled(before: dict[str, Any]) -> dict[str, Any]:
    """Turns everybody by some thousandths.

    In a group that has settled, bodies lie flat on each other with gaps of zero: which end is
    nearest, and on which side of zero a gap is, are matters of rounding there.
    """
    draws = np.random.Generator(np.random.PCG64(2))
    turned = np.array(before["alpha"]) + draws.uniform(-3e-3, 3e-3, len(before["alpha"]))
    return rounded(before | {"alpha": turned.tolist()}, 6)


def scaled(before: dict[str, Any], factor: float) -> dict[str, Any]:
    """Draws everybody together about the origin."""
    return rounded(
        before | {key: [factor * value for value in before[key]] for key in ("x", "y")}, 10
    )


def group(x: list[float], y: list[float], alpha: list[float]) -> dict[str, Any]:
    """Returns a state of uninformed individuals."""
    return {"x": x, "y": y, "alpha": alpha, "weight": [0.0] * len(x), "direction": [0.0] * len(x)}


def stack(x: list[float], *gaps: float) -> dict[str, Any]:
    """Lays bodies of pi1 = 3 on each other, at these x and gaps; the last gap repeats."""
    width, y = 0.5, [0.0]
    for k in range(len(x) - 1):
        y.append(y[-1] + width + gaps[min(k, len(gaps) - 1)])
    return group(x, y, [0.0] * len(x))


def lattice(ticks: list[float]) -> dict[str, Any]:
    """Returns a square grid of bodies of several headings."""
    places = [(x, y) for y in ticks for x in ticks]
    return group(
        [p[0] for p in places], [p[1] for p in places], [0.7 * k for k in range(len(places))]
    )


def turned_by(angle: float, before: dict[str, Any]) -> dict[str, Any]:
    """Turns the places of a group about the origin, to rounding."""
    cos, sin = math.cos(angle), math.sin(angle)
    places = list(zip(before["x"], before["y"], strict=True))
    turned = [(cos * x - sin * y, sin * x + cos * y) for x, y in places]
    return before | {"x": [place[0] for place in turned], "y": [place[1] for place in turned]}


def scattered(count: int, seed: int) -> dict[str, Any]:
    """Draws a group in which nobody is near enough to touch."""
    draws = np.random.Generator(np.random.PCG64(seed))
    side, places = 2.6 * math.sqrt(count), []
    while len(places) < count:
        place = np.round(draws.uniform(0.0, side, 2), 3)
        if all(np.hypot(*(place - other)) > 2.0 for other in places):
            places.append(place)
    x, y = np.array(places).T.tolist()
    return group(x, y, np.round(draws.uniform(0.0, 2.0 * math.pi, count), 3).tolist())
