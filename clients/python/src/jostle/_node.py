"""Replies of a daemon about itself, as msgspec structs."""

from __future__ import annotations

from typing import Any

import msgspec

from ._messages import Phase
from ._repr import HtmlStruct

WIRE_VERSION = 1
"""The version of the contract that this package speaks."""


class Limits(HtmlStruct, frozen=True, kw_only=True):
    """The limits of a daemon.

    Attributes:
        max_individuals: Individuals of a swarm.
        max_swarms: Swarms.
        max_memory_bytes: Memory of all swarms.
        max_message_bytes: Bytes of a request; this package rejects a longer one.
        max_clients: Connected clients; beyond it `connect` raises `ResourceExhausted`.
        max_hz: Published states per second and swarm.
    """

    max_individuals: int
    max_swarms: int
    max_memory_bytes: int
    max_message_bytes: int
    max_clients: int
    max_hz: int


class Hello(HtmlStruct, frozen=True, kw_only=True):
    """The name, version and limits of a daemon.

    Attributes:
        node: The daemon's name.
        version: The daemon's version.
        wire_version: The version of the contract that it speaks.
        unix_secs: Its clock: seconds since 1970, UTC.
        limits: Its limits.
        http: The address of its HTTP server, such as `https://0.0.0.0:8443`; None if it has none.
        data_id: Its data folder, by a number that the daemon drew when it began the folder's
            database; None of a daemon that knows none. A restored backup has another one.
    """

    node: str
    version: str
    wire_version: int
    unix_secs: float
    limits: Limits
    http: str | None = None
    data_id: str | None = None


class NodeStatus(HtmlStruct, frozen=True, kw_only=True):
    """The status of a daemon.

    Attributes:
        node: The daemon's name.
        uptime_secs: Seconds since it started.
        swarms: Number of swarms.
        running: Number of running swarms.
        faulted: Number of faulted swarms.
        individuals: Number of individuals in all swarms.
        memory_bytes: Memory reserved for the swarms and the running experiment.
        experiments_memory_bytes: Of it, memory reserved for the running experiment.
        clients: Number of connected clients.
    """

    node: str
    uptime_secs: float
    swarms: int
    running: int
    faulted: int
    individuals: int
    memory_bytes: int
    experiments_memory_bytes: int
    clients: int


class SwarmSummary(HtmlStruct, frozen=True, kw_only=True):
    """A swarm in the list of a daemon.

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
    """The swarms of the daemon `node`, ordered by name."""

    node: str
    swarms: list[SwarmSummary]


class Schemas(msgspec.Struct, frozen=True, kw_only=True):
    """The JSON Schemas (2020-12) of every message.

    Attributes:
        node: The daemon's name.
        wire_version: The version of the contract that they describe.
        schemas: The schemas by the name of the message, such as `step.args` and `step.reply`.
    """

    node: str
    wire_version: int
    schemas: dict[str, Any]
