"""The five laws of attraction of the model.

A law counts some of the other individuals and returns the mean of their contributions. The choice
is made in rational arithmetic on the exact values of the doubles, so that no tie depends on
rounding.
"""

import math
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np

Point = tuple[Fraction, Fraction]


def pulls(law: dict[str, Any], ids: list[int], x: list[float], y: list[float]) -> np.ndarray:
    """Returns the social pull `p_s` of every individual, n rows of two."""
    exponent = float(law["exponent"]) if law["kind"] == "power" else 0.0
    return np.array(
        [
            _mean_pull(i, counted, x, y, exponent)
            for i, counted in enumerate(counted_by(law, ids, x, y))
        ]
    ).reshape(-1, 2)


def counted_by(
    law: dict[str, Any], ids: list[int], x: list[float], y: list[float]
) -> list[list[int]]:
    """Returns, per individual, the ascending indices of the individuals that its law counts."""
    points = [(Fraction(a), Fraction(b)) for a, b in zip(x, y, strict=True)]
    indices = range(len(points))
    others = [[j for j in indices if j != i] for i in indices]
    match law["kind"]:
        case "all" | "power":
            return others
        case "metric":
            reach = Fraction(law["radius"]) ** 2
            return [
                [j for j in others[i] if _squared(points[i], points[j]) <= reach] for i in indices
            ]
        case "topological":
            return [
                sorted(
                    sorted(others[i], key=lambda j: (_squared(points[i], points[j]), ids[j]))[
                        : law["neighbours"]
                    ]
                )
                for i in indices
            ]
        case "voronoi":
            return _voronoi(points, others)
        case kind:
            raise ValueError(f"unknown law of attraction {kind!r}")


def share_an_edge(a: Point, b: Point, sites: list[Point]) -> bool:
    """Returns whether the Voronoi cells of `a` and `b` share an edge of positive length.

    The points at equal distance from both are p(t) = (a + b)/2 + t perp(b - a). Another site c
    restricts them to those that are not nearer to c: with a as the origin,
    |c|^2 - b.c - 2 t (b x c) >= 0. This is a half-line in t; if b x c = 0 it is the whole line or
    empty. The edge is the intersection over all c.
    """
    along = _minus(b, a)
    low, high = None, None
    for site in sites:
        if site in (a, b):
            continue
        to_site = _minus(site, a)
        room = _dot(to_site, to_site) - _dot(along, to_site)
        turn = 2 * (along[0] * to_site[1] - along[1] * to_site[0])
        if turn == 0 and room < 0:
            return False
        if turn > 0:
            high = room / turn if high is None else min(high, room / turn)
        if turn < 0:
            low = room / turn if low is None else max(low, room / turn)
    return low is None or high is None or low < high


def _voronoi(points: list[Point], others: list[list[int]]) -> list[list[int]]:
    # Individuals at the same point share one site and are neighbours of each other.
    sites = sorted(set(points))
    neighbours = {(site, site) for site in sites}
    for a, b in combinations(sites, 2):
        if share_an_edge(a, b, sites):
            neighbours |= {(a, b), (b, a)}
    return [
        [j for j in others[i] if (points[i], points[j]) in neighbours] for i in range(len(points))
    ]


def _mean_pull(
    i: int, counted: list[int], x: list[float], y: list[float], exponent: float
) -> tuple[float, float]:
    if not counted:
        return 0.0, 0.0
    parts = [_pull(x[j] - x[i], y[j] - y[i], exponent) for j in counted]
    return tuple(math.fsum(part[axis] for part in parts) / len(counted) for axis in (0, 1))


def _pull(dx: float, dy: float, exponent: float) -> tuple[float, float]:
    distance = math.hypot(dx, dy)
    # A coincident centre has no direction: for every exponent it is counted and contributes 0.
    if distance == 0.0:
        return 0.0, 0.0
    weight = distance**exponent
    return weight * dx / distance, weight * dy / distance


def _squared(a: Point, b: Point) -> Fraction:
    apart = _minus(b, a)
    return _dot(apart, apart)


def _minus(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1]


def _dot(a: Point, b: Point) -> Fraction:
    return a[0] * b[0] + a[1] * b[1]
