"""Pictures of a swarm as SVG: bodies to scale, their heads marked, the informed coloured."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ._state import State

WIDTH, HEIGHT = 520, 360
_MARGIN_PX = 14.0
_EDGE_PX = 1.3
# A group that has become this much smaller than the picture is drawn larger again.
_LOOSE = 0.6
# Without knowing better, bodies are drawn as the paper's.
_USUAL_PI1 = 4.0

PLAIN = ("#8fb3d1", "#2f5474")
INFORMED = ("#f2a154", "#8a4408")
_WISH = "#d9711a"


@dataclass
class Camera:
    """Which part of the plane is seen: around a point, so many pixels to a body size."""

    x: float = 0.0
    y: float = 0.0
    scale: float = 0.0

    def follow(self, position: NDArray[np.float64]) -> None:
        """Keeps everyone in the picture, without changing the scale for every little."""
        low, high = position.min(axis=0) - 0.6, position.max(axis=0) + 0.6
        self.x, self.y = (low + high) / 2.0
        room = (WIDTH - 2.0 * _MARGIN_PX, HEIGHT - 2.0 * _MARGIN_PX)
        fits = float(min(room / (high - low)))
        if not _LOOSE * fits <= self.scale <= fits:
            # Nobody is so near that three bodies fill the picture.
            self.scale = min(fits * (0.85 if self.scale else 1.0), 80.0)

    def pixels(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where positions are in the picture, whose y grows downwards."""
        away = (position - (self.x, self.y)) * (self.scale, -self.scale)
        pixels: NDArray[np.float64] = away + np.array((WIDTH / 2.0, HEIGHT / 2.0))
        return pixels


def draw(state: State, pi1: float | None = None, camera: Camera | None = None) -> str:
    """Draws the bodies of `state`, `pi1` times as long as wide, with a caption; as HTML."""
    pi1 = pi1 or state.pi1 or _USUAL_PI1
    camera = camera or Camera()
    position = state.position
    camera.follow(position)
    parts = [_grid(camera)]
    heading = np.column_stack((np.cos(state.alpha), np.sin(state.alpha)))
    for informed, colours in ((False, PLAIN), (True, INFORMED)):
        those = state.informed == informed
        parts.append(_bodies(position[those], heading[those], pi1, camera, colours))
    parts.append(_wishes(state))
    said = html.escape(_caption(state), quote=True)
    return (
        f'<div style="max-width:{WIDTH}px;font:11.5px system-ui,sans-serif">'
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'style="width:100%;height:auto;display:block" fill="none" role="img" '
        f'aria-label="{said}">{"".join(parts)}</svg>'
        f'<div style="opacity:.85;padding:4px 2px">{said}</div></div>'
    )


def _bodies(
    centre: NDArray[np.float64],
    heading: NDArray[np.float64],
    pi1: float,
    camera: Camera,
    colours: tuple[str, str],
) -> str:
    """Capsules: thick lines with round ends, a thinner one of another colour on each."""
    if not len(centre):
        return ""
    radius = 1.0 / (1.0 + pi1)
    half_length = (pi1 - 1.0) * radius
    head = camera.pixels(centre + half_length * heading)
    tail = camera.pixels(centre - half_length * heading)
    # On a disc only the mark tells where its head is.
    slender = min(pi1 - 1.0, 1.0)
    mark = camera.pixels(centre + (half_length + (0.45 - 0.3 * slender) * radius) * heading)
    # Everyone in one path, twice: the first shows between two bodies that touch.
    lines = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in np.hstack((tail, head)))
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in mark)
    width = 2.0 * radius * camera.scale
    dot = (0.42 + 0.18 * slender) * width
    inner = max(width - 2.0 * _EDGE_PX, 0.55 * width)
    fill, edge = colours
    return (
        f'<g stroke-linecap="round"><path d="{lines}" stroke="{edge}" stroke-width="{width:.2f}"/>'
        f'<path d="{lines}" stroke="{fill}" stroke-width="{inner:.2f}"/>'
        f'<path d="{dots}" stroke="{edge}" stroke-width="{dot:.2f}"/></g>'
    )


def _grid(camera: Camera) -> str:
    """Lines that stand still in the plane, and how far they are apart."""
    rough = 60.0 / camera.scale
    power = 10.0 ** math.floor(math.log10(rough))
    spacing = power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= rough)
    lines = []
    for centre, length, across in ((camera.x, WIDTH, HEIGHT), (camera.y, HEIGHT, WIDTH)):
        reach = length / 2.0 / camera.scale
        first, last = math.ceil((centre - reach) / spacing), math.floor((centre + reach) / spacing)
        for index in range(first, last + 1):
            away = (index * spacing - centre) * camera.scale
            if length == WIDTH:
                lines.append(f"M{WIDTH / 2 + away:.1f} 0V{across}")
            else:
                lines.append(f"M0 {HEIGHT / 2 - away:.1f}H{across}")
    path = f'<path d="{"".join(lines)}" stroke="currentColor" stroke-opacity=".13"/>'
    border = (
        f'<rect x=".5" y=".5" width="{WIDTH - 1}" height="{HEIGHT - 1}" rx="6" '
        'stroke="currentColor" stroke-opacity=".25"/>'
    )
    sizes = "body size" if spacing == 1.0 else "body sizes"
    legend = (
        f'<text x="9" y="{HEIGHT - 10}" fill="currentColor" fill-opacity=".65" font-size="11">'
        f"grid: {spacing:g} {sizes}</text>"
    )
    return path + border + legend


def _wishes(state: State) -> str:
    """An arrow in the corner for each direction that someone wants to go."""
    directions = np.unique(np.round(np.mod(state.direction[state.informed], 2.0 * math.pi), 3))
    if not 0 < len(directions) <= 8:
        return ""
    x, y, length = WIDTH - 30.0, 30.0, 17.0
    arrows = []
    for direction in directions:
        c, s = math.cos(direction), -math.sin(direction)
        tip, foot = (x + length * c, y + length * s), (x - length * c, y - length * s)
        sides = [
            (tip[0] - 9.0 * c + side * 5.5 * s, tip[1] - 9.0 * s - side * 5.5 * c)
            for side in (1.0, -1.0)
        ]
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in (tip, *sides))
        shaft = (tip[0] - 8.0 * c, tip[1] - 8.0 * s)
        if len(directions) > 1:
            foot = (x, y)
        arrows.append(
            f'<path d="M{foot[0]:.1f} {foot[1]:.1f}L{shaft[0]:.1f} {shaft[1]:.1f}" '
            f'stroke="{_WISH}" stroke-width="3"/><polygon points="{points}" fill="{_WISH}"/>'
        )
    disc = f'<circle cx="{x}" cy="{y}" r="23" fill="{_WISH}" fill-opacity=".18"/>'
    return f"<g>{disc}{''.join(arrows)}</g>"


def _caption(state: State) -> str:
    informed = int(state.informed.sum())
    drift = state.order.drift
    said = [
        f"{state.swarm}, {state.phase}",
        f"step {state.step}, t = {state.time:g}",
        f"{state.n} individual{'s' if state.n > 1 else ''}"
        + (f", {informed} informed" if informed else ""),
        f"order {state.order.order:.2f}" + ("" if drift is None else f", drift {drift:+.2f}"),
    ]
    return " · ".join(said)
