"""What a daemon says of itself, as msgspec structs."""

from __future__ import annotations

from typing import Any

import msgspec

from ._messages import Phase
from ._show import Shown

WIRE_VERSION = 1
"""The version of the contract this package speaks."""


class Limits(Shown, frozen=True, kw_only=True):
    """What a daemon refuses to go beyond.

    Attributes:
        max_individuals: In one swarm.
        max_swarms: At once.
        max_memory_bytes: Of all swarms together.
        max_message_bytes: Of a request; a longer one is refused before it is sent.
        max_clients: At once; while there are more `connect` raises `ResourceExhausted`.
        max_hz: States published per second and swarm.
    """

    max_individuals: int
    max_swarms: int
    max_memory_bytes: int
    max_message_bytes: int
    max_clients: int
    max_hz: int


class Hello(Shown, frozen=True, kw_only=True):
    """Who a daemon is.

    Attributes:
        node: Its name.
        version: Its version.
        wire_version: The version of the contract it speaks.
        unix_secs: Its clock: seconds since 1970, UTC.
        limits: What it refuses to go beyond.
        http: Where it serves HTTP, such as `https://0.0.0.0:8443`; None if it serves none.
    """

    node: str
    version: str
    wire_version: int
    unix_secs: float
    limits: Limits
    http: str | None = None


class NodeStatus(Shown, frozen=True, kw_only=True):
    """How a daemon fares.

    Attributes:
        node: Its name.
        uptime_secs: Seconds since it started.
        swarms: How many it hosts.
        running: How many of them run.
        faulted: How many of them faulted.
        individuals: In all swarms together.
        memory_bytes: Set aside for the swarms.
        clients: Connected.
    """

    node: str
    uptime_secs: float
    swarms: int
    running: int
    faulted: int
    individuals: int
    memory_bytes: int
    clients: int


class SwarmSummary(Shown, frozen=True, kw_only=True):
    """A swarm in a list.

    The fields are as in `Status`. `order` is the current value; `replay` is true for a playback.
    `contested_by` is another daemon that has a swarm of this name (see `Contested`), or None.
    """

    swarm: str
    phase: Phase
    reason: str | None = None
    step: int
    time: float
    n: int
    informed: int
    order: float
    rate: float | None = None
    real_time_factor: float | None = None
    replay: bool
    contested_by: str | None = None


class Swarms(msgspec.Struct, frozen=True, kw_only=True):
    """All that the daemon `node` hosts, ordered by name."""

    node: str
    swarms: list[SwarmSummary]


class Schemas(msgspec.Struct, frozen=True, kw_only=True):
    """The JSON Schemas (2020-12) of every message.

    Attributes:
        node: The daemon that told.
        wire_version: The version of the contract they describe.
        schemas: By the name of the message, such as `step.args` and `step.reply`.
    """

    node: str
    wire_version: int
    schemas: dict[str, Any]
