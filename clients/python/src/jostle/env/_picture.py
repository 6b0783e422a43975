"""Pictures of a swarm as arrays of pixels: bodies to scale, heads dark, informed ones coloured."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._draw import HEIGHT, INFORMED, PLAIN, WIDTH, Camera
from .._state import State

Pixels = NDArray[np.uint8]

_PAPER = (255.0, 255.0, 255.0)
# The width of a body's edge, over its radius.
_EDGE = 0.18


def paint(state: State, pi1: float, camera: Camera) -> Pixels:
    """Paints the bodies of `state`, `pi1` times as long as wide: shape (360, 520, 3)."""
    camera.follow(state.position)
    image = np.empty((HEIGHT, WIDTH, 3))
    image[:] = _PAPER
    radius = 1.0 / (1.0 + pi1)
    half_length = (pi1 - 1.0) * radius
    heading = np.column_stack((np.cos(state.alpha), np.sin(state.alpha)))
    head = camera.pixels(state.position + half_length * heading)
    tail = camera.pixels(state.position - half_length * heading)
    mark = camera.pixels(state.position + (half_length + 0.3 * radius) * heading)
    wide = radius * camera.scale
    for is_informed, colours in ((False, PLAIN), (True, INFORMED)):
        fill, edge = map(_rgb, colours)
        for index in np.flatnonzero(state.informed == is_informed):
            _fill(image, tail[index], head[index], wide, edge)
            _fill(image, tail[index], head[index], (1.0 - _EDGE) * wide, fill)
            _fill(image, mark[index], mark[index], 0.45 * wide, edge)
    return np.round(image).astype(np.uint8)


def _fill(
    image: NDArray[np.float64],
    tail: NDArray[np.float64],
    head: NDArray[np.float64],
    wide: float,
    colour: NDArray[np.float64],
) -> None:
    """Fills the points at most `wide` from a segment; pixels at the rim in part."""
    low = np.floor(np.minimum(tail, head) - wide - 1.0).astype(int)
    high = np.ceil(np.maximum(tail, head) + wide + 1.0).astype(int)
    left, top = np.maximum(low, 0)
    right, bottom = np.minimum(high, (WIDTH, HEIGHT))
    if left >= right or top >= bottom:
        return
    x = np.arange(left, right)[None, :] + 0.5 - tail[0]
    y = np.arange(top, bottom)[:, None] + 0.5 - tail[1]
    along = head - tail
    length = math.hypot(*along)
    c, s = along / length if length else (1.0, 0.0)
    beyond = c * x + s * y
    away = np.hypot(beyond - np.clip(beyond, 0.0, length), c * y - s * x)
    covered = np.clip(wide + 0.5 - away, 0.0, 1.0)[..., None]
    part = image[top:bottom, left:right]
    part += covered * (colour - part)


def _rgb(colour: str) -> NDArray[np.float64]:
    """A colour such as #8fb3d1 as three numbers up to 255."""
    return np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)], float)
