"""The options of every command."""

from __future__ import annotations

from typing import SupportsIndex, TypedDict


class Options(TypedDict, total=False):
    """The options of every command.

        swarm.set(pi3=2.0, expect_step=100, timeout=1.0)

    Attributes:
        expect_step: Raise `Conflict` and change nothing unless the swarm is at this step.
        expect_epoch: Raise `Conflict` and change nothing unless the swarm is in this epoch.
        timeout: Seconds the command may take; the client's `timeout` if left out.
        request_id: The id of the request, 1 to 256 bytes; a new one if left out. The daemon
            executes a request id only once for all clients of the same `client` name: a repeated
            command gets the first reply, and another command with that id raises `Conflict`.
    """

    expect_step: SupportsIndex
    expect_epoch: SupportsIndex
    timeout: float
    request_id: str


def check_options(verb: str, options: Options) -> None:
    """Rejects unknown options.

    Raises:
        TypeError: One of them is unknown.
    """
    for name in options:
        if name not in Options.__annotations__:
            hint = f"; use at(step).{verb}()" if name == "at_step" else ""
            raise TypeError(f"{verb}() got an unexpected keyword argument {name!r}{hint}")
