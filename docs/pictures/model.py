#!/usr/bin/env python3
"""Makes the drawings of docs/model.md: a body, the contact rules, and an informed group.

    cargo build --release --workspace
    .venv/bin/python docs/pictures/model.py target/release

The interpreter has the Python package of the daemon. The size of a body and the contacts are those
of the reference implementation, which the tests compare with the daemon; the group is a real swarm.
"""

import math
import os
import pathlib
import sys

import numpy as np

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "crates" / "physics" / "tests" / "reference"))

from contacts import (  # noqa: E402
    Body,
    Contact,
    _projection,
    ends,
    find_contacts,
    perpendicular,
)

# Light and dark.
COLOURS = {
    "ink": ("#24292f", "#e6edf3"),
    "soft": ("#59636e", "#9198a1"),
    "fill": ("#dbe3ec", "#2d3945"),
    "edge": ("#5b6f86", "#8ea4bb"),
    "informed": ("#f3a35c", "#c8701f"),
    "push": ("#0b62c4", "#6cb2ff"),
}
FONT = "-apple-system, 'Segoe UI', Helvetica, Arial, sans-serif"


class Drawing:
    """An SVG whose colours follow those of the reader's system."""

    def __init__(self, width: int, height: int, label: str) -> None:
        self.width, self.height, self.label = width, height, label
        self.parts: list[str] = []

    def text(self, x, y, text, style="ink", size=15, anchor="middle", more="") -> None:
        self.parts.append(
            f'<text class="{style}" x="{x:.1f}" y="{y:.1f}" font-size="{size}" '
            f'text-anchor="{anchor}" {more}>{text}</text>'
        )

    def line(self, a, b, style="ink", width=1.5, dash="", heads="") -> None:
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        marks = "".join(f' marker-{at}="url(#{style})"' for at in heads.split())
        self.parts.append(
            f'<path class="s-{style}" d="M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" '
            f'stroke-width="{width}"{dashed}{marks}/>'
        )

    def dot(self, at, style="ink", radius=3.0) -> None:
        self.parts.append(
            f'<circle class="{style}" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius}"/>'
        )

    def path(self, d, style="soft", width=1.2, dash="") -> None:
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<path class="s-{style}" d="{d}" stroke-width="{width}"{dashed}/>')

    def body(self, body: Body, at, alpha: float, scale: float, style="fill", edge=1.5) -> None:
        """A body whose centre is at a place of the picture."""
        length, radius = body.half_length * scale, body.radius * scale
        turned = f"translate({at[0]:.1f} {at[1]:.1f}) rotate({-math.degrees(alpha):.2f})"
        self.parts.append(
            f'<rect class="{style} s-edge" x="{-length - radius:.2f}" y="{-radius:.2f}" '
            f'width="{2 * (length + radius):.2f}" height="{2 * radius:.2f}" rx="{radius:.2f}" '
            f'stroke-width="{edge}" transform="{turned}"/>'
        )

    def save(self, name: str) -> None:
        """Writes it beside this script."""
        rules = [f"text {{ font-family: {FONT} }}", "path { fill: none }"]
        for index in (0, 1):
            of_it = [
                f".{name} {{ fill: {it[index]} }} .s-{name} {{ stroke: {it[index]} }}"
                for name, it in COLOURS.items()
            ]
            rules += of_it if index == 0 else ["@media (prefers-color-scheme: dark) {", *of_it, "}"]
        heads = "".join(
            f'<marker id="{name}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="10" '
            f'markerHeight="10" markerUnits="userSpaceOnUse" orient="auto-start-reverse">'
            f'<polygon class="{name}" points="0,1 10,5 0,9"/></marker>'
            for name in ("ink", "soft", "push")
        )
        text = "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} '
                f'{self.height}" width="{self.width}" height="{self.height}" role="img" '
                f'aria-label="{self.label}">',
                "<style>",
                *rules,
                "</style>",
                f"<defs>{heads}</defs>",
                *self.parts,
                "</svg>",
                "",
            ]
        )
        (HERE / name).write_text(text, encoding="utf-8")


