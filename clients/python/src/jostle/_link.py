"""One zenoh session with a daemon: asks, and says what silence means."""

from __future__ import annotations

import ipaddress
import json
import os
import socket
import time
import uuid
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex

import msgspec
import zenoh

from . import _cancel
from ._arguments import check_label, check_seconds, to_json
from ._claims import Claim, contest, read_claims, unserved
from ._credentials import Credentials, WhoAmI, proofs, refusal
from ._ends import forked, open_links, use_zenoh
from ._errors import (
    Busy,
    InvalidArgument,
    JostleError,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
    Unavailable,
    read_error,
)
from ._patience import Patience
from ._reading import read_reply
from ._tls import wrong_name

if TYPE_CHECKING:
    from ._controller import Controller
    from ._stream import Stream

GRACE_SECS = 2.0
"""How much longer than the daemon's own deadline an answer is waited for, seconds."""

# A command not answered for this long is sent again beside it, and then after twice as long each
# time: zenoh loses a query that is sent while its connection breaks.
_FIRST_LISTEN_SECS = 1.0
_LONGEST_LISTEN_SECS = 30.0
# A lost connection with a daemon that is still there is made again within this time.
_RETURN_SECS = 2.0
_LOOK_AGAIN_SECS = 0.02
_LIVELINESS_SECS = 2.0
# How long two daemons that were just connected may both claim to serve a name: they settle it
# within 0.4 s, and a busy machine may take longer.
_YIELD_SECS = 1.0
_MAX_LOOKED = 1024


# What a client of zenoh says first (InitSyn), behind its length.
_GREETING = b"\x13\x00\x01\x09\xf2jostle-probe-own"


def open_session(
    endpoint: str, timeout: float, identity: tuple[Credentials, Path] | None = None
) -> zenoh.Session:
    """Opens a session with the daemon at `endpoint`, and with nobody else.

    Raises:
        InvalidArgument: It is no endpoint.
        PermissionDenied: Whoever listens there does not let this client in.
        Unavailable: No daemon answers there, its certificate names other addresses, or zenoh cannot
            be used in this process.
    """
    use_zenoh()
    if identity is not None and not _may_be_told_secrets(endpoint):
        raise InvalidArgument(
            f"{endpoint!r} is another machine's, and whatever is sent there in the clear can be "
            "read on the way: with credentials give tls/HOST:PORT",
            details={"field": "endpoint"},
        )
    try:
        # What says a password is nowhere that a traceback with its variables would show.
        return zenoh.open(_config(endpoint, timeout, identity))
    except zenoh.ZError:
        # zenoh's own error says no more than that, in more words.
        if _speaks_zenoh(endpoint):
            mismatch = None if identity is None else wrong_name(endpoint, identity[1])
            raise mismatch or _not_let_in(endpoint, identity) from None
        raise Unavailable(
            f"no daemon answers at {endpoint}: start one with `jostled serve`, "
            "or name another endpoint (argument `endpoint`, or JOSTLE_ENDPOINT)"
        ) from None


def _config(
    endpoint: str, timeout: float, identity: tuple[Credentials, Path] | None
) -> zenoh.Config:
    milliseconds = max(1, round(timeout * 1000))
    config = zenoh.Config()
    for key, value in {
        # As a peer zenoh would listen on every interface and connect to whatever it hears of.
        "mode": "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Something that accepts the connection but speaks no zenoh must not hold the caller up.
        "transport/unicast/open_timeout": milliseconds,
        # When the daemon comes back, so does the session, within a second.
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 1000,
            "period_increase_factor": 2,
        },
        **({} if identity is None else proofs(*identity)),
    }.items():
        config.insert_json5(key, json.dumps(value))
    try:
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise InvalidArgument(
            f"{endpoint!r} is no endpoint: one looks like tcp/127.0.0.1:7447",
            details={"field": "endpoint"},
        ) from None
    return config


def _may_be_told_secrets(endpoint: str) -> bool:
    """Whether what is sent to `endpoint` is encrypted, or stays within this machine."""
    protocol, _, address = endpoint.partition("/")
    host = address.rpartition(":")[0].strip("[]")
    try:
        is_here = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_here = False
    return protocol != "tcp" or is_here


