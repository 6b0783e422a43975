"""The changes of a `batch`: the arguments of some commands.

Written by `cargo run --release -p jostle-contract`; not by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import msgspec

from ._arguments import Pose, Region, Select


class Set(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Changes the given parameters, at least one.

    A new `pi2` is not that of individuals informed before; `contacts` other than `closest` require
    that no axes cross.

    Attributes:
        pi1: Length over width of a body: 1 (a disc) to 32.
        pi2: Weight of individuals that are informed without a weight: 0 to 10⁶.
        pi3: Body size over turning radius: above 0, to 10⁶.
        pi4: Translational over rotational drag: above 0, to 10⁶.
        contacts: Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one
            with the smallest gap; or, for comparison, `clamped`, which adds redundant ones.
        stepping: What a contact limits: `position`, the gap after the step, or `velocity`, the
            speed at which touching bodies approach each other.
        relinearise: Number of further programs that a step solves about the result of the last one:
            0, or 1, which leaves less overlap and requires `position`.
        attraction: The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes
            faster from some thousand individuals on; others are `voronoi`, `metric` with a `radius`
            in body sizes, `topological` with a number of `neighbours`, and `power` with an
            `exponent`.
        noise: Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶. In
            free speed / body size.
        publish_every: Number of steps between two published states: 1 or more.
        measures: The measures in each published order, such as `milling`, at most 16 that need no
            earlier state; none if empty.
        max_idle_secs: Remove a controller in lock-step for which the swarm has waited so many
            seconds, and which has sent nothing meanwhile: 0.1 to 10⁶; 0 is no limit, as in a new
            swarm.
        make_room: With `pi1`: scale all positions about the centroid by the smallest factor that
            lets longer bodies fit.
    """

    verb: ClassVar[str] = "set"

    pi1: float | None = None
    pi2: float | None = None
    pi3: float | None = None
    pi4: float | None = None
    contacts: str | None = None
    stepping: str | None = None
    relinearise: int | None = None
    attraction: dict[str, Any] | None = None
    noise: float | None = None
    publish_every: int | None = None
    measures: Sequence[str] | None = None
    max_idle_secs: float | None = None
    make_room: bool = False


class Inform(msgspec.Struct, frozen=True, omit_defaults=True):
    """Gives individuals a direction of their own.

    Attributes:
        select: The individuals; draws are from all.
        direction: Their preferred direction in radians, counter-clockwise from +x.
        weight: The weight of that direction beside attraction: above 0; `pi2` if None.
        for_time: The time after which they are uninformed again, body sizes over free speed; for
            good if None.
    """

    verb: ClassVar[str] = "inform"

    select: Select
    direction: float
    weight: float | None = None
    for_time: float | None = None


class Uninform(msgspec.Struct, frozen=True, omit_defaults=True):
    """Takes the preferred direction of individuals away.

    Attributes:
        select: The individuals; draws are from the informed.
    """

    verb: ClassVar[str] = "uninform"

    select: Select


class Inject(msgspec.Struct, frozen=True, omit_defaults=True):
    """Adds individuals, informed or not, where they overlap no other one.

    One of `count` and `at`.

    Attributes:
        count: Their number, at the border of the group, or in `within`.
        at: Their poses.
        within: With `count`: the disc in which they are drawn, absolute centre and radius in body
            sizes.
        direction: Informs them: their preferred direction in radians, counter-clockwise from +x.
        weight: With `direction`: its weight beside attraction; `pi2` if None.
    """

    verb: ClassVar[str] = "inject"

    count: int | None = None
    at: list[Pose] | None = None
    within: Region | None = None
    direction: float | None = None
    weight: float | None = None


class Remove(msgspec.Struct, frozen=True, omit_defaults=True):
    """Takes individuals out of the group.

    The last one cannot be removed.

    Attributes:
        select: The individuals; draws are from all.
    """

    verb: ClassVar[str] = "remove"

    select: Select


Change = Set | Inform | Uninform | Inject | Remove
"""A change of a `batch`."""
