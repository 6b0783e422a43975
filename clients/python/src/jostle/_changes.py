"""The changes of a swarm: the arguments of `set`, `inform`, `uninform`, `inject` and `remove`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import msgspec

from ._arguments import Pose, Region, Select
from ._errors import invalid


class Set(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Changes parameters, in a `batch`; a parameter that is None does not change.

        swarm.batch([jostle.Set(pi3=2.0), jostle.Set(noise=0.1)])

    Attributes:
        pi1: See `Swarm.set`.
        pi2: See `Swarm.set`.
        pi3: See `Swarm.set`.
        pi4: See `Swarm.set`.
        contacts: See `Swarm.set`.
        stepping: See `Swarm.set`.
        relinearise: See `Swarm.set`.
        attraction: See `Swarm.set`.
        noise: See `Swarm.set`.
        publish_every: See `Swarm.set`.
        measures: See `Swarm.set`.
        max_idle_secs: See `Swarm.set`.
        make_room: See `Swarm.set`.
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
    """Informs individuals, in a `batch`.

        swarm.batch([jostle.Inform(jostle.ids([0, 1]), direction=0.0, weight=2.0)])

    Attributes:
        select: See `Swarm.inform`.
        direction: See `Swarm.inform`; radians, counter-clockwise from +x.
        weight: See `Swarm.inform`.
        for_time: See `Swarm.inform`; body sizes over free speed.
    """

    verb: ClassVar[str] = "inform"

    select: Select
    direction: float
    weight: float | None = None
    for_time: float | None = None


class Uninform(msgspec.Struct, frozen=True):
    """Removes the preferred direction of individuals, in a `batch`.

    Attributes:
        select: See `Swarm.uninform`.
    """

    verb: ClassVar[str] = "uninform"

    select: Select


class Inject(msgspec.Struct, frozen=True, omit_defaults=True):
    """Adds individuals, in a `batch`; give one of `count` and `at`.

        swarm.batch([jostle.Inject(at=jostle.poses([[12.0, 0.0, math.pi]]))])

    Attributes:
        count: See `Swarm.inject`.
        at: Their poses; `jostle.poses` makes them from an array.
        within: With `count`: the disc, absolute centre and radius in body sizes.
        direction: See `Swarm.inject`; radians, counter-clockwise from +x.
        weight: See `Swarm.inject`.
    """

    verb: ClassVar[str] = "inject"

    count: int | None = None
    at: list[Pose] | None = None
    within: Region | None = None
    direction: float | None = None
    weight: float | None = None


class Remove(msgspec.Struct, frozen=True):
    """Removes individuals from the group, in a `batch`. The last one cannot be removed.

    Attributes:
        select: See `Swarm.remove`.
    """

    verb: ClassVar[str] = "remove"

    select: Select


Change = Set | Inform | Uninform | Inject | Remove
"""A change of a `batch`."""


def commands(changes: Iterable[Change | Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The changes of a `batch` as on the wire.

    Raises:
        InvalidArgument: They are no iterable, or one of them is no change.
    """
    if not isinstance(changes, Iterable):
        raise invalid(
            "commands",
            f"commands is {changes!r}, but must be several changes, such as [jostle.Set(pi3=2)]",
        )
    encoded = []
    for index, change in enumerate(changes):
        if isinstance(change, Change):
            encoded.append({"verb": change.verb, "args": change})
        elif isinstance(change, Mapping):
            encoded.append(dict(change))
        else:
            raise invalid(
                f"commands[{index}]",
                f"commands[{index}] is {change!r}, but must be a change such as jostle.Set(pi3=2)",
            )
    return encoded
