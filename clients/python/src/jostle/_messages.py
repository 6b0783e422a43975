"""Replies of swarms that have more than the contract, or less; the others are in `_wire`."""

from __future__ import annotations

from typing import Generic, TypeVar

from ._wire import Reply, Spec

T = TypeVar("T")


class Scheduled(Reply, Generic[T], frozen=True, kw_only=True):
    """The reply to a command of `Swarm.at`.

    If the step lies ahead, the command waits: at that step an event `command` of the same
    `request_id` reports that it was executed, or an event `refused` why it was not. If the swarm
    was at the step, the command was executed at once.

    Attributes:
        applies_at_step: The step at which the command is or was executed.
        outcome: What the method of `Swarm` returns, if the command was executed at once; None if it
            waits.
    """

    applies_at_step: int
    outcome: T | None = None


class SpecReply(Reply, frozen=True, kw_only=True):
    """The spec of a swarm, with all defaults."""

    result: Spec
