"""A session with a daemon: sends queries, and turns a missing reply into an error."""

from __future__ import annotations

import contextlib
import time
import uuid
from typing import Any, SupportsIndex, TypeVar

import msgspec

from ._arguments import check_label, check_seconds, to_json
from ._cancel import sleep
from ._claims import Claim, contested_error, read_claims, unserved_error
from ._credentials import denial_reason, restricted_verb
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
)
from ._link import LIVELINESS_TIMEOUT_SECS, POLL_INTERVAL_SECS, Link
from ._outage import Outage
from ._retry import FAILED, FIRST_DELAY_SECS, FORGOTTEN_COMMANDS, Backoff
from ._wire import Hello, WhoAmI

T = TypeVar("T")

REPLY_MARGIN_SECS = 2.0
"""How much longer than the daemon's own deadline a reply is waited for, seconds."""

# A command without a reply is sent again after this time, then after twice as long each time: zenoh
# loses a query that is sent while its connection breaks.
_FIRST_RESEND_SECS = 1.0
_MAX_RESEND_SECS = 30.0
# How long two daemons that were just connected may both claim to serve a name: they settle it
# within 0.4 s, and a busy machine may take longer.
_CONTEST_TIMEOUT_SECS = 1.0
_MAX_CHECKED = 1024


