"""The parts of the tables of arguments."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from recorder import FRESH, NODE, SNAPSHOT, TOKEN, Sent

CLIENT, TIMEOUT_SECS = "ada@lab", 7.5
"""The name of every client of the tables, and its timeout."""


@dataclass(frozen=True)
class Arguments:
    """The arguments of a call."""

    args: tuple[Any, ...]
    kwargs: dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A call, and what the client must send.

    Attributes:
        call: The class and the method, or the function.
        arguments: Its arguments.
        sent: Every message, in order.
        joined: What a controller had joined with.
        name: The name of that controller.
    """

    call: str
    arguments: Arguments
    sent: list[Sent]
    joined: dict[str, Any] = field(default_factory=dict)
    name: str = "ada"


@dataclass(frozen=True)
class File:
    """A placeholder for a path that each test creates."""

    name: str

    def make(self, folder: Path) -> Path:
        """Creates it in an empty folder."""
        path = folder / self.name
        match self.name:
            case "half":
                path.mkdir()
                (path / "part-00000.mcap").write_bytes(b"MCAP")
                (path / ".part-00001.mcap.partial").write_bytes(b"MC")
            case "tape.mcap":
                path.write_bytes(TAPE)
            case "long.mcap":
                path.write_bytes(LONG)
            case "points.toml":
                path.write_text(FILES, encoding="utf-8")
                (folder / "t.csv").write_text("step,id,direction\n", encoding="utf-8")
                (folder / "p.csv").write_text("n\n3\n", encoding="utf-8")
                (folder / "s.snapshot").write_bytes(b"snapshot")
            case "plan.toml":
                path.write_text(PLAN, encoding="utf-8")
            case "school.snapshot":
                path.write_bytes(SNAPSHOT)
        return path


_MCAP = b"\x89MCAP0\r\n"
TAPE = _MCAP + b"tape" + _MCAP
LONG = _MCAP + bytes(200_000) + _MCAP
PLAN = 'name = "small"\nduration = 10\n'
FILES = PLAN + 'points = "p.csv"\nstart = "s.snapshot"\nsetpoints = "t.csv"\n'


@dataclass(frozen=True)
class AtMost:
    """A selector that ends in a number of seconds, at most as many and more than half of it."""

    start: str
    seconds: float

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, str) or not other.startswith(self.start):
            return False
        return self.seconds / 2 < float(other.removeprefix(self.start)) <= self.seconds

    def __hash__(self) -> int:
        return hash(self.start)


@dataclass(frozen=True, eq=False)
class AnyId:
    """A selector that contains the id of a wait, between these parts."""

    start: str
    end: str

    def __eq__(self, other: object) -> bool:
        return isinstance(other, str) and other.startswith(self.start) and other.endswith(self.end)

    def __hash__(self) -> int:
        return hash(self.start)


def call(*args: Any, **kwargs: Any) -> Arguments:
    """The arguments of a call."""
    return Arguments(args, kwargs)


def parameters(rows: list[Row]) -> list[Any]:
    """The rows as parameters of a test, named by their calls."""
    return [pytest.param(row, id=f"{row.call}-{index}") for index, row in enumerate(rows)]


def cmd(verb: str, args: dict[str, Any], swarm: str = "school", **envelope: Any) -> Sent:
    """A command to a swarm."""
    return Sent(f"jostle/{swarm}/cmd/{verb}", _request(args, envelope))


def node_cmd(verb: str, args: dict[str, Any], **envelope: Any) -> Sent:
    """A command to the daemon itself."""
    return Sent(f"jostle/@node/{NODE}/cmd/{verb}", _request(args, envelope))


def get(rest: str) -> Sent:
    """A query of a swarm."""
    return Sent(f"jostle/school/{rest}")


def node_get(rest: str) -> Sent:
    """A query of the daemon itself."""
    return Sent(f"jostle/@node/{NODE}/{rest}")


def put(points: dict[str, Any]) -> Sent:
    """Set-points, which have no reply."""
    return Sent("jostle/school/ctl/ada", {"sequence": FRESH, "set": points}, TOKEN)


def _request(args: dict[str, Any], envelope: dict[str, Any]) -> dict[str, Any]:
    request = {"request_id": FRESH, "client": CLIENT, "timeout_secs": TIMEOUT_SECS, "args": args}
    return {**request, **envelope}
