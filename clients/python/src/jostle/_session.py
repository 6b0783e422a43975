"""A session with a daemon: sends queries, and turns a missing reply into an error."""

from __future__ import annotations

import os
import time
import uuid
import weakref
from collections.abc import Iterator
from typing import Any, Protocol, SupportsIndex, TypeVar

import msgspec
import zenoh

from . import _cancel
from ._arguments import check_label, check_seconds, to_json
from ._claims import Claim, contested_error, read_claims, unserved_error
from ._credentials import WhoAmI, denial_reason, restricted_verb
from ._decode import read_reply
from ._errors import (
    Busy,
    DeadlineExceeded,
    JostleError,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
    Unavailable,
    late,
    read_error,
)
from ._retry import Backoff
from ._shutdown import forked, open_sessions

T = TypeVar("T")

REPLY_MARGIN_SECS = 2.0
"""How much longer than the daemon's own deadline a reply is waited for, seconds."""

# A command without a reply is sent again after this time, then after twice as long each time: zenoh
# loses a query that is sent while its connection breaks.
_FIRST_RESEND_SECS = 1.0
_MAX_RESEND_SECS = 30.0
# zenoh reconnects with a daemon that is running within this time.
_RECONNECT_TIMEOUT_SECS = 2.0
_POLL_INTERVAL_SECS = 0.02
_LIVELINESS_TIMEOUT_SECS = 2.0

# A query that ends without a reply after this share of its timeout ended because of it.
_LATE_SHARE = 0.9
# How long two daemons that were just connected may both claim to serve a name: they settle it
# within 0.4 s, and a busy machine may take longer.
_CONTEST_TIMEOUT_SECS = 1.0
_MAX_CHECKED = 1024


class _Stream(Protocol):
    """A stream of the session."""

    subscribers: list[zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]]

    def close(self) -> None:
        """Unsubscribes."""


