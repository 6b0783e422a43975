"""Pictures of a swarm as SVG: bodies to scale, their heads marked, informed ones coloured."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 520, 360
_MARGIN_PX = 14.0
_EDGE_PX = 1.3
# The scale increases when the group takes less than this share of the picture.
_MIN_FILL = 0.6
# The paper's value, if that of the swarm is not known.
_DEFAULT_PI1 = 4.0

PLAIN = ("#8fb3d1", "#2f5474")
INFORMED = ("#f2a154", "#8a4408")
_ARROW = "#d9711a"


@dataclass
class Camera:
    """The visible part of the plane: its centre, body sizes, and pixels per body size."""

    x: float = 0.0
    y: float = 0.0
    scale: float = 0.0

    def follow(self, position: NDArray[np.float64]) -> None:
        """Keeps all individuals in the picture; small changes do not change the scale."""
        low, high = position.min(axis=0) - 0.6, position.max(axis=0) + 0.6
        self.x, self.y = (low + high) / 2.0
        room = (WIDTH - 2.0 * _MARGIN_PX, HEIGHT - 2.0 * _MARGIN_PX)
        fits = float(min(room / (high - low)))
        if not _MIN_FILL * fits <= self.scale <= fits:
            # The largest scale: the picture is 6.5 body sizes wide.
            self.scale = min(fits * (0.85 if self.scale else 1.0), 80.0)

    def pixels(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """The pixels of positions; the y of a picture increases downwards."""
        away = (position - (self.x, self.y)) * (self.scale, -self.scale)
        pixels: NDArray[np.float64] = away + np.array((WIDTH / 2.0, HEIGHT / 2.0))
        return pixels


def draw(
    position: NDArray[np.float64],
    alpha: NDArray[np.float64],
    informed: NDArray[np.bool_],
    direction: NDArray[np.float64],
    pi1: float | None,
    caption: str,
    camera: Camera | None = None,
) -> str:
    """Draws bodies as HTML.

    Args:
        position: Absolute positions, shape (n, 2), body sizes.
        alpha: Headings, shape (n,), radians.
        informed: Whether each is informed, shape (n,).
        direction: Preferred directions, shape (n,), radians.
        pi1: Length over width of a body; None is the paper's.
        caption: A text below the picture.
        camera: The visible part, which follows the bodies.
    """
    camera = camera or Camera()
    camera.follow(position)
    parts = [_grid(camera)]
    heading = np.column_stack((np.cos(alpha), np.sin(alpha)))
    for is_informed, colours in ((False, PLAIN), (True, INFORMED)):
        those = informed == is_informed
        parts.append(_bodies(position[those], heading[those], pi1 or _DEFAULT_PI1, camera, colours))
    parts.append(_arrows(direction[informed]))
    caption = html.escape(caption, quote=True)
    return (
        f'<div style="max-width:{WIDTH}px;font:11.5px system-ui,sans-serif">'
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'style="width:100%;height:auto;display:block" fill="none" role="img" '
        f'aria-label="{caption}">{"".join(parts)}</svg>'
        f'<div style="opacity:.85;padding:4px 2px">{caption}</div></div>'
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
    # The mark of a disc is nearer to its edge, since nothing else shows its heading.
    slender = min(pi1 - 1.0, 1.0)
    mark = camera.pixels(centre + (half_length + (0.45 - 0.3 * slender) * radius) * heading)
    # All bodies are one path, drawn twice: the wider one separates bodies that touch.
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
    """Lines that are fixed in the plane, and a legend of their distance."""
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


def _arrows(preferred: NDArray[np.float64]) -> str:
    """An arrow in the corner for each preferred direction."""
    directions = np.unique(np.round(np.mod(preferred, 2.0 * math.pi), 3))
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
            f'stroke="{_ARROW}" stroke-width="3"/><polygon points="{points}" fill="{_ARROW}"/>'
        )
    disc = f'<circle cx="{x}" cy="{y}" r="23" fill="{_ARROW}" fill-opacity=".18"/>'
    return f"<g>{disc}{''.join(arrows)}</g>"
