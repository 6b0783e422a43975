"""The changes of a swarm that a `batch` is made of: the arguments of their verbs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import msgspec

from ._arguments import Pose, Region, Select
from ._errors import InvalidArgument


class Set(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Changes the parameters named, and no others.

    Attributes:
        pi1: Length over width of a body: 1 to 32.
        pi2: Weight of individuals informed without one; those informed keep theirs.
        pi3: Body size over turning radius: above 0.
        pi4: Translational over rotational drag: above 0.
        contacts: `endpoints`, `closest` or `clamped`; all but `closest` need that no axes cross.
        stepping: `position` or `velocity`.
        relinearise: How many more programs a step solves: 0 or 1.
        attraction: What an individual turns towards, such as `{"kind": "voronoi"}`; see `Spec`.
        noise: Intensity of white noise on the turning rate: 0 or more.
        publish_every: Steps between two published states: 1 or more.
        make_room: With `pi1`: scale positions about the centroid by the least factor that lets
            the longer bodies in.
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
    make_room: bool = False


class Inform(msgspec.Struct, frozen=True, omit_defaults=True):
    """Gives individuals a direction of their own.

    Attributes:
        select: Whom, such as `jostle.fraction(0.1)`; draws are from the whole group.
        direction: Theirs, radians, counter-clockwise from +x.
        weight: How much it counts beside attraction: above 0; None is `pi2`.
        for_time: After so many time units they are uninformed again; None is for good.
    """

    verb: ClassVar[str] = "inform"

    select: Select
    direction: float
    weight: float | None = None
    for_time: float | None = None


class Uninform(msgspec.Struct, frozen=True):
    """Takes individuals' direction away.

    Attributes:
        select: Whose, such as `jostle.ids([1, 2])`; draws are from the informed.
    """

    verb: ClassVar[str] = "uninform"

    select: Select


class Inject(msgspec.Struct, frozen=True, omit_defaults=True):
    """Adds individuals, informed or not, where they overlap nobody. One of `count` and `at`.

    Attributes:
        count: How many, drawn at the border of the group or `within` a disc.
        at: Exactly there instead; `jostle.poses` makes it from an array.
        within: With `count`: absolute centre and radius of the disc, body sizes.
        direction: Informs them: their preferred direction in radians.
        weight: With `direction`: how much it counts beside attraction; None is `pi2`.
    """

    verb: ClassVar[str] = "inject"

    count: int | None = None
    at: list[Pose] | None = None
    within: Region | None = None
    direction: float | None = None
    weight: float | None = None


class Remove(msgspec.Struct, frozen=True):
    """Takes individuals out of the group. The last one cannot be removed.

    Attributes:
        select: Whom, such as `jostle.count(3)`; draws are from the whole group.
    """

    verb: ClassVar[str] = "remove"

    select: Select


Change = Set | Inform | Uninform | Inject | Remove
"""What a `batch` takes several of."""


def commands(changes: Iterable[Change | Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The changes of a `batch` as the wire has them.

    Raises:
        InvalidArgument: They are not several, or one of them is no change.
    """
    if not isinstance(changes, Iterable):
        raise InvalidArgument(
            f"commands is {changes!r}, but must be several changes, such as [jostle.Set(pi3=2)]",
            details={"field": "commands"},
        )
    written = []
    for index, change in enumerate(changes):
        if isinstance(change, Change):
            written.append({"verb": change.verb, "args": change})
        elif isinstance(change, Mapping):
            written.append(dict(change))
        else:
            raise InvalidArgument(
                f"commands[{index}] is {change!r}, but must be a change such as jostle.Set(pi3=2)",
                details={"field": f"commands[{index}]"},
            )
    return written
