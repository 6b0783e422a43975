"""What was asked of the daemon, and what it said."""

from __future__ import annotations

import json
import threading
import time
import uuid
from dataclasses import dataclass, field
from typing import Any

import jostle

# What is sent again after trouble waits so long.
_AGAIN_SECS = 0.1
# Who has no answer for so long gives up, which no promise allows for.
_PATIENCE_SECS = 120.0


@dataclass
class Asked:
    """A command under one name, until it is answered or given up.

    Attributes:
        swarm: Whose; None if it is the daemon's.
        key: Where it goes.
        verb: Its verb.
        args: Its arguments.
        at_step: The step it waits for.
        client: Who sends it.
        request_id: What it is called.
        tries: How often it was sent until it had an answer.
        silences: How often nothing at all came back.
        refusals: With which codes it was refused; nothing may have changed by those.
        answer: What was answered, to the byte.
        sent: When it was first sent, on the monotonic clock.
        answered: When it had its answer.
        again: Whether each later sending had the same answer.
    """

    swarm: str | None
    key: str
    verb: str
    args: dict[str, Any]
    at_step: int | None
    client: str
    request_id: str
    tries: int = 0
    silences: int = 0
    refusals: list[str] = field(default_factory=list)
    answer: bytes | None = None
    sent: float = field(default_factory=time.monotonic)
    answered: float = 0.0
    again: list[bool] = field(default_factory=list)

    @property
    def reply(self) -> dict[str, Any]:
        """The answer, read; empty if there is none."""
        read: dict[str, Any] = {} if self.answer is None else json.loads(self.answer)
        return read

    @property
    def is_durable(self) -> bool:
        """Whether it was answered, and the answer means that no crash takes it back."""
        return self.answer is not None and self.verb not in ("step", "advance")


class Ledger:
    """Everything that was asked, in the order in which each who asked began to."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: list[Asked] = []

    def all(self) -> list[Asked]:
        """All of it so far."""
        with self._lock:
            return list(self._asked)

    def note(self, asked: Asked) -> None:
        """Adds what is about to be sent."""
        with self._lock:
            self._asked.append(asked)


class Asker:
    """One who asks under a name of its own, and does not let go before there is an answer."""

    def __init__(self, client: jostle.Client, name: str, ledger: Ledger) -> None:
        self.client = client
        self.name = name
        self._ledger = ledger

    def ask(
        self,
        swarm: str | None,
        verb: str,
        args: dict[str, Any],
        *,
        at_step: int | None = None,
        patient: bool = False,
    ) -> Asked:
        """Asks until there is an answer or a refusal; `patient` goes on while the disk is full."""
        link = self.client._link
        if swarm is None:
            key = link.node_key(self.client.node, f"cmd/{verb}")
        else:
            key = link.swarm_key(swarm, f"cmd/{verb}")
        asked = Asked(swarm, key, verb, args, at_step, self.name, uuid.uuid4().hex)
        self._ledger.note(asked)
        while asked.answer is None and time.monotonic() < asked.sent + _PATIENCE_SECS:
            asked.tries += 1
            try:
                asked.answer = self._send(asked)
                asked.answered = time.monotonic()
            except jostle.JostleError as error:
                if is_silence(error):
                    asked.silences += 1
                else:
                    asked.refusals.append(error.code)
                    if not (isinstance(error, jostle.StorageFull) and patient):
                        break
                time.sleep(_AGAIN_SECS)
        return asked

    def ask_again(self, asked: Asked) -> None:
        """Sends what was answered once more, and notes whether the answer is the same.

        It goes under the name of whoever sent it first.
        """
        self.client._link.client = asked.client
        give_up = time.monotonic() + _PATIENCE_SECS
        while time.monotonic() < give_up:
            try:
                asked.again.append(self._send(asked) == asked.answer)
            except jostle.JostleError as error:
                if not is_silence(error):
                    break
                time.sleep(_AGAIN_SECS)
            else:
                return
        asked.again.append(False)

    def _send(self, asked: Asked) -> bytes:
        return self.client._link.command(
            asked.key,
            asked.args,
            swarm=asked.swarm,
            at_step=asked.at_step,
            timeout=5.0,
            request_id=asked.request_id,
        )


def is_silence(error: jostle.JostleError) -> bool:
    """Whether it means that the daemon is away or slow, and not that it refused."""
    return isinstance(error, jostle.Unavailable | jostle.Busy | jostle.DeadlineExceeded) or bool(
        error.details.get("is_silence")
    )
