"""Opens a session with the daemon at an endpoint."""

from __future__ import annotations

import ipaddress
import json
import os
import socket
import time
from pathlib import Path

import zenoh

from ._arguments import check_label, check_name, check_seconds
from ._credentials import Credentials, zenoh_auth
from ._decode import read_reply
from ._errors import Busy, JostleError, PermissionDenied, Unavailable, invalid
from ._outage import Outage
from ._retry import FAILED, Backoff
from ._session import REPLY_MARGIN_SECS, Session
from ._shutdown import use_zenoh
from ._tls import certificate_mismatch, split_endpoint
from ._wire import WIRE_VERSION, Hello

_PROBE_TIMEOUT_SECS = 1.0


def open_session(
    endpoint: str,
    *,
    node: str | None = None,
    prefix: str = "jostle",
    client: str | None = None,
    timeout: float = 5.0,
    identity: tuple[Credentials, Path] | None = None,
) -> tuple[Session, str]:
    """Opens a session with the daemon at `endpoint`, and returns it with the daemon's name.

    Takes the arguments of `jostle.connect`, and raises what it raises.
    """
    if node is not None:
        check_name("node", node)
    if not prefix or any(c in "*$?#" for c in prefix) or "" in prefix.split("/"):
        raise invalid(
            "prefix",
            f"invalid prefix {prefix!r}: use a text without *, $, ?, # and empty parts, such as "
            "jostle",
        )
    client = check_label("client", f"python-{os.getpid()}" if client is None else client)
    seconds = check_seconds("timeout", timeout)
    backoff = Backoff(time.monotonic(), seconds, seconds)
    opened = open_zenoh(endpoint, seconds, identity)
    token = None if identity is None else identity[0].token
    session = Session(opened, endpoint, prefix, client, seconds, token)
    try:
        hello = _await_hello(session, node, backoff)
        # A command that gets no reply is sent again to the same daemon only.
        session.check_claims(session.node_key(hello.node, ""), None, session.connected(), 0.0)
    except BaseException:
        session.close()
        raise
    session.max_message_bytes = hello.limits.max_message_bytes
    return session, hello.node


def open_zenoh(
    endpoint: str, timeout: float, identity: tuple[Credentials, Path] | None = None
) -> zenoh.Session:
    """Opens a zenoh session with `endpoint` and with no other.

    Waits until `timeout` while nothing listens there, such as during a restart.

    Raises:
        InvalidArgument: The endpoint is invalid.
        PermissionDenied: A process listens there and rejects this client.
        Unavailable: No daemon answers there, its certificate names other addresses, or zenoh cannot
            be used in this process.
    """
    use_zenoh()
    if identity is not None and not _is_private(endpoint):
        raise invalid(
            "endpoint",
            f"{endpoint!r} is on another machine, and credentials would be sent there in the "
            "clear: use tls/HOST:PORT",
        )
    backoff = Backoff(time.monotonic(), timeout, timeout)
    outage = Outage(endpoint, f"connect(timeout={timeout:g})")
    was_rejected = False
    while True:
        began, remaining = time.monotonic(), max(backoff.remaining, 0.001)
        try:
            # The configuration holds a password, so no variable does: tracebacks may show them.
            opened = zenoh.open(_config(endpoint, remaining, identity))
        except zenoh.ZError:
            # zenoh reports only that it is unable to connect. A peer that rejects a client does so
            # at once; one that does not speak zenoh may stay silent until the timeout.
            is_early = time.monotonic() - began < remaining
        else:
            outage.end()
            return opened
        another = "name another endpoint (argument `endpoint`, or JOSTLE_ENDPOINT)"
        if not _resolves(endpoint):
            host = split_endpoint(endpoint)[1]
            raise Unavailable(f"no address is known of the host {host!r} in {endpoint}: {another}")
        is_listening = _listens(endpoint)
        if is_listening and not is_early:
            raise Unavailable(
                f"something accepts connections at {endpoint} but sent no reply within "
                f"{timeout:g} s: it may hang, or be another program; look at its process, or "
                f"{another}"
            )
        # A daemon that was not there yet, or has just ended, closes a connection, but not twice.
        if is_listening and was_rejected:
            mismatch = None if identity is None else certificate_mismatch(endpoint, identity[1])
            raise mismatch or _rejected(endpoint, identity)
        was_rejected = is_listening
        if not is_listening:
            outage.begin()
        backoff.sleep(
            Unavailable(
                f"no daemon answers at {endpoint}, tried for {timeout:g} s: start one with "
                f"`jostled serve`, or {another}"
            )
        )


