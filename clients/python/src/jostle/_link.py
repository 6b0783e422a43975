"""A zenoh session with the daemons at one endpoint: what requests and streams are made of."""

from __future__ import annotations

import os
import time
import weakref
from collections.abc import Iterator
from typing import Protocol

import zenoh

from . import _cancel
from ._errors import Unavailable, read_error
from ._shutdown import forked, open_sessions
from ._waits import WaitIds

LIVELINESS_TIMEOUT_SECS = 2.0
"""The timeout of a query for liveliness tokens."""

POLL_INTERVAL_SECS = 0.02
"""The interval of checks for a connection, or for the end of a contest."""

# A query that ends without a reply after this share of its timeout ended because of it.
_LATE_SHARE = 0.9


class _Stream(Protocol):
    """A stream of the session."""

    subscribers: list[zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]]

    def close(self) -> None:
        """Unsubscribes."""


class _Private(Protocol):
    """A private daemon."""

    def has_ended(self) -> bool:
        """Whether its process has ended."""


class Link:
    """A zenoh session with the daemons at one endpoint, and what every request contains."""

    def __init__(
        self,
        zenoh_session: zenoh.Session,
        endpoint: str,
        prefix: str,
        client: str,
        timeout: float,
        token: str | None = None,
    ) -> None:
        self.zenoh = zenoh_session
        self.endpoint = endpoint
        self.prefix = prefix
        self.client = client
        self.timeout = timeout
        self._token = token
        self.max_message_bytes: int | None = None
        # A private daemon, which lives as long as the session.
        self.keepalive: _Private | None = None
        self.streams: weakref.WeakSet[_Stream] = weakref.WeakSet()
        # Controllers, whose liveliness tokens are zenoh's.
        self.controllers: weakref.WeakSet[object] = weakref.WeakSet()
        self.wait_ids = WaitIds()
        self._owner = os.getpid()
        open_sessions.add(self)

    def close(self) -> None:
        """Closes every stream and the session; a second call does nothing."""
        if not self.is_ours():
            return
        for stream in list(self.streams):
            stream.close()
        self.zenoh.close()

    def __reduce__(self) -> tuple[object, ...]:
        # Of clients, swarms, controllers and streams alike, when one is pickled or copied deeply.
        raise TypeError(
            "a connection to a daemon cannot be pickled or copied: pass the endpoint and the name "
            f"of the swarm instead, and call `jostle.connect({self.endpoint!r}).swarm(name)` there"
        )

    def is_ours(self) -> bool:
        """Whether this process opened it, not one that this process was forked from.

        A forked process has none of zenoh's threads, and would wait for them forever.
        """
        return os.getpid() == self._owner

    def is_open(self) -> bool:
        """Whether this process opened it and has not closed it."""
        return self.is_ours() and not self.zenoh.is_closed()

    def is_over(self) -> bool:
        """Whether no later request can have a reply: it is closed, or its private daemon ended."""
        private = self.keepalive
        return not self.is_open() or (private is not None and private.has_ended())

    def check_not_forked(self) -> None:
        """Raises in a process that was forked from the one that opened it.

        Raises:
            Unavailable: This is such a process.
        """
        if not self.is_ours():
            raise forked()

    def zenoh_objects(self) -> Iterator[object]:
        """The objects whose destructors call zenoh."""
        for stream in list(self.streams):
            yield from stream.subscribers
        yield from list(self.controllers)
        yield self.zenoh

    def swarm_key(self, swarm: str, rest: str) -> str:
        """A key of a swarm, such as `jostle/demo/get/status`."""
        return f"{self.prefix}/{swarm}/{rest}"

    def node_key(self, node: str, rest: str) -> str:
        """A key of a daemon, such as `jostle/@node/main/get/hello`."""
        return f"{self.prefix}/@node/{node}/{rest}"

    def query_all(
        self, selector: str, wait_secs: float, payload: bytes | None = None
    ) -> Iterator[bytes]:
        """Sends a query and yields the payload of every reply; none if there is no reply.

        Raises:
            JostleError: A daemon's error, or `Unavailable` if one is connected and too late.
        """
        self.check_not_forked()
        began = time.monotonic()
        try:
            replies = self.zenoh.get(
                selector,
                payload=payload,
                encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
                timeout=wait_secs,
                attachment=self._token,
                consolidation=zenoh.ConsolidationMode.NONE,
                cancellation_token=_cancel.token(),
            )
        except zenoh.ZError as error:
            raise self._failed(error) from error
        has_reply = False
        for reply in replies:
            has_reply = True
            if reply.ok is not None:
                yield reply.ok.payload.to_bytes()
            elif reply.err is not None:
                sent = read_error(reply.err.payload.to_bytes())
                raise self.late(time.monotonic() - began) if sent is None else sent
        # A cancelled query ends like one without a reply.
        _cancel.check()
        # zenoh ends a query on both sides at its timeout. If the daemon's side is first, the query
        # ends without an error. A query without a receiver ends at once.
        elapsed = time.monotonic() - began
        if not has_reply and elapsed >= _LATE_SHARE * wait_secs:
            raise self.late(elapsed)

    def late(self, seconds: float) -> Unavailable:
        return Unavailable(
            f"the daemon at {self.endpoint} is connected but sent no reply within "
            f"{seconds:.1f} s; the request may still be executed",
            details={"is_late": True},
        )

    def put(self, key: str, payload: bytes) -> None:
        """Publishes JSON, which has no reply.

        Raises:
            Unavailable: The session is closed.
        """
        self.check_not_forked()
        try:
            # A daemon that removed people since its start requires the token with set-points.
            self.zenoh.put(
                key, payload, encoding=zenoh.Encoding.APPLICATION_JSON, attachment=self._token
            )
        except zenoh.ZError as error:
            raise self._failed(error) from error

    def declare_token(self, key: str) -> zenoh.LivelinessToken:
        """Declares a liveliness token, which exists while it is referenced and connected.

        Raises:
            Unavailable: The session is closed.
        """
        self.check_not_forked()
        try:
            return self.zenoh.liveliness().declare_token(key)
        except zenoh.ZError as error:
            raise self._failed(error) from error

    def alive(self, key: str) -> list[str]:
        """The keys of the liveliness tokens that match `key`, sorted.

        Raises:
            Unavailable: The session is closed, or the list did not arrive within 2 s.
        """
        self.check_not_forked()
        began = time.monotonic()
        try:
            replies = self.zenoh.liveliness().get(
                key, timeout=LIVELINESS_TIMEOUT_SECS, cancellation_token=_cancel.token()
            )
        except zenoh.ZError as error:
            raise self._failed(error) from error
        keys = []
        for reply in replies:
            # The only error is the timeout, after which tokens may be missing.
            if reply.ok is None:
                raise self.late(time.monotonic() - began)
            keys.append(str(reply.ok.key_expr))
        _cancel.check()
        return sorted(keys)

    def nodes(self) -> list[str]:
        """The names of the connected daemons.

        Raises:
            Unavailable: The session is closed.
        """
        return [key.split("/")[-2] for key in self.alive(self.node_key("*", "alive"))]

    def disconnected(self) -> Unavailable:
        """The error when the daemon is no longer connected."""
        return Unavailable(
            f"the daemon at {self.endpoint} is gone; the request may or may not have been "
            "executed. This client works again when the daemon is back"
        )

    def connected(self) -> frozenset[str]:
        """The ids of the connected zenoh nodes; a daemon that was restarted has another id."""
        self.check_not_forked()
        try:
            info = self.zenoh.info
            return frozenset(map(str, (*info.routers_zid(), *info.peers_zid())))
        except zenoh.ZError as error:
            raise self._failed(error) from error

    def await_connection(self, seconds: float) -> frozenset[str]:
        """The connected zenoh nodes; waits so many seconds while zenoh reconnects.

        Raises:
            Unavailable: The session is closed.
        """
        if self.zenoh.is_closed():
            raise self._closed()
        deadline = time.monotonic() + seconds
        while not (connected := self.connected()) and time.monotonic() < deadline:
            if self.is_over():
                break
            _cancel.sleep(POLL_INTERVAL_SECS)
        return connected

    def _failed(self, error: zenoh.ZError) -> Unavailable:
        if self.zenoh.is_closed():
            return self._closed()
        return Unavailable(f"the session with {self.endpoint} failed: {error}")

    def _closed(self) -> Unavailable:
        return Unavailable("this client is closed: connect again")