def _speaks_zenoh(endpoint: str) -> bool:
    """Whether what listens at `endpoint` is a zenoh, or TLS, that did not let this client in."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.split("#")[0].split("?")[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        return False
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=1.0) as stream:
            stream.sendall(_GREETING)
            answer = stream.recv(64)
    except OSError:
        return False
    # TLS says that this is no handshake of its own; zenoh says so behind the length of its answer.
    if protocol == "tls":
        return answer[:1] in (b"\x15", b"\x16")
    return len(answer) > 2 and int.from_bytes(answer[:2], "little") == len(answer) - 2


def _not_let_in(endpoint: str, identity: tuple[Credentials, Path] | None) -> PermissionDenied:
    if identity is None:
        who = "this client"
        remedy = "if it is a daemon that knows its people, say who you are (argument `credentials`)"
    else:
        who = identity[0].person
        remedy = (
            "these credentials may be newer than the daemon's last start (restart it), out of "
            "date, or another daemon's, or it knows no people and takes none"
        )
    return PermissionDenied(f"something listens at {endpoint} but does not let {who} in: {remedy}")


class Link:
    """One session with the daemons behind one endpoint, and what every request needs."""

    def __init__(
        self,
        session: zenoh.Session,
        endpoint: str,
        prefix: str,
        client: str,
        timeout: float,
        token: str | None = None,
    ) -> None:
        self.session = session
        self.endpoint = endpoint
        self.prefix = prefix
        self.client = client
        self.timeout = timeout
        self._token = token
        self.max_message_bytes: int | None = None
        # What lives as long as this does, such as a daemon of its own.
        self.held: object = None
        self.streams: weakref.WeakSet[Stream[Any]] = weakref.WeakSet()
        self.controllers: weakref.WeakSet[Controller] = weakref.WeakSet()
        # The swarms whose claims were checked, each with the zenoh nodes connected at that time.
        self._looked: set[tuple[str, frozenset[str]]] = set()
        self._owner = os.getpid()
        open_links.add(self)

    def close(self) -> None:
        """Ends every stream and the session; harmless when done already."""
        if not self.is_ours():
            return
        for stream in list(self.streams):
            stream.close()
        self.session.close()

    def is_ours(self) -> bool:
        """Whether this process opened it, and not one that this was forked from.

        A forked process has none of zenoh's threads, and would wait for them for ever.
        """
        return os.getpid() == self._owner

    def is_open(self) -> bool:
        """Whether it may still come to something: it is this process's, and not closed."""
        return self.is_ours() and not self.session.is_closed()

    def check_ours(self) -> None:
        """Goes no further in a process that was forked from the one that opened it.

        Raises:
            Unavailable: This is one.
        """
        if not self.is_ours():
            raise forked()

    def swarm_key(self, swarm: str, rest: str) -> str:
        """A key of a swarm, such as `jostle/demo/get/status`."""
        return f"{self.prefix}/{swarm}/{rest}"

    def node_key(self, node: str, rest: str) -> str:
        """A key of a daemon itself, such as `jostle/@node/main/get/hello`."""
        return f"{self.prefix}/@node/{node}/{rest}"

    def command(
        self,
        key: str,
        args: dict[str, Any] | msgspec.Raw,
        *,
        swarm: str | None,
        at_step: SupportsIndex | None = None,
        expect_step: SupportsIndex | None = None,
        expect_epoch: SupportsIndex | None = None,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> bytes:
        """Has a verb executed, once, and returns the answer's payload.

        When the answer is lost or the daemon is busy the same request is sent again: under the
        same id the daemon carries it out only if it has not yet.

        `swarm` is whom `key` is about; None if it is about a daemon. `args` may be JSON already.

        Raises:
            JostleError: The daemon's own error, or what its silence means.
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
        listen = _FIRST_LISTEN_SECS if seconds > _FIRST_LISTEN_SECS else seconds + GRACE_SECS
        try:
            return self._ask(key, swarm, listen, self._write(request), before)
        except (Busy, Unavailable) as error:
            # What lock-step sends thousands of times a second needs none of this.
            patience = Patience(began, seconds, self.timeout)
            return self._ask_again(key, swarm, request, before, patience, error)

    def _ask_again(
        self,
        key: str,
        swarm: str | None,
        request: dict[str, Any],
        before: frozenset[str],
        patience: Patience,
        trouble: JostleError,
    ) -> bytes:
        """Sends a command again until it is answered, after `trouble` with its first sending."""
        listen = _FIRST_LISTEN_SECS
        while True:
            if not trouble.details.get("is_late"):
                wait = patience.pause(trouble)
            elif (wait := patience.remaining) > 0.0:
                # It may take its time, which is no trouble.
                patience.recover()
                listen = min(2.0 * listen, _LONGEST_LISTEN_SECS)
            else:
                raise self._late(patience.elapsed) from trouble
            # Another daemon, even of the same name, knows nothing of what was carried out.
            if isinstance(trouble, Unavailable) and (
                not before or self._await_connection(wait) != before
            ):
                raise self.gone() from trouble
            # A daemon takes no deadline that is over.
            remaining = max(patience.remaining, 0.001)
            payload = self._write({**request, "timeout_secs": remaining})
            listen_now = listen if remaining > listen else remaining + GRACE_SECS
            try:
                return self._ask(key, swarm, listen_now, payload, before)
            except (Busy, Unavailable) as error:
                trouble = error

    def get(self, selector: str, *, swarm: str | None, timeout: float | None = None) -> bytes:
        """Asks something that changes nothing and returns the answer's payload.

        When the daemon is busy it is asked again.

        Raises:
            JostleError: The daemon's own error, or what its silence means.
        """
        seconds = self.timeout if timeout is None else timeout
        before = self.connected()
        patience: Patience | None = None
        while True:
            try:
                return self._ask(selector, swarm, seconds + GRACE_SECS, None, before)
            except Busy as error:
                patience = patience or Patience(time.monotonic(), seconds, self.timeout)
                patience.pause(error)

    def _await_connection(self, seconds: float) -> frozenset[str]:
        """Who is connected, waiting a little for a connection that is being made again.

        Raises:
            Unavailable: The session is closed.
        """
        if self.session.is_closed():
            raise self._closed()
        give_up = time.monotonic() + min(seconds, _RETURN_SECS)
        while not (connected := self.connected()) and time.monotonic() < give_up:
            _cancel.rest(_LOOK_AGAIN_SECS)
        return connected

    def _write(self, request: dict[str, Any]) -> bytes:
        is_json = isinstance(request["args"], msgspec.Raw)
        payload = msgspec.json.encode(request) if is_json else to_json(request)
        limit = self.max_message_bytes
        if limit is not None and len(payload) > limit:
            # One much longer is dropped by the transport without a word, which is like silence.
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

    def _ask(
        self,
        selector: str,
        swarm: str | None,
        listen_secs: float,
        payload: bytes | None,
        before: frozenset[str],
    ) -> bytes:
        """Sends a query once and returns the first answer's payload.

        Raises:
            JostleError: The daemon's own error, or what its silence means.
        """
        if swarm is not None:
            self._check_contested(swarm, before, min(_YIELD_SECS, listen_secs))
        for answer in self.ask_all(selector, listen_secs, payload):
            return answer
        error = self.explain_silence(swarm, before, selector)
        if not isinstance(error, PermissionDenied):
            raise error
        # A connection just made again does not know the daemon's keys yet, and then sends
        # nothing. By now it does; what was refused is refused again.
        for answer in self.ask_all(selector, listen_secs, payload):
            return answer
        raise self.explain_silence(swarm, before, selector)

    def _check_contested(self, swarm: str, connected: frozenset[str], yield_secs: float) -> None:
        """Checks once per connection that no two daemons serve a swarm's name.

        While the daemons can reach each other, they reject commands themselves.

        Raises:
            Contested: Several daemons serve the name for longer than `yield_secs`, and each would
                execute a command.
        """
        looked = (swarm, connected)
        if looked in self._looked:
            return
        deadline = time.monotonic() + yield_secs
        while (error := contest(swarm, self._claims(swarm))) is not None:
            if time.monotonic() >= deadline:
                raise error
            time.sleep(_LOOK_AGAIN_SECS)
        if len(self._looked) >= _MAX_LOOKED:
            self._looked.clear()
        self._looked.add(looked)

    def _claims(self, swarm: str) -> list[Claim]:
        return read_claims(self.alive(self.swarm_key(swarm, "claim/*/*/*")))

    def ask_all(
        self, selector: str, listen_secs: float, payload: bytes | None = None
    ) -> Iterator[bytes]:
        """Sends a query and yields every answer's payload as it comes; none if nobody answers.

        Raises:
            JostleError: A daemon's own error, or `Unavailable` if one is there and too late.
        """
        self.check_ours()
        began = time.monotonic()
        try:
            replies = self.session.get(
                selector,
                payload=payload,
                encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
                timeout=listen_secs,
                attachment=self._token,
                consolidation=zenoh.ConsolidationMode.NONE,
                cancellation_token=_cancel.token(),
            )
        except zenoh.ZError as error:
            raise self._broken(error) from error
        for reply in replies:
            if reply.ok is not None:
                yield reply.ok.payload.to_bytes()
            elif reply.err is not None:
                said = read_error(reply.err.payload.to_bytes())
                raise self._late(time.monotonic() - began) if said is None else said
        # A query that was cancelled ends like one that nobody answers.
        _cancel.check()

    def _late(self, seconds: float) -> Unavailable:
        return Unavailable(
            f"the daemon at {self.endpoint} is connected but gave no answer within "
            f"{seconds:.1f} s; what was asked of it may still happen",
            details={"is_late": True},
        )

    def put(self, key: str, payload: bytes) -> None:
        """Publishes JSON that nobody answers.

        Raises:
            Unavailable: The session is closed.
        """
        self.check_ours()
        try:
            # A daemon that removed people since its start takes set-points with a token only.
            self.session.put(
                key, payload, encoding=zenoh.Encoding.APPLICATION_JSON, attachment=self._token
            )
        except zenoh.ZError as error:
            raise self._broken(error) from error

    def declare_token(self, key: str) -> zenoh.LivelinessToken:
        """Has a liveliness token stand on `key` for as long as it is held and this is connected.

        Raises:
            Unavailable: The session is closed.
        """
        self.check_ours()
        try:
            return self.session.liveliness().declare_token(key)
        except zenoh.ZError as error:
            raise self._broken(error) from error

    def alive(self, key: str) -> list[str]:
        """The liveliness tokens that stand on `key`.

        Raises:
            Unavailable: The session is closed.
        """
        self.check_ours()
        try:
            replies = self.session.liveliness().get(
                key, timeout=_LIVELINESS_SECS, cancellation_token=_cancel.token()
            )
        except zenoh.ZError as error:
            raise self._broken(error) from error
        keys = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        _cancel.check()
        return keys

    def nodes(self) -> list[str]:
        """The names of the daemons that are there.

        Raises:
            Unavailable: The session is closed.
        """
        return [key.split("/")[-2] for key in self.alive(self.node_key("*", "alive"))]

    def gone(self) -> Unavailable:
        """The error when no daemon is there any more."""
        return Unavailable(
            f"the daemon at {self.endpoint} is gone; what was being asked of it may or may not "
            "have happened. This client finds it again when it is back"
        )

    def explain_silence(
        self, swarm: str | None, before: frozenset[str] | None = None, selector: str = ""
    ) -> JostleError:
        """The error that no answer at all amounts to.

        A query that nobody may answer returns at once and empty, whether there is nobody or the
        daemon's access control swallowed it. Liveliness tokens tell which, if who was connected
        `before` the query still is: otherwise they are those of a daemon that it never reached.
        The daemon tells whether the verb in `selector` is permitted, which it then never heard of.
        """
        nodes = self.nodes()
        waiting = None if swarm is None else unserved(swarm, self._claims(swarm))
        if waiting is not None and not self.alive(self.swarm_key(swarm or "", "alive/*")):
            return waiting
        if not nodes or (before is not None and before != self.connected()):
            return self.gone()
        if swarm is None or self.alive(self.swarm_key(swarm, "alive/*")):
            who = f"node {nodes[0]!r}" if swarm is None else f"swarm {swarm!r}"
            _, is_command, verb = selector.partition("/cmd/")
            if is_command and (told := self._refusal(verb)) is not None:
                return PermissionDenied(told, details={"is_silence": True})
            return PermissionDenied(
                f"{who} is there but does not answer: this client is not permitted to ask that, "
                "or the daemon is just closing",
                details={"is_silence": True},
            )
        where = ", ".join(repr(node) for node in nodes)
        return NotFound(
            f"no swarm is named {swarm!r} on {where}: create it, or look at `client.swarms()`",
            details={"swarm": swarm, "is_silence": True},
        )

    def _refusal(self, verb: str) -> str | None:
        """Why the daemons there do not permit `verb`; None if they do, or do not say."""
        key = self.node_key("*", "get/whoami")
        for answer in self.ask_all(key, _LIVELINESS_SECS):
            who = read_reply(answer, WhoAmI)
            if not who.may(verb):
                return refusal(who, verb)
        return None

    def connected(self) -> frozenset[str]:
        """The zenoh nodes at the other end; a daemon that was started again is another one."""
        self.check_ours()
        try:
            info = self.session.info
            return frozenset(map(str, (*info.routers_zid(), *info.peers_zid())))
        except zenoh.ZError as error:
            raise self._broken(error) from error

    def _broken(self, error: zenoh.ZError) -> Unavailable:
        if self.session.is_closed():
            return self._closed()
        return Unavailable(f"the session with {self.endpoint} failed: {error}")

    def _closed(self) -> Unavailable:
        return Unavailable("this client is closed: connect again")