class Session(Link):
    """A session that sends requests: queries and commands, each until it has a reply.

    What fails because the daemon is busy or not reachable is sent again, see `_retry`.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        # The claims of the daemons that serve a swarm or a node, as read once for each set of
        # connected zenoh nodes.
        self._servers: dict[tuple[str, frozenset[str]], frozenset[Claim]] = {}
        # Those that were reachable when a command was sent to a name that none served.
        self._reachable: dict[frozenset[str], frozenset[Claim]] = {}
        # The data of a run of a daemon, by its instance; None if the daemon does not say.
        self._data_ids: dict[str, str | None] = {}

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
        is_safe: bool = False,
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
            is_safe: Whether another daemon rejects it if it was executed already.

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
        before = self.connected()
        was_interrupted = not before
        if was_interrupted:
            before = self.await_connection(min(seconds, self.timeout))
        wait = _FIRST_RESEND_SECS if seconds > _FIRST_RESEND_SECS else seconds + REPLY_MARGIN_SECS
        try:
            try:
                return self._query(key, swarm, wait, self._encode(request), before)
            except FAILED as error:
                # Lock-step sends thousands of commands a second, and the first attempt succeeds.
                backoff = Backoff(began, seconds, self.timeout, was_interrupted=was_interrupted)
                return self._resend(key, swarm, request, before, backoff, error, is_safe=is_safe)
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
        *,
        is_safe: bool,
    ) -> bytes:
        """Sends a command again until it is replied to, after the first attempt failed."""
        name = self._claims_of(key, swarm)
        if not before:
            raise failure
        # The connections by which it may have been executed, and the daemons; none if they claim
        # no name.
        connected: frozenset[str] | None = None
        servers: frozenset[Claim] = frozenset()
        resend_secs = _FIRST_RESEND_SECS
        while True:
            is_unsent = isinstance(failure, Busy) or failure.details.get("is_unsent")
            if connected is None and not is_unsent:
                connected = before
                servers = self._servers.get((name, before)) or self._reachable.get(
                    before, frozenset()
                )
            if not failure.details.get("is_late"):
                before = self.pause(backoff, failure)
            elif backoff.remaining > 0.0:
                # The command takes long; the connection is fine.
                backoff.reset()
                resend_secs = min(2.0 * resend_secs, _MAX_RESEND_SECS)
            else:
                raise self.late(backoff.elapsed) from failure
            try:
                # Another daemon, even of the same name, does not know which commands were executed.
                may_know = is_safe or connected is None
                if not may_know and not (
                    self._is_known(name, key, servers) if servers else before == connected
                ):
                    break
                # The daemon rejects a timeout of 0.
                remaining = max(backoff.remaining, 0.001)
                payload = self._encode({**request, "timeout_secs": remaining})
                wait = resend_secs if remaining > resend_secs else remaining + REPLY_MARGIN_SECS
                return self._query(key, swarm, wait, payload, before)
            except FAILED as error:
                failure = error
        raise self.disconnected() from failure

    def get(self, selector: str, *, swarm: str | None, timeout: float | None = None) -> bytes:
        """Sends a query that changes nothing, and returns the payload of the reply.

        If the daemon is busy or not reachable, the query is sent again.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        seconds = self.timeout if timeout is None else timeout
        began = time.monotonic()
        before = self.connected()
        backoff: Backoff | None = None
        while True:
            wait = max(began + seconds - time.monotonic(), 0.0) + REPLY_MARGIN_SECS
            try:
                return self._query(selector, swarm, wait, None, before)
            except FAILED as error:
                backoff = backoff or Backoff(began, seconds, self.timeout)
                before = self.pause(backoff, error)
            except DeadlineExceeded as error:
                raise late(
                    "not done", seconds, "a longer `timeout=` waits longer", error
                ) from error

    def get_once(self, selector: str, *, swarm: str | None, timeout: float) -> bytes:
        """Sends a query as `get` does, once.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        return self._query(selector, swarm, timeout + REPLY_MARGIN_SECS, None, self.connected())

    def pause(
        self, backoff: Backoff, error: JostleError, outage: Outage | None = None
    ) -> frozenset[str]:
        """Waits before another attempt of a request, and returns the connected zenoh nodes.

        `outage` begins if the daemon is not reachable.

        Raises:
            JostleError: `error`, if another attempt cannot help or there is no time for it.
            Unavailable: There is no time for it, and the connection broke without a reply.
        """
        if self.is_over():
            raise error
        if outage is not None and isinstance(error, Unavailable):
            outage.begin()
        elif outage is not None and not isinstance(error, Busy):
            outage.may_begin()
        try:
            left = backoff.sleep(error)
        except JostleError:
            if backoff.is_settled or not error.details.get("is_silence"):
                raise
            # zenoh ends the queries of a connection that breaks before it reports the loss.
            sleep(FIRST_DELAY_SECS)
            if self.connected():
                raise
            raise self.disconnected() from error
        connected = self.connected()
        if not connected:
            if outage is not None:
                outage.begin()
            connected = self.await_connection(left)
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
        try:
            self.check_claims(selector, swarm, before, min(_CONTEST_TIMEOUT_SECS, wait_secs))
            if payload is not None:
                self._learn_data_ids(self._claims_of(selector, swarm), before, wait_secs)
        except FAILED as error:
            error.details["is_unsent"] = True
            raise
        for reply in self.query_all(selector, wait_secs, payload):
            return reply
        raise self.explain_silence(swarm, before, selector)

    def _claims_of(self, selector: str, swarm: str | None) -> str:
        """The key of the claims to the name that a request is for: a swarm's or a daemon's."""
        if swarm is not None:
            return self.swarm_key(swarm, "claim/*/*/*")
        _, _, rest = selector.partition("/@node/")
        return self.node_key(rest.partition("/")[0], "claim/*/*")

    def check_claims(
        self, selector: str, swarm: str | None, connected: frozenset[str], seconds: float
    ) -> None:
        """Reads once per connection which daemon serves a name, and checks that no two do.

        While the daemons can reach each other, they reject commands themselves.

        Raises:
            Contested: Several daemons serve the swarm's name for longer than `seconds`, and each
                would execute a command.
        """
        name = self._claims_of(selector, swarm)
        if (name, connected) in self._servers:
            return
        deadline = time.monotonic() + seconds
        claims = read_claims(self.alive(name))
        while swarm is not None and (error := contested_error(swarm, claims)) is not None:
            if time.monotonic() >= deadline:
                raise error
            time.sleep(POLL_INTERVAL_SECS)
            claims = read_claims(self.alive(name))
        if len(self._servers) >= _MAX_CHECKED:
            self._servers.clear()
        # A daemon behind a router that was just connected may have declared none yet.
        if serving := frozenset(claim for claim in claims if claim.serves):
            self._servers[(name, connected)] = serving

    def _is_known(self, name: str, key: str, servers: frozenset[Claim]) -> bool:
        """Whether the daemon that serves a name knows whether the command was executed.

        The name is then served as before, or was deleted, by the same run of a daemon, or by
        another one with the same data.

        Raises:
            Busy: The daemon recovers its swarms.
            Unavailable: The daemon is not reachable.
        """
        nodes = {claim.node for claim in servers}
        instances = {claim.instance for claim in servers}
        keys = [key for node in nodes for key in self.alive(self.node_key(node, "claim/*/*"))]
        present = {claim.instance for claim in read_claims(keys)}
        if not present:
            raise self.disconnected()
        serving = {claim.instance for claim in read_claims(self.alive(name)) if claim.serves}
        if not present.isdisjoint(instances) and serving <= instances:
            return True
        if len(instances) > 1 or len((present | serving) - instances) > 1:
            return False
        if key.rpartition("/")[2] in FORGOTTEN_COMMANDS:
            return False
        before = self._data_ids.get(*instances)
        (node,) = nodes
        return before is not None and self._read_data_id(node) == before

    def _learn_data_ids(self, name: str, connected: frozenset[str], seconds: float) -> None:
        """Reads once which data the daemons have that may execute a command, for at most `seconds`.

        Raises:
            Unavailable: No daemon is reachable; nothing was sent.
        """
        servers = self._servers.get((name, connected))
        if servers is None:
            # No daemon serves the name: any may begin to, such as one behind a router.
            claims = read_claims(self.alive(self.node_key("*", "claim/*/*")))
            servers = frozenset(claim for claim in claims if claim.serves)
            if not servers and (connected != self.connected() or not self.nodes()):
                raise self.disconnected()
            if len(self._reachable) >= _MAX_CHECKED:
                self._reachable.clear()
            self._reachable[connected] = servers
        for claim in servers:
            if claim.instance in self._data_ids:
                continue
            # Without it, the command is not sent to another run of the daemon.
            with contextlib.suppress(JostleError):
                data_id = self._read_data_id(claim.node, seconds)
                if len(self._data_ids) >= _MAX_CHECKED:
                    self._data_ids.clear()
                self._data_ids[claim.instance] = data_id

    def _read_data_id(self, node: str, seconds: float = LIVELINESS_TIMEOUT_SECS) -> str | None:
        """The id of a daemon's data; None if the daemon has none, or is of an earlier version.

        Raises:
            JostleError: The daemon's error, or the cause of its silence.
        """
        timeout = min(seconds, LIVELINESS_TIMEOUT_SECS)
        for reply in self.query_all(self.node_key(node, "get/hello"), timeout):
            return read_reply(reply, Hello).data_id
        raise self.disconnected()

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
        name = self._claims_of(selector, swarm)
        waiting = None if swarm is None else unserved_error(swarm, read_claims(self.alive(name)))
        if waiting is not None and not self.alive(self.swarm_key(swarm or "", "alive/*")):
            waiting.details["is_silence"] = True
            return waiting
        if before is None:
            before = self.connected()
        # Others may be connected, behind the same router.
        servers = {claim.node for claim in self._servers.get((name, before), ())}
        is_gone = bool(servers) and servers.isdisjoint(nodes)
        if not nodes or before != self.connected() or is_gone:
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
        for reply in self.query_all(key, LIVELINESS_TIMEOUT_SECS):
            who = read_reply(reply, WhoAmI)
            if not (who.may(verb) or who.role == "operator"):
                return denial_reason(who, verb)
        return None