class Session:
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
        # An object that lives as long as the session, such as a private daemon.
        self.keepalive: object = None
        self.streams: weakref.WeakSet[_Stream] = weakref.WeakSet()
        # Controllers, whose liveliness tokens are zenoh's.
        self.controllers: weakref.WeakSet[object] = weakref.WeakSet()
        # The swarms whose claims were checked, each with the zenoh nodes connected at that time.
        self._checked: set[tuple[str, frozenset[str]]] = set()
        self._owner = os.getpid()
        open_sessions.add(self)

    def close(self) -> None:
        """Closes every stream and the session; a second call does nothing."""
        if not self.is_ours():
            return
        for stream in list(self.streams):
            stream.close()
        self.zenoh.close()

    def is_ours(self) -> bool:
        """Whether this process opened it, not one that this process was forked from.

        A forked process has none of zenoh's threads, and would wait for them forever.
        """
        return os.getpid() == self._owner

    def is_open(self) -> bool:
        """Whether this process opened it and has not closed it."""
        return self.is_ours() and not self.zenoh.is_closed()

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

    def command(
        self,
        key: str,
        args: dict[str, Any] | msgspec.Struct | msgspec.Raw,
        *,
        swarm: str | None,
        at_step: SupportsIndex | None = None,
        expect_step: SupportsIndex | None = None,
        expect_epoch: SupportsIndex | None = None,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> bytes:
        """Sends a command, which is executed once, and returns the payload of the reply.

        If the reply is lost or the daemon is busy, the same request is sent again: the daemon
        executes a request id only once.

        Args:
            key: The key of the command.
            args: The arguments; `msgspec.Raw` if they are JSON already.
            swarm: The swarm that `key` addresses; None if it addresses a daemon.
            at_step: Execute it at this step.
            expect_step: See `jostle.Options`.
            expect_epoch: See `jostle.Options`.
            timeout: Seconds it may take; None is the client's.
            request_id: See `jostle.Options`; None is a new one.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        seconds = self.timeout if timeout is None else check_seconds("timeout", timeout)
        if request_id is not None:
            check_label("request_id", request_id)
        request = {
            "request_id": uuid.uuid4().hex if request_id is None else request_id,
            "client": self.client,
            "at_step": at_step,
            "expect_step": expect_step,
            "expect_epoch": expect_epoch,
            "timeout_secs": seconds,
            "args": args,
        }
        request = {name: value for name, value in request.items() if value is not None}
        began = time.monotonic()
        before = self.connected() or self._await_connection(seconds)
        wait = _FIRST_RESEND_SECS if seconds > _FIRST_RESEND_SECS else seconds + REPLY_MARGIN_SECS
        try:
            try:
                return self._query(key, swarm, wait, self._encode(request), before)
            except (Busy, Unavailable) as error:
                # Lock-step sends thousands of commands a second, and the first attempt succeeds.
                backoff = Backoff(began, seconds, self.timeout)
                return self._resend(key, swarm, request, before, backoff, error)
        except DeadlineExceeded as error:
            waits = "" if swarm is None else ", and `Swarm.wait` waits for a step"
            remedy = f"it continues; a longer `timeout=` waits longer{waits}"
            raise late("not done", seconds, remedy, error) from error

    def node_command(
        self,
        node: str,
        verb: str,
        args: dict[str, Any],
        kind: type[T],
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> T:
        """Sends a command to a daemon and reads the reply as `kind`; see `command`."""
        key = self.node_key(node, f"cmd/{verb}")
        payload = self.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
        return read_reply(payload, kind)

    def swarm_command(
        self,
        swarm: str,
        verb: str,
        args: dict[str, Any],
        kind: type[T],
        **options: Any,
    ) -> T:
        """Sends a command to a swarm and reads the reply as `kind`; see `command`."""
        key = self.swarm_key(swarm, f"cmd/{verb}")
        return read_reply(self.command(key, args, swarm=swarm, **options), kind)

    def _resend(
        self,
        key: str,
        swarm: str | None,
        request: dict[str, Any],
        before: frozenset[str],
        backoff: Backoff,
        failure: JostleError,
    ) -> bytes:
        """Sends a command again until it is replied to, after the first attempt failed."""
        resend_secs = _FIRST_RESEND_SECS
        while True:
            if not failure.details.get("is_late"):
                left = backoff.sleep(failure)
            elif (left := backoff.remaining) > 0.0:
                # The command takes long; the connection is fine.
                backoff.reset()
                resend_secs = min(2.0 * resend_secs, _MAX_RESEND_SECS)
            else:
                raise self._late(backoff.elapsed) from failure
            # Another daemon, even of the same name, does not know which commands were executed.
            if isinstance(failure, Unavailable) and (
                not before or self._await_connection(left) != before
            ):
                raise self.disconnected() from failure
            # The daemon rejects a timeout of 0.
            remaining = max(backoff.remaining, 0.001)
            payload = self._encode({**request, "timeout_secs": remaining})
            wait = resend_secs if remaining > resend_secs else remaining + REPLY_MARGIN_SECS
            try:
                return self._query(key, swarm, wait, payload, before)
            except (Busy, Unavailable) as error:
                failure = error

    def get(self, selector: str, *, swarm: str | None, timeout: float | None = None) -> bytes:
        """Sends a query that changes nothing, and returns the payload of the reply.

        If the daemon is busy, the query is sent again.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        seconds = self.timeout if timeout is None else timeout
        before = self.connected()
        backoff: Backoff | None = None
        while True:
            try:
                return self._query(selector, swarm, seconds + REPLY_MARGIN_SECS, None, before)
            except Busy as error:
                backoff = backoff or Backoff(time.monotonic(), seconds, self.timeout)
                backoff.sleep(error)
            except DeadlineExceeded as error:
                raise late(
                    "not done", seconds, "a longer `timeout=` waits longer", error
                ) from error

    def _await_connection(self, seconds: float) -> frozenset[str]:
        """The connected zenoh nodes; waits for a moment while zenoh reconnects.

        Raises:
            Unavailable: The session is closed.
        """
        if self.zenoh.is_closed():
            raise self._closed()
        deadline = time.monotonic() + min(seconds, _RECONNECT_TIMEOUT_SECS)
        while not (connected := self.connected()) and time.monotonic() < deadline:
            _cancel.sleep(_POLL_INTERVAL_SECS)
        return connected

    def _encode(self, request: dict[str, Any]) -> bytes:
        is_json = isinstance(request["args"], msgspec.Raw)
        payload = msgspec.json.encode(request) if is_json else to_json(request)
        limit = self.max_message_bytes
        if limit is not None and len(payload) > limit:
            # The transport drops a much longer message without an error.
            raise ResourceExhausted(
                f"the request has {len(payload)} bytes and the daemon takes requests of at most "
                f"{limit} (max_message_bytes): send less at once",
                details={
                    "limit": "max_message_bytes",
                    "max": limit,
                    "got": len(payload),
                },
            )
        return payload

    def _query(
        self,
        selector: str,
        swarm: str | None,
        wait_secs: float,
        payload: bytes | None,
        before: frozenset[str],
    ) -> bytes:
        """Sends a query and returns the payload of the first reply.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        if swarm is not None:
            self._check_contested(swarm, before, min(_CONTEST_TIMEOUT_SECS, wait_secs))
        for reply in self.query_all(selector, wait_secs, payload):
            return reply
        error = self.explain_silence(swarm, before, selector)
        if not isinstance(error, PermissionDenied):
            raise error
        # A new connection does not know the daemon's keys yet, and then sends nothing. By now it
        # does: a query that was really rejected is rejected again.
        for reply in self.query_all(selector, wait_secs, payload):
            return reply
        raise self.explain_silence(swarm, before, selector)

    def _check_contested(self, swarm: str, connected: frozenset[str], seconds: float) -> None:
        """Checks once per connection that no two daemons serve a swarm's name.

        While the daemons can reach each other, they reject commands themselves.

        Raises:
            Contested: Several daemons serve the name for longer than `seconds`, and each would
                execute a command.
        """
        checked = (swarm, connected)
        if checked in self._checked:
            return
        deadline = time.monotonic() + seconds
        while (error := contested_error(swarm, self._claims(swarm))) is not None:
            if time.monotonic() >= deadline:
                raise error
            time.sleep(_POLL_INTERVAL_SECS)
        if len(self._checked) >= _MAX_CHECKED:
            self._checked.clear()
        self._checked.add(checked)

    def _claims(self, swarm: str) -> list[Claim]:
        return read_claims(self.alive(self.swarm_key(swarm, "claim/*/*/*")))

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
                raise self._late(time.monotonic() - began) if sent is None else sent
        # A cancelled query ends like one without a reply.
        _cancel.check()
        # zenoh ends a query on both sides at its timeout. If the daemon's side is first, the query
        # ends without an error. A query without a receiver ends at once.
        elapsed = time.monotonic() - began
        if not has_reply and elapsed >= _LATE_SHARE * wait_secs:
            raise self._late(elapsed)

    def _late(self, seconds: float) -> Unavailable:
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
                key, timeout=_LIVELINESS_TIMEOUT_SECS, cancellation_token=_cancel.token()
            )
        except zenoh.ZError as error:
            raise self._failed(error) from error
        keys = []
        for reply in replies:
            # The only error is the timeout, after which tokens may be missing.
            if reply.ok is None:
                raise self._late(time.monotonic() - began)
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

    def explain_silence(
        self, swarm: str | None, before: frozenset[str] | None = None, selector: str = ""
    ) -> JostleError:
        """The error for a query without a reply.

        A query that no queryable may answer returns at once and empty, whether there is none or
        the daemon's access control dropped it. Liveliness tokens distinguish the two, if the nodes
        connected `before` the query still are: otherwise the query never reached the daemon. For a
        dropped query, `whoami` reports whether the verb in `selector` is permitted.
        """
        nodes = self.nodes()
        waiting = None if swarm is None else unserved_error(swarm, self._claims(swarm))
        if waiting is not None and not self.alive(self.swarm_key(swarm or "", "alive/*")):
            return waiting
        if not nodes or (before is not None and before != self.connected()):
            return self.disconnected()
        if swarm is None or self.alive(self.swarm_key(swarm, "alive/*")):
            who = f"node {nodes[0]!r}" if swarm is None else f"swarm {swarm!r}"
            verb = restricted_verb(selector)
            if verb is not None and (reason := self._denial_reason(verb)) is not None:
                return PermissionDenied(reason, details={"is_silence": True})
            return PermissionDenied(
                f"{who} exists but does not reply: this client is not permitted to send that "
                "request, or the daemon is shutting down",
                details={"is_silence": True},
            )
        where = ", ".join(repr(node) for node in nodes)
        return NotFound(
            f"no swarm is named {swarm!r} on {where}: create it, or look at `client.swarms()`",
            details={"swarm": swarm, "is_silence": True},
        )

    def _denial_reason(self, verb: str) -> str | None:
        """Why the daemons do not permit `verb`; None if they do, or do not reply."""
        key = self.node_key("*", "get/whoami")
        for reply in self.query_all(key, _LIVELINESS_TIMEOUT_SECS):
            who = read_reply(reply, WhoAmI)
            if not (who.may(verb) or who.role == "operator"):
                return denial_reason(who, verb)
        return None

    def connected(self) -> frozenset[str]:
        """The ids of the connected zenoh nodes; a daemon that was restarted has another id."""
        self.check_not_forked()
        try:
            info = self.zenoh.info
            return frozenset(map(str, (*info.routers_zid(), *info.peers_zid())))
        except zenoh.ZError as error:
            raise self._failed(error) from error

    def _failed(self, error: zenoh.ZError) -> Unavailable:
        if self.zenoh.is_closed():
            return self._closed()
        return Unavailable(f"the session with {self.endpoint} failed: {error}")

    def _closed(self) -> Unavailable:
        return Unavailable("this client is closed: connect again")