def body_and_shapes() -> None:
    """A body with its axis, radius, length, width and heading; and four shapes, to scale."""
    drawing = Drawing(820, 400, "A body with its measures, and the shapes of four values of pi1")
    body, scale, alpha = Body.of_aspect_ratio(4.0), 226.0, math.radians(25.0)
    centre = np.array([322.0, 196.0])
    along = np.array([math.cos(alpha), -math.sin(alpha)])
    across = np.array([-along[1], along[0]])  # to the lower right on the picture
    h, r = body.half_length * scale, body.radius * scale
    drawing.body(body, centre, alpha, scale, edge=2)
    head, tail = centre + h * along, centre - h * along
    for end in (head, tail):
        drawing.path(
            f"M{end[0] - r:.1f} {end[1]:.1f}a{r:.1f} {r:.1f} 0 1 0 {2 * r:.1f} 0"
            f"a{r:.1f} {r:.1f} 0 1 0 {-2 * r:.1f} 0",
            dash="4 4",
        )
    drawing.line(tail, head, width=2)
    for end in (head, tail):
        drawing.dot(end, radius=4)
    drawing.dot(centre, radius=4)
    # The heading, and its angle from +x.
    drawing.line(head + (r + 4) * along, head + (r + 62) * along, width=2, heads="end")
    drawing.text(*(head + (r + 80) * along + (0, 4)), "e", more='font-style="italic"', size=18)
    drawing.line(centre, centre + (120.0, 0.0), "soft", 1.2, dash="5 4")
    end = centre + 62 * along
    drawing.path(f"M{centre[0] + 62:.1f} {centre[1]:.1f}A62 62 0 0 0 {end[0]:.1f} {end[1]:.1f}")
    drawing.text(centre[0] + 74, centre[1] - 11, "α", "ink", 17)
    drawing.text(centre[0] + 134, centre[1] + 5, "+x", "soft", 14)
    drawing.text(*(centre + (4, 24)), "centre", size=14)
    # h, r, length and width.
    drawing.text(*(centre - 0.5 * h * along - 10 * across), "h", size=17)
    drawing.line(tail, tail + r * across, "soft", 1.2, heads="end")
    drawing.text(*(tail + 0.5 * r * across + 12 * along + (0, 4)), "r", size=17)
    out = (r + 26) * across
    drawing.line(
        centre - (h + r) * along + out, centre + (h + r) * along + out, "soft", heads="start end"
    )
    for side in (-1, 1):
        tip = centre + side * (h + r) * along
        drawing.line(tip + 6 * across, tip + out + 8 * across, "soft", 1)
    drawing.text(
        *(centre + out + 22 * across),
        "length 2 (h + r) = 1.6",
        more=f'transform="rotate({-math.degrees(alpha):.1f} '
        f'{(centre + out + 22 * across)[0]:.1f} {(centre + out + 22 * across)[1]:.1f})"',
    )
    back = centre - (h + r + 24) * along
    drawing.line(back - r * across, back + r * across, "soft", heads="start end")
    for side in (-1, 1):
        drawing.line(tail + side * r * across, back + side * r * across - 8 * along, "soft", 1)
    at = back - 16 * along
    drawing.text(*(at + (-4, 5)), "width 2 r = 0.4", anchor="end", size=15)
    drawing.text(*(head + (4, -r - 14)), "head", size=14)
    drawing.text(*(tail + (-18, -r - 10)), "tail", size=14)
    # To scale: one body size.
    x, y = 652, 58
    small = 62.0
    drawing.text(x + 40, y - 26, "four shapes of one body size s", "ink", 15)
    for row, pi1 in enumerate((1.0, 2.0, 4.0, 8.0)):
        of_it = Body.of_aspect_ratio(pi1)
        at = np.array([x + 70.0, y + 22.0 + 66 * row])
        drawing.body(of_it, at, 0.0, small)
        drawing.line(at - (of_it.half_length * small, 0), at + (of_it.half_length * small, 0))
        drawing.text(x - 44, at[1] + 5, f"π1 = {pi1:g}", anchor="middle")
    y += 22 + 66 * 3 + 50
    drawing.line((x + 70 - small / 2, y), (x + 70 + small / 2, y), "soft", heads="start end")
    drawing.text(x + 70, y + 22, "s = (length + width) / 2", "soft", 14)
    drawing.save("model-body.svg")


