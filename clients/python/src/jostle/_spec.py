"""What a swarm is made from."""

from __future__ import annotations

from typing import Any

import msgspec

from ._show import Shown


class Disc(msgspec.Struct, frozen=True, tag_field="kind", tag="disc", omit_defaults=True):
    """A start: uniformly in a disc, one after the other, none overlapping an earlier one.

    Attributes:
        radius: Of the disc, body sizes; None is √n, at least 1.
    """

    radius: float | None = None


class Given(msgspec.Struct, frozen=True, tag_field="kind", tag="given"):
    """A start: exactly there, to the bit. `jostle.given` makes one from arrays.

    Attributes:
        x: Absolute positions, body sizes, n of them.
        y: Absolute positions, body sizes, n of them.
        alpha: Headings in radians, n of them.
    """

    x: list[float]
    y: list[float]
    alpha: list[float]


class Spec(Shown, frozen=True, kw_only=True):
    """What a swarm is made from: same spec, same seed, same bytes.

    Attributes:
        n: The number of individuals at the start: 1 to the daemon's limit.
        pi1: Length over width of a body: 1 (a disc) to 32.
        pi2: Weight of individuals informed without a weight: 0 or more.
        pi3: Body size over turning radius: above 0.
        pi4: Translational over rotational drag: above 0.
        dt: The time step: above 0, and short enough that no body is carried across another.
        contacts: Which of a pair's contacts constrain it: `"endpoints"`; `"closest"`, the one
            with the smallest gap alone; or, to compare, `"clamped"`, with implied ones too.
        stepping: What a contact limits: `"position"`, the gap after the step, or `"velocity"`,
            the speed at which touching bodies close.
        relinearise: 1 to solve another program about what the first predicts, which leaves less
            overlap and goes with `"position"` alone; 0 not to.
        seed: The seed of every draw: 0 to 2⁵³ - 1.
        start: Where the individuals begin.
        attraction: What an individual turns towards: `{"kind": "all"}`, and if wanted an
            `"accuracy"` from 1e-9 to 1e-3, quicker from some thousand individuals on (measured,
            no bound: in several flocks far apart the error is up to ten times as much);
            `{"kind": "voronoi"}`, `{"kind": "metric", "radius": 3.0}`,
            `{"kind": "topological", "neighbours": 7}` or `{"kind": "power", "exponent": -1.0}`.
        noise: Intensity of white noise on the turning rate, squared angle over time: 0 or more.
        publish_every: Steps between two published states: 1 or more.
        rate: Time units per second of wall clock; None is as fast as possible.
    """

    n: int
    pi1: float = 4.0
    pi2: float = 0.5
    pi3: float = 1.0
    pi4: float = 10.0
    dt: float = 0.02
    contacts: str = "endpoints"
    stepping: str = "position"
    relinearise: int = 0
    seed: int = 0
    start: Disc | Given = Disc()
    attraction: dict[str, Any] = msgspec.field(default_factory=lambda: {"kind": "all"})
    noise: float = 0.0
    publish_every: int = 5
    rate: float | None = 1.0
