#!/usr/bin/env python3
"""Makes measures.svg: small groups, with the values that a daemon computes of them.

    JOSTLED=target/release/jostled target/venv/bin/python docs/pictures/measures.py
"""

import argparse
import math
import pathlib
from dataclasses import dataclass, field

import jostle

PI1 = 4
# docs/model.md, A body: the half-length of its axis, and its radius.
HALF, RADIUS = (PI1 - 1) / (1 + PI1), 1 / (1 + PI1)
# Two bodies side by side touch at this distance; the gap is below the default of `clusters`.
BESIDE = 2 * RADIUS + 0.0005
# A panel, and a body size, in pixels.
WIDTH, HEIGHT, SCALE, COLUMNS = 224, 236, 24, 4
# On a light ground and on a dark one.
COLOURS = {
    "ink": ("#17212b", "#e6edf3"),
    "soft": ("#52616f", "#9aa7b4"),
    "body": ("#8fb3d5", "#9cc3e4"),
    "edge": ("#2f5377", "#24476a"),
    "informed": ("#f2994a", "#f5a65b"),
    "informed-edge": ("#a85a10", "#8a4a10"),
    "wish": ("#c8102e", "#ff6b6b"),
    "shape": ("#0b7a4b", "#4ec98f"),
}


@dataclass
class Group:
    """Individuals, what is asked of them, and what is drawn around them."""

    title: str
    about: str
    x: list[float]
    y: list[float]
    alpha: list[float]
    measures: list[str]
    informed: list[int] = field(default_factory=list)
    direction: float = 0.0
    hull: bool = False
    clusters: list[list[int]] = field(default_factory=list)


def turn(degrees: float) -> float:
    return math.radians(degrees)


def lattice() -> tuple[list[float], list[float]]:
    """Six places, far enough apart for any heading."""
    return [-2, 0, 2, -2, 0, 2], [1, 1.2, 1, -1.2, -1, -1.2]


def groups() -> list[Group]:
    x, y = lattice()
    ring = [turn(60 * k) for k in range(6)]
    side = [-2.6, -2.6, -2.6, 0.2, 0.2, 2.6]
    up = [-BESIDE, 0, BESIDE, 1, 1 - BESIDE, -1]
    return [
        Group("all one way", "order: the length of the mean heading", x, y, [turn(20)] * 6,
              ["order", "nematic", "milling"]),
        Group("any way", "headings that cancel have no order", x, y,
              [turn(60 * k) for k in (0, 2, 4, 3, 5, 1)], ["order", "nematic", "milling"]),
        Group("in two lanes", "nematic: along one line, both ways", x, y,
              [turn(20), turn(200)] * 3, ["order", "nematic", "milling"]),
        Group("in a mill", "milling: around the centroid",
              [1.9 * math.cos(it) for it in ring], [1.9 * math.sin(it) for it in ring],
              [it + turn(90) for it in ring], ["order", "nematic", "milling"]),
        Group("the informed lead", "drift and front: along the arrows", x, y,
              [turn(it) for it in (30, 20, 0, -30, -20, 0)], ["drift", "front"], [2, 5]),
        Group("the informed fail", "all head elsewhere; they are behind", x, y,
              [turn(120)] * 6, ["drift", "front"], [0, 3]),
        Group("one apart", "spread: the area within the dashed line",
              [-2, 0, -1.9, 0.1, 3], [0.6, 0.9, -0.9, -0.7, 1.3],
              [turn(it) for it in (10, -10, 0, 15, 5)],
              ["spread", "radius_of_gyration", "neighbour_distance.median"], hull=True),
        Group("three clusters", "sets that touch, of 3, 2 and 1",
              side, up, [turn(0)] * 6,
              ["clusters.count", "clusters.largest", "clusters.n_eff", "contacts_per_body"],
              clusters=[[0, 1, 2], [3, 4], [5]]),
    ]


def measured(group: Group, number: int, client: jostle.Client) -> dict[str, float | None]:
    """The measures of a group, as a daemon computes them."""
    start = {"kind": "given", "x": group.x, "y": group.y, "alpha": group.alpha}
    swarm = client.create(f"group-{number}", jostle.Spec(n=len(group.x), pi1=PI1, start=start))
    if group.informed:
        swarm.inform({"ids": group.informed}, group.direction)
    return swarm.measures(*group.measures)


def hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The corners of the convex hull, by Andrew's monotone chain."""
    def half(those: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for c in those:
            while len(chain) > 1:
                a, b = chain[-2:]
                if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0:
                    break
                chain.pop()
            chain.append(c)
        return chain[:-1]

    return half(sorted(points)) + half(sorted(points, reverse=True))


def line(kind: str, width: float, *places: tuple[float, float], closed: bool = False) -> str:
    """A line through places of the plane, whose y axis points up."""
    steps = " ".join(f"{SCALE * x:.1f} {-SCALE * y:.1f}" for x, y in places)
    end = " Z" if closed else ""
    return f'<path class="{kind}" stroke-width="{width:.1f}" d="M {steps}{end}"/>'


def draw(group: Group) -> list[str]:
    """The bodies of a group, with their heads."""
    drawn = []
    ends = [
        ((x - HALF * math.cos(it), y - HALF * math.sin(it)),
         (x + HALF * math.cos(it), y + HALF * math.sin(it)))
        for x, y, it in zip(group.x, group.y, group.alpha)
    ]
    for cluster in group.clusters:
        drawn += [line("shape", 2 * RADIUS * SCALE + 9, *ends[i]) for i in cluster]
    for i, (tail, head) in enumerate(ends):
        kind = "informed" if i in group.informed else "body"
        edge = "informed-edge" if i in group.informed else "edge"
        drawn.append(line(edge, 2 * RADIUS * SCALE, tail, head))
        drawn.append(line(kind, 2 * RADIUS * SCALE - 2.6, tail, head))
        drawn.append(line(edge, RADIUS * SCALE, head, head))
    if group.hull:
        drawn.append(line("hull", 1.5, *hull(list(zip(group.x, group.y))), closed=True))
    for i in group.informed:
        x, y = group.x[i], group.y[i]
        tip = (x + 1.5 * math.cos(group.direction), y + 1.5 * math.sin(group.direction))
        drawn.append(line("wish", 2, (x, y), tip))
        for side in (150, -150):
            at = group.direction + turn(side)
            drawn.append(line("wish", 2, tip, (tip[0] + 0.3 * math.cos(at), tip[1] + 0.3 * math.sin(at))))
    return drawn


def styles() -> str:
    rules = {"body": "stroke", "edge": "stroke", "informed": "stroke", "informed-edge": "stroke",
             "wish": "stroke", "shape": "stroke", "ink": "fill", "soft": "fill"}
    of = [
        "".join(f".{name}{{{rules[name]}:{COLOURS[name][k]}}}" for name in rules)
        + f".hull{{stroke:{COLOURS['shape'][k]}}}"
        for k in (0, 1)
    ]
    return (
        "path{fill:none;stroke-linecap:round;stroke-linejoin:round}"
        ".shape{stroke-opacity:.55}.hull{stroke-dasharray:5 4}"
        "text{font:13px system-ui,sans-serif;text-anchor:middle}"
        ".title{font-weight:600}.soft{font-size:11px}"
        f"{of[0]}@media (prefers-color-scheme:dark){{{of[1]}}}"
    )


def text(name: str, value: float | None) -> str:
    """A value with two decimals, or as a whole number."""
    if value is None:
        return "undefined"
    if name in ("clusters.count", "clusters.largest"):
        return f"{value:.0f}"
    # Rounding of sums that cancel leaves a sign at 0.
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")


def picture(client: jostle.Client) -> str:
    """The SVG."""
    panels = []
    every = groups()
    for number, group in enumerate(every):
        values = measured(group, number, client)
        left, top = WIDTH * (number % COLUMNS), HEIGHT * (number // COLUMNS)
        panels.append(f'<g transform="translate({left + WIDTH / 2:g} {top + 92})">')
        panels += draw(group)
        panels.append(f'<text class="ink title" y="-72">{group.title}</text>')
        panels.append(f'<text class="soft" y="70">{group.about}</text>')
        for k, (name, value) in enumerate(values.items()):
            panels.append(f'<text class="ink" y="{87 + 15 * k}">{name} {text(name, value)}</text>')
        panels.append("</g>")
    width, height = WIDTH * COLUMNS, HEIGHT * math.ceil(len(every) / COLUMNS)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}">'
    about = "Eight small groups, each with the values of some measures"
    return "\n".join(
        [head, f"<title>{about}</title>", f"<style>{styles()}</style>", *panels, "</svg>", ""]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    here = pathlib.Path(__file__).parent
    parser.add_argument("to", nargs="?", type=pathlib.Path, default=here / "measures.svg")
    to = parser.parse_args().to
    with jostle.local() as client:
        to.write_text(picture(client), encoding="utf-8")


if __name__ == "__main__":
    main()