def _config(
    endpoint: str, timeout: float, identity: tuple[Credentials, Path] | None
) -> zenoh.Config:
    milliseconds = max(1, round(timeout * 1000))
    config = zenoh.Config()
    for key, value in {
        # A peer would listen on every interface and connect to whatever it discovers.
        "mode": "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Otherwise a listener that does not speak zenoh blocks the caller for 10 s.
        "transport/unicast/open_timeout": milliseconds,
        # The session reconnects within a second after the daemon is back.
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 1000,
            "period_increase_factor": 2,
        },
        **({} if identity is None else zenoh_auth(*identity)),
    }.items():
        config.insert_json5(key, json.dumps(value))
    try:
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise invalid(
            "endpoint", f"invalid endpoint {endpoint!r}: use one such as tcp/127.0.0.1:7447"
        ) from None
    return config


def _is_private(endpoint: str) -> bool:
    """Whether a connection to `endpoint` is encrypted or stays on this machine."""
    protocol, host, _ = split_endpoint(endpoint)
    try:
        is_local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_local = False
    return protocol != "tcp" or is_local


def _resolves(endpoint: str) -> bool:
    """Whether the host of `endpoint` has an address."""
    protocol, host, _ = split_endpoint(endpoint)
    try:
        return protocol not in ("tcp", "tls") or bool(socket.getaddrinfo(host, None))
    except (OSError, UnicodeError):
        return False


def _listens(endpoint: str) -> bool:
    """Whether a process listens at `endpoint`."""
    protocol, host, port = split_endpoint(endpoint)
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        return False
    try:
        socket.create_connection((host, int(port)), _PROBE_TIMEOUT_SECS).close()
    except OSError:
        return False
    return True


def _rejected(endpoint: str, identity: tuple[Credentials, Path] | None) -> PermissionDenied:
    if identity is None:
        who = "this client"
        remedy = (
            "if it is a daemon with authentication, pass your credentials (argument "
            "`credentials`); if it is another program, name another endpoint"
        )
    else:
        who = identity[0].person
        remedy = (
            "if it is a daemon, these credentials may be newer than its last start (restart it), "
            "expired, or another daemon's, a clock may be wrong, or it has no authentication and "
            "accepts none"
        )
    return PermissionDenied(f"something listens at {endpoint} but rejects {who}: {remedy}")


def _await_hello(session: Session, node: str | None, backoff: Backoff) -> Hello:
    """Finds the daemon of that name, or the only one; waits while it recovers its swarms."""
    outage = Outage(session.endpoint, f"connect(timeout={session.timeout:g})")
    while True:
        try:
            hello = _hello(session, node, backoff.remaining)
        except FAILED as error:
            if "wire_version" in error.details:
                raise
            if (left := error.details.get("swarms_left")) is not None:
                # 0 at the begin, when the number is not known, and at the end.
                outage.begin(why="recovers its swarms" + (f", {left} left" if left else ""))
            elif not isinstance(error, Busy):
                outage.begin()
            backoff.sleep(error)
        else:
            outage.end()
            return hello


def _hello(session: Session, node: str | None, seconds: float) -> Hello:
    key = session.node_key("*" if node is None else node, "get/hello")
    replies = session.query_all(key, max(seconds, 0.0) + REPLY_MARGIN_SECS)
    hellos = [read_reply(reply, Hello) for reply in replies]
    if not hellos:
        raise _no_reply(session, node)
    if len(hellos) > 1:
        names = ", ".join(sorted(hello.node for hello in hellos))
        raise invalid(
            "node", f"several daemons answer at {session.endpoint}: name one of {names} as `node`"
        )
    (hello,) = hellos
    if hello.wire_version != WIRE_VERSION:
        raise Unavailable(
            f"the daemon {hello.version} at {session.endpoint} speaks version {hello.wire_version} "
            f"of the contract and this package version {WIRE_VERSION}: install the package that "
            "goes with the daemon",
            details={"wire_version": hello.wire_version},
        )
    return hello


def _no_reply(session: Session, node: str | None) -> JostleError:
    nodes = session.nodes()
    if nodes and node not in (None, *nodes):
        return Unavailable(
            f"no daemon named {node!r} answers at {session.endpoint}: there is {', '.join(nodes)}"
        )
    if nodes:
        return session.explain_silence(None)
    return Unavailable(
        f"zenoh answers at {session.endpoint}, but no daemon is reachable under the prefix "
        f"{session.prefix!r}: start one with `jostled serve`, or give its `prefix`"
    )
