"""What can be seen of a group: by one within it, and by one above it.

Every number is from -1 to 1. Directions are told in the goal's frame: (1, 0) is along the goal,
(0, 1) to its left.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._state import State

Floats = NDArray[np.float64]
View = NDArray[np.float32]

OWN_SIZE = 9
"""Numbers that an individual perceives of itself and the group."""

NEIGHBOUR_SIZE = 4
"""Numbers that an individual perceives of each neighbour."""

CELLS = 5
"""The view from above has so many cells a side."""

ABOVE_SIZE = 7 + 3 * CELLS**2
"""Numbers that are seen from above."""

REACH = 2.0
"""From the centre to each edge of the view from above, in units of the group's spread."""


def within(state: State, who: NDArray[np.intp], goal: float, neighbours: int, sight: float) -> View:
    """What each of `who`, indices of individuals, perceives: shape (k, 9 + 4 · neighbours).

    0, 1: its heading.
    2, 3: where the group's centre is, d / (√n + |d|).
    4, 5: the mean heading of the group, which is its velocity.
    6, 7: the mean of the unit vectors to all the others, which attracts it by the default law.
    8: how crowded it is: c / (1 + c) with c others within one body size.
    Then for each of the nearest `neighbours` in `sight`, the nearest first: where it is, in units
    of `sight`, and its heading; zeros where there is none.
    """
    position, heading = _seen(state, goal)
    mine, others = position[who], position[None, :, :] - position[who, None, :]
    distance = np.hypot(others[..., 0], others[..., 1])
    is_other = np.arange(state.n)[None, :] != who[:, None]
    # Those in the same place have no direction to each other and count for nothing.
    unit = others / np.where(distance > 0.0, distance, 1.0)[..., None]
    close = (is_other & (distance <= 1.0)).sum(axis=1)[:, None]
    own = np.hstack(
        (
            heading[who],
            _squash(position.mean(axis=0) - mine, math.sqrt(state.n)),
            np.broadcast_to(heading.mean(axis=0), mine.shape),
            unit.sum(axis=1) / max(state.n - 1, 1),
            close / (1.0 + close),
        )
    )
    seen = np.zeros((len(who), neighbours, NEIGHBOUR_SIZE))
    order = np.argsort(np.where(is_other, distance, np.inf), axis=1, kind="stable")
    order = order[:, : min(neighbours, state.n - 1)]
    row = np.arange(len(who))[:, None]
    near = np.concatenate((others[row, order] / sight, heading[order]), axis=2)
    near[distance[row, order] > sight] = 0.0
    seen[:, : order.shape[1]] = near
    return _as_view(np.hstack((own, seen.reshape(len(who), -1))))


def above(state: State, goal: float) -> View:
    """What is seen from above: shape (82,).

    0, 1: the mean heading of the group, which is its velocity.
    2: its spread R, the root mean square of the distances from its centre, R / (√n + R).
    3, 4: how long it is along the goal rather than across, and along one diagonal rather than
    the other: cos 2φ and sin 2φ of the directions φ from its centre, weighted by distance squared.
    5, 6: how much headings point away from the centre, and how much they mill around it.
    Then for each of 5 · 5 cells of a square that reaches 2 R from the centre each way, rows from
    right to left of the goal, columns from behind to ahead: the share of the group that is there,
    those further out counted into the cell at the edge, and its mean heading.
    """
    position, heading = _seen(state, goal)
    away = position - position.mean(axis=0)
    squared = (away**2).sum(axis=1)
    spread = math.sqrt(squared.mean())
    distance = np.sqrt(squared)
    unit = away / np.where(distance > 0.0, distance, 1.0)[:, None]
    total = max(float(squared.sum()), np.finfo(float).tiny)
    figures = (
        *heading.mean(axis=0),
        spread / (math.sqrt(state.n) + spread),
        (away[:, 0] ** 2 - away[:, 1] ** 2).sum() / total,
        2.0 * (away[:, 0] * away[:, 1]).sum() / total,
        (unit * heading).sum(axis=1).mean(),
        (unit[:, 0] * heading[:, 1] - unit[:, 1] * heading[:, 0]).mean(),
    )
    cell = np.floor((away / (REACH * spread or 1.0) + 1.0) * (0.5 * CELLS)).astype(int)
    cell = np.clip(cell, 0, CELLS - 1)
    index = cell[:, 1] * CELLS + cell[:, 0]
    count = np.bincount(index, minlength=CELLS**2)
    inside = np.maximum(count, 1)
    grid = np.column_stack(
        (
            count / state.n,
            np.bincount(index, heading[:, 0], CELLS**2) / inside,
            np.bincount(index, heading[:, 1], CELLS**2) / inside,
        )
    )
    return _as_view(np.concatenate((figures, grid.ravel())))


def nearest(state: State, goal: float, place: Floats, count: int) -> NDArray[np.intp]:
    """The indices of the `count` individuals nearest to a place in the view from above.

    The place is told in units of half the square's side, from its centre.
    """
    position, _ = _seen(state, goal)
    away = position - position.mean(axis=0)
    spread = math.sqrt((away**2).sum(axis=1).mean())
    distance = np.hypot(*(away - REACH * spread * place).T)
    return np.sort(np.argsort(distance, kind="stable")[:count])


def _seen(state: State, goal: float) -> tuple[Floats, Floats]:
    """Positions relative to the origin and headings, in the goal's frame."""
    c, s = math.cos(goal), math.sin(goal)
    position = np.column_stack((c * state.x + s * state.y, c * state.y - s * state.x))
    angle = state.alpha - goal
    return position, np.column_stack((np.cos(angle), np.sin(angle)))


def _squash(vector: Floats, scale: float) -> Floats:
    """Vectors of any length as such of less than 1."""
    squashed: Floats = vector / (scale + np.hypot(vector[:, 0], vector[:, 1])[:, None])
    return squashed


def _as_view(numbers: Floats) -> View:
    # Rounding may have gone beyond.
    return np.clip(numbers, -1.0, 1.0).astype(np.float32)
