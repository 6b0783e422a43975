"""The requests sent to the daemon, with their replies and errors."""

from __future__ import annotations

import json
import threading
import time
import uuid
from dataclasses import dataclass, field
from typing import Any

import jostle

# The pause before a request is sent again.
_RETRY_SECS = 0.1
# A request without a reply after this time is given up, which violates a guarantee.
_TIMEOUT_SECS = 120.0


@dataclass
class Request:
    """A command with one `request_id`, from its first sending to its reply.

    Attributes:
        swarm: Its swarm; None for a command to the daemon.
        key: Its key on the bus.
        verb: Its verb.
        args: Its arguments.
        at_step: The step for which it is scheduled.
        client: The name of the client.
        request_id: Its id.
        tries: How often it was sent until it had a reply.
        timeouts: How often neither a reply nor an error arrived.
        errors: The codes with which it was rejected; none of these may have changed the swarm.
        answer: The bytes of the reply.
        sent: When it was first sent, on the monotonic clock.
        answered: When the reply arrived.
        resent: For each later sending whether it got the same reply.
    """

    swarm: str | None
    key: str
    verb: str
    args: dict[str, Any]
    at_step: int | None
    client: str
    request_id: str
    tries: int = 0
    timeouts: int = 0
    errors: list[str] = field(default_factory=list)
    answer: bytes | None = None
    sent: float = field(default_factory=time.monotonic)
    answered: float = 0.0
    resent: list[bool] = field(default_factory=list)

    @property
    def reply(self) -> dict[str, Any]:
        """The decoded reply; empty if there is none."""
        read: dict[str, Any] = {} if self.answer is None else json.loads(self.answer)
        return read

    def is_pending_at(self, times: list[float]) -> bool:
        """Whether it was sent, and had neither a reply nor an error, at one of these times."""
        if self.errors:
            return False
        return any(
            self.sent < time and (self.answer is None or time < self.answered) for time in times
        )

    @property
    def is_durable(self) -> bool:
        """Whether it has a reply that promises durability."""
        return self.answer is not None and self.verb not in ("step", "advance")


class RequestLog:
    """All requests, in the order in which they were first sent."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._requests: list[Request] = []

    def all(self) -> list[Request]:
        """All requests so far."""
        with self._lock:
            return list(self._requests)

    def add(self, request: Request) -> None:
        """Adds a request before it is sent."""
        with self._lock:
            self._requests.append(request)


class Requester:
    """Sends requests of one client until each has a reply or an error."""

    def __init__(self, client: jostle.Client, name: str, requests: RequestLog) -> None:
        self.client = client
        self.name = name
        self._log = requests

    def send(
        self,
        swarm: str | None,
        verb: str,
        args: dict[str, Any],
        *,
        at_step: int | None = None,
        retry_when_full: bool = False,
    ) -> Request:
        """Sends a request until it has a reply or an error, which may exclude `storage_full`."""
        session = self.client._session
        if swarm is None:
            key = session.node_key(self.client.node, f"cmd/{verb}")
        else:
            key = session.swarm_key(swarm, f"cmd/{verb}")
        request = Request(swarm, key, verb, args, at_step, self.name, uuid.uuid4().hex)
        self._log.add(request)
        while request.answer is None and time.monotonic() < request.sent + _TIMEOUT_SECS:
            request.tries += 1
            try:
                request.answer = self._send(request)
                request.answered = time.monotonic()
            except jostle.JostleError as error:
                if is_timeout(error):
                    request.timeouts += 1
                else:
                    request.errors.append(error.code)
                    if not (isinstance(error, jostle.StorageFull) and retry_when_full):
                        break
                time.sleep(_RETRY_SECS)
        return request

    def resend(self, request: Request) -> None:
        """Sends a request again under its first client and id, and compares the replies."""
        self.client._session.client = request.client
        deadline = time.monotonic() + _TIMEOUT_SECS
        while time.monotonic() < deadline:
            try:
                request.resent.append(self._send(request) == request.answer)
            except jostle.JostleError as error:
                if not is_timeout(error):
                    break
                time.sleep(_RETRY_SECS)
            else:
                return
        request.resent.append(False)

    def _send(self, request: Request) -> bytes:
        return self.client._session.command(
            request.key,
            request.args,
            swarm=request.swarm,
            at_step=request.at_step,
            timeout=5.0,
            request_id=request.request_id,
        )


def is_timeout(error: jostle.JostleError) -> bool:
    """Whether the daemon was unreachable or slow, and did not reject the request."""
    return isinstance(error, jostle.Unavailable | jostle.Busy | jostle.DeadlineExceeded) or bool(
        error.details.get("is_silence")
    )
