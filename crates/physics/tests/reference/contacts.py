"""Contacts of pairs of bodies, under the contact rules `endpoints` and `closest`."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

HEAD, TAIL = 0, 1


@dataclass(frozen=True)
class Body:
    """A segment of length 2 * half_length, swept by a disc."""

    half_length: float
    radius: float

    @classmethod
    def of_aspect_ratio(cls, pi1: float) -> "Body":
        """Returns the body of size s = 1 with length over width `pi1`."""
        p = pi1 - 1.0
        radius = 1.0 / (2.0 + p)
        return cls(half_length=p * radius, radius=radius)


@dataclass(frozen=True)
class Contact:
    """One constraint of a pair i < j, in the terms of `tests/cases/README.md`."""

    i: int
    j: int
    code: int
    gap: float
    normal_i_to_j: np.ndarray
    lever_i: float
    lever_j: float

    def row(self, count: int) -> np.ndarray:
        """Returns the gradient of the gap by (x, y, alpha) of all individuals, 3 n numbers."""
        row = np.zeros((count, 3))
        row[self.i] = [*-self.normal_i_to_j, -self.lever_i]
        row[self.j] = [*self.normal_i_to_j, self.lever_j]
        return row.ravel()


def find_contacts(rule: str, body: Body, configuration: np.ndarray, reach: float) -> list[Contact]:
    """Lists the contacts with a gap of at most `reach`, ordered by pair and code.

    `configuration` has n rows (x, y, alpha).
    """
    count = len(configuration)
    farthest = 2.0 * (body.half_length + body.radius) + reach
    found = []
    for i in range(count):
        for j in range(i + 1, count):
            if np.hypot(*(configuration[j, :2] - configuration[i, :2])) > farthest:
                continue
            pair = pair_contacts(body, configuration, i, j)
            if rule == "closest":
                pair = sorted(pair, key=lambda contact: (contact.gap, contact.code))[:1]
            elif rule != "endpoints":
                raise ValueError(f"unknown contact rule {rule!r}")
            found += [contact for contact in pair if contact.gap <= reach]
    return found


def pair_contacts(body: Body, configuration: np.ndarray, i: int, j: int) -> list[Contact]:
    """Lists the contacts of one pair under `endpoints`, ordered by code; its axes may cross."""
    found = []
    for code, on_i, on_j in sorted(
        _candidates(body, configuration, i, j), key=lambda found: found[0]
    ):
        apart = on_j - on_i
        distance = math.sqrt(apart[0] * apart[0] + apart[1] * apart[1])
        # Coincident points have no normal: leave the contact out.
        if distance == 0.0:
            continue
        normal = apart / distance
        lever_i = float(normal @ perpendicular(on_i - configuration[i, :2]))
        lever_j = float(normal @ perpendicular(on_j - configuration[j, :2]))
        found.append(Contact(i, j, code, distance - 2.0 * body.radius, normal, lever_i, lever_j))
    return found


def crossed_pairs(body: Body, configuration: np.ndarray) -> list[list[int]]:
    """Lists the pairs i < j whose axes have a point in common; a disc's axis is its centre."""
    count = len(configuration)
    return [
        [i, j]
        for i in range(count)
        for j in range(i + 1, count)
        if np.hypot(*(configuration[j, :2] - configuration[i, :2])) <= 2.1 * body.half_length
        and _intersect(_exact_ends(body, configuration[i]), _exact_ends(body, configuration[j]))
    ]


def perpendicular(vector: np.ndarray) -> np.ndarray:
    """Rotates a vector by a quarter turn, counter-clockwise."""
    return np.array([-vector[1], vector[0]])


def ends(body: Body, individual: np.ndarray) -> list[np.ndarray]:
    """Returns the points of the head and the tail of an axis."""
    x, y, alpha = individual
    heading = np.array([math.cos(alpha), math.sin(alpha)])
    return [np.array([x, y]) + sign * body.half_length * heading for sign in (1.0, -1.0)]


def _candidates(
    body: Body, configuration: np.ndarray, i: int, j: int
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yields (code, point of i, point of j) of ends against sides and ends against ends."""
    if body.half_length == 0.0:
        yield 0, configuration[i, :2], configuration[j, :2]
        return
    ends_i, ends_j = ends(body, configuration[i]), ends(body, configuration[j])
    # For each end, the end of the other axis that is nearest to it, or None if an inner point is.
    faced_by_i, faced_by_j = [], []
    for end in (HEAD, TAIL):
        foot, faced = _projection(body, ends_i[end], configuration[j])
        faced_by_i.append(faced)
        if faced is None:
            yield end, ends_i[end], foot
        foot, faced = _projection(body, ends_j[end], configuration[i])
        faced_by_j.append(faced)
        if faced is None:
            yield 2 + end, foot, ends_j[end]
    for end_i in (HEAD, TAIL):
        for end_j in (HEAD, TAIL):
            if faced_by_i[end_i] == end_j and faced_by_j[end_j] == end_i:
                yield 4 + 2 * end_i + end_j, ends_i[end_i], ends_j[end_j]


def _projection(body: Body, point: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Returns the nearest point of an axis, and its end if that is HEAD or TAIL."""
    heading = np.array([math.cos(other[2]), math.sin(other[2])])
    along = float((point - other[:2]) @ heading)
    if along >= body.half_length:
        return ends(body, other)[HEAD], HEAD
    if along <= -body.half_length:
        return ends(body, other)[TAIL], TAIL
    return other[:2] + along * heading, None


def _exact_ends(body: Body, individual: np.ndarray) -> list[tuple[Fraction, Fraction]]:
    return [(Fraction(float(end[0])), Fraction(float(end[1]))) for end in ends(body, individual)]


def _intersect(first: list, second: list) -> bool:
    """Returns whether two closed segments have a point in common."""
    sides = [
        _side(*first, second[0]),
        _side(*first, second[1]),
        _side(*second, first[0]),
        _side(*second, first[1]),
    ]
    if sides == [0, 0, 0, 0]:
        # On one line: they intersect if their projections on both coordinate axes do.
        return all(
            max(min(a[axis] for a in first), min(b[axis] for b in second))
            <= min(max(a[axis] for a in first), max(b[axis] for b in second))
            for axis in (0, 1)
        )
    return sides[0] * sides[1] <= 0 and sides[2] * sides[3] <= 0


def _side(a: tuple, b: tuple, c: tuple) -> int:
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return (area > 0) - (area < 0)
