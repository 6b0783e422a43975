"""The starts of a swarm; its spec is in `_wire`."""

from __future__ import annotations

import msgspec


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