def clamped(body: Body, pair: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points of the ends of which only one is the nearest point of its axis to the other."""
    first, second = ends(body, pair[0]), ends(body, pair[1])
    found = []
    for a, of_first in enumerate(first):
        for b, of_second in enumerate(second):
            faces = _projection(body, of_first, pair[1])[1] == b
            faced = _projection(body, of_second, pair[0])[1] == a
            if faces != faced:
                found.append((of_first, of_second))
    return found


def points(body: Body, pair: np.ndarray, contact: Contact) -> tuple[np.ndarray, np.ndarray]:
    """The two points of a contact on the axes."""
    (on_i, on_j) = (
        pair[k, :2] + _along(body, pair, k, lever, contact.normal_i_to_j)
        for k, lever in enumerate((contact.lever_i, contact.lever_j))
    )
    return on_i, on_j


def _along(body: Body, pair: np.ndarray, k: int, lever: float, normal: np.ndarray) -> np.ndarray:
    heading = np.array([math.cos(pair[k, 2]), math.sin(pair[k, 2])])
    # lever = a (e × n), where a is the position along the axis.
    return heading * lever / float(normal @ perpendicular(heading))


def contact_rules() -> None:
    """Four pairs of bodies, and the contacts of them under each rule."""
    body, scale = Body.of_aspect_ratio(4.0), 78.0
    # As far as a step with the default parameters looks for contacts: 3 dt (1 + h omega).
    reach = 3 * 0.02 * (1 + body.half_length * 1.5)
    pairs = {
        "end against side": [(0.0, -0.56, 0.0), (0.12, 0.34, math.radians(50))],
        "end against end": [(-0.55, -0.03, math.radians(55)), (0.57, 0.03, math.radians(122))],
        "side by side": [(0.0, -0.23, 0.0), (0.0, 0.23, 0.0)],
        "side by side, shifted": [(-0.09, -0.23, math.radians(1)), (0.09, 0.23, math.radians(-1))],
    }
    rules = {
        "endpoints": "the default",
        "closest": "the appendix of the paper",
        "clamped": "for comparison",
    }
    left, top, wide, high = 124, 44, 174, 158
    drawing = Drawing(left + 4 * wide + 8, top + 3 * high + 10, "The contacts of each contact rule")
    for column, name in enumerate(pairs):
        drawing.text(left + wide * (column + 0.5), 26, name, size=16)
    for row, (rule, remark) in enumerate(rules.items()):
        y = top + high * (row + 0.5)
        drawing.text(8, y - 2, rule, anchor="start", size=16, more='font-weight="600"')
        for at, words in enumerate(_lines(remark, 15)):
            drawing.text(8, y + 18 + 16 * at, words, "soft", 13, anchor="start")
        if row > 0:
            drawing.line((8, top + high * row), (left + 4 * wide, top + high * row), "fill", 1)
        for column, rows in enumerate(pairs.values()):
            pair = np.array(rows)
            origin = np.array([left + wide * (column + 0.5), y])

            def place(at: np.ndarray, origin=origin) -> np.ndarray:
                return origin + scale * np.array([at[0], -at[1]])

            for x, y_, alpha in rows:
                drawing.body(body, place(np.array([x, y_])), alpha, scale)
                heading = np.array([math.cos(alpha), math.sin(alpha)]) * body.half_length
                here = np.array([x, y_])
                drawing.line(place(here - heading), place(here + heading), "edge", 1.2)
            listed = find_contacts("endpoints" if rule == "clamped" else rule, body, pair, reach)
            marked = [points(body, pair, contact) for contact in listed]
            for contact, (a, b) in zip(listed, marked, strict=True):
                apart = math.hypot(*(b - a)) - 2 * body.radius
                assert abs(apart - contact.gap) < 1e-9, (rule, contact)
            if rule == "clamped":
                near = 2 * body.radius + reach
                marked += [it for it in clamped(body, pair) if math.hypot(*(it[1] - it[0])) <= near]
            for a, b in marked:
                drawing.line(place(a), place(b), "push", 2.5)
                drawing.dot(place(a), "push", 4)
                drawing.dot(place(b), "push", 4)
    drawing.save("model-contacts.svg")


def _lines(text: str, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width and lines[-1]:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def informed_group() -> None:
    """A swarm that walks up the page, when eight are informed of the direction +x and later."""
    import jostle

    with jostle.local() as client:
        swarm = client.create("group", jostle.Spec(n=40, seed=7))
        swarm.run(until=50, rate=None, wait=True)
        swarm.inform(jostle.count(8), direction=0.0)
        states = [swarm.state()]
        for until in (80, 150):
            swarm.run(until=until, rate=None, wait=True)
            states.append(swarm.state())
    body = Body.of_aspect_ratio(4.0)
    wide, high, top = 272, 268, 34
    drawing = Drawing(3 * wide + 4, top + high + 58, "Eight informed of forty turn the group")
    spans = [max(np.ptp(state.x), np.ptp(state.y)) for state in states]
    scale = (min(wide, high) - 8) / (max(spans) + 1.2)
    for column, state in enumerate(states):
        middle = np.array(
            [np.ptp(state.x) / 2 + state.x.min(), np.ptp(state.y) / 2 + state.y.min()]
        )
        origin = np.array([wide * (column + 0.5), top + high / 2])
        drawing.text(origin[0], 22, f"t = {state.time:.0f}", size=16)
        for x, y, alpha, weight in zip(state.x, state.y, state.alpha, state.weight, strict=True):
            at = origin + scale * np.array([x - middle[0], middle[1] - y])
            drawing.body(body, at, alpha, scale, "informed" if weight > 0 else "fill", edge=0.9)
            towards = np.array([math.cos(alpha), -math.sin(alpha)])
            drawing.dot(at + body.half_length * scale * towards, "ink", 2.2)
        text = f"order {state.order.order:.2f}"
        if state.order.drift is not None and column > 0:
            text += f", drift {state.order.drift:+.2f}"
        drawing.text(origin[0], top + high + 20, text, "soft", 14)
    y = top + high + 44
    drawing.line((wide * 0.5 - 1.6 * scale, y), (wide * 0.5 + 3.4 * scale, y), "soft")
    drawing.text(wide * 0.5 + 3.4 * scale + 8, y + 5, "5 body sizes", "soft", 13, "start")
    drawing.line((wide * 1.5 - 90, y), (wide * 1.5 - 40, y), "ink", 2, heads="end")
    drawing.text(wide * 1.5 - 32, y + 5, "preferred direction of the informed", "soft", 13, "start")
    drawing.save("model-informed.svg")


def main() -> None:
    binaries = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "target/release").resolve()
    os.environ["JOSTLED"] = str(binaries / "jostled")
    body_and_shapes()
    contact_rules()
    informed_group()


main()
