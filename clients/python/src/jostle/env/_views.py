"""Observations of a group: by its individuals, and from above.

Every number is from -1 to 1. Directions are in the goal's frame: (1, 0) is along the goal, (0, 1)
to its left.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._state import State

Floats = NDArray[np.float64]
View = NDArray[np.float32]

OWN_SIZE = 9
"""Numbers of an observation about the agent and the group."""

NEIGHBOUR_SIZE = 4
"""Numbers of an observation about each neighbour."""

CELLS = 5
"""Cells along a side of the view from above."""

ABOVE_SIZE = 7 + 3 * CELLS**2
"""Numbers of the view from above."""

REACH = 2.0
"""From the centre to each edge of the view from above, in units of the group's spread."""


def within(state: State, who: NDArray[np.intp], goal: float, neighbours: int, sight: float) -> View:
    """The observations of individuals with the indices `who`: shape (k, 9 + 4 · neighbours).

    `ParallelEnv` describes the numbers.
    """
    position, heading = _in_goal_frame(state, goal)
    mine, others = position[who], position[None, :, :] - position[who, None, :]
    distance = np.hypot(others[..., 0], others[..., 1])
    is_other = np.arange(state.n)[None, :] != who[:, None]
    # Individuals at the same point have no direction to each other and contribute 0.
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
    """The view from above: shape (82,).

    `ShepherdEnv` describes the numbers.
    """
    position, heading = _in_goal_frame(state, goal)
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

    The place is relative to the centroid, in units of half the square's side.
    """
    position, _ = _in_goal_frame(state, goal)
    away = position - position.mean(axis=0)
    spread = math.sqrt((away**2).sum(axis=1).mean())
    distance = np.hypot(*(away - REACH * spread * place).T)
    return np.sort(np.argsort(distance, kind="stable")[:count])


def _in_goal_frame(state: State, goal: float) -> tuple[Floats, Floats]:
    """Positions relative to the origin and headings, in the goal's frame."""
    c, s = math.cos(goal), math.sin(goal)
    position = np.column_stack((c * state.x + s * state.y, c * state.y - s * state.x))
    angle = state.alpha - goal
    return position, np.column_stack((np.cos(angle), np.sin(angle)))


def _squash(vector: Floats, scale: float) -> Floats:
    """Scales vectors of any length to a length below 1."""
    squashed: Floats = vector / (scale + np.hypot(vector[:, 0], vector[:, 1])[:, None])
    return squashed


def _as_view(numbers: Floats) -> View:
    # Rounding errors may exceed 1.
    return np.clip(numbers, -1.0, 1.0).astype(np.float32)
