"""The spec of a swarm."""

from __future__ import annotations

import functools
from typing import Any

import msgspec

from ._repr import HtmlStruct


class Disc(msgspec.Struct, frozen=True, tag_field="kind", tag="disc", omit_defaults=True):
    """A start: individuals drawn uniformly in a disc, without overlap.

    Attributes:
        radius: Radius of the disc, body sizes; None is √n, at least 1.
    """

    radius: float | None = None


class Given(msgspec.Struct, frozen=True, tag_field="kind", tag="given"):
    """A start: every individual at an exact pose. `jostle.given` makes one from arrays.

    Attributes:
        x: Absolute positions, body sizes, n of them.
        y: Absolute positions, body sizes, n of them.
        alpha: Headings in radians, n of them.
    """

    x: list[float]
    y: list[float]
    alpha: list[float]


class Spec(HtmlStruct, frozen=True, kw_only=True):
    """The spec of a swarm: equal specs give equal states, bit for bit.

        spec = jostle.Spec(n=50, seed=1, pi3=2.0, attraction={"kind": "metric", "radius": 3.0})

    Table 1 of the paper defines π1 to π4; a step solves eq. (7), Principle 1.

    Attributes:
        n: Number of individuals at the start: 1 to the daemon's limit.
        pi1: π1, length over width of a body: 1 (a disc) to 32.
        pi2: π2, weight of individuals that are informed without a weight: 0 to 10⁶.
        pi3: π3, body size over turning radius: above 0, to 10⁶.
        pi4: π4, translational over rotational drag: above 0, to 10⁶.
        dt: The time step, body sizes over free speed: above 0, and so short that no point of a
            body's axis travels further than a body's width.
        contacts: Which contacts of a pair constrain a step: `"endpoints"`; `"closest"`, only the
            one with the smallest gap, as in the paper's appendix; or, for comparison, `"clamped"`,
            which adds redundant ones.
        stepping: What a contact limits: `"position"`, the gap after the step, or `"velocity"`, the
            speed at which touching bodies approach each other.
        relinearise: 1 solves a second program about the result of the first, which leaves less
            overlap and requires `"position"`; 0 does not.
        seed: The seed of all random draws: 0 to 2⁵³ - 1.
        start: Where the individuals begin: `jostle.disc` or `jostle.given`.
        attraction: The law of attraction. `{"kind": "all"}` is eq. (4); with an `"accuracy"` from
            1e-9 to 1e-3 it is faster from some thousand individuals on (a measured error, not a
            bound: for several flocks far apart it is up to ten times larger). Others are
            `{"kind": "voronoi"}`, `{"kind": "metric", "radius": 3.0}`,
            `{"kind": "topological", "neighbours": 7}` and `{"kind": "power", "exponent": -1.0}`.
        noise: Intensity of white noise on the turning rate, squared radians per time unit: 0 to
            10⁶. Not in the paper.
        publish_every: Number of steps between two published states: 1 or more.
        measures: The measures in each published order; see `Swarm.set`. Unset for none.
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
    measures: list[str] | msgspec.UnsetType = msgspec.UNSET
    rate: float | None = 1.0

    def __reduce__(self) -> tuple[object, ...]:
        # Without fields that are not set: picklers search all modules for the name of `UNSET`.
        given = {name: getattr(self, name) for name in self.__struct_fields__}
        given = {name: value for name, value in given.items() if value is not msgspec.UNSET}
        return functools.partial(type(self), **given), ()
