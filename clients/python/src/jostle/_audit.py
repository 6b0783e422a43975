"""The audit log of a daemon: who sent which commands, and with what outcome."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import SupportsIndex

from ._arguments import check_name, check_parameter, whole
from ._decode import read_reply
from ._errors import JostleError, NotFound, Unavailable, invalid
from ._repr import HtmlList
from ._session import Session
from ._wire import Audit, AuditLine

# The most lines of a page.
_MAX_PAGE = 1000
# No line has a higher number: the page before it has the newest lines.
_MAX_NUMBER = 2**64 - 1


class Auditor:
    """The part of a `Client` that reads the audit log."""

    _session: Session
    _node: str

    def audit(
        self,
        *,
        user: str | None = None,
        client: str | None = None,
        verb: str | None = None,
        name: str | None = None,
        since: datetime | timedelta | None = None,
        until: datetime | timedelta | None = None,
        limit: SupportsIndex | None = 100,
    ) -> HtmlList[AuditLine]:
        """Who sent which commands to the daemon, and with what outcome; oldest first.

            for line in client.audit(verb="delete", since=timedelta(days=3)):
                print(line.when, line.user, line.client, line.name, line.outcomes)

        The log has the commands that the daemon accepted or rejected by permission, also those on
        swarms that were deleted since. It requires an operator.

        Args:
            user: Only commands of this user; "" for those of nobody known.
            client: Only commands of the client that gives itself this name.
            verb: Only commands with this verb.
            name: Only commands on the swarm, experiment or recording of this name.
            since: Only commands since this time, a datetime with a time zone, or since so long ago.
            until: Only commands until this time, in the same forms.
            limit: Only the newest lines, at most this many; None is all that the daemon stores.

        Raises:
            InvalidArgument: An argument is invalid.
            PermissionDenied: The client is not an operator.
            Unavailable: The daemon is of an earlier version, which has no audit log.
        """

        def request(rest: str) -> Audit:
            key = self._session.node_key(self._node, rest)
            return read_reply(self._session.get(key, swarm=None), Audit)

        return newest_lines(request, selection(user, client, verb, name, since, until), limit)


def selection(
    user: str | None,
    client: str | None,
    verb: str | None,
    name: str | None,
    since: datetime | timedelta | None,
    until: datetime | timedelta | None,
) -> str:
    """The parameters of a query that select lines, each after a `;`."""
    begin = None if since is None else _unix_secs("since", since)
    end = None if until is None else _unix_secs("until", until)
    if begin is not None and end is not None and begin > end:
        raise invalid("until", f"until is {until!r}, which is before since, {since!r}")
    parameters = {
        # No text selects the lines without a user.
        "user": check_parameter("user", user) if user else user,
        "client": None if client is None else check_parameter("client", client),
        "verb": None if verb is None else check_parameter("verb", verb),
        "name": None if name is None else check_name("name", name),
        "from_time": begin,
        "to_time": end,
    }
    return "".join(f";{key}={value}" for key, value in parameters.items() if value is not None)


def newest_lines(
    request: Callable[[str], Audit], parameters: str, limit: SupportsIndex | None
) -> HtmlList[AuditLine]:
    """The newest lines, at most `limit`, oldest first; `request` sends a query for a page."""
    most = None if limit is None else whole("limit", limit)
    if most is not None and most < 1:
        raise invalid("limit", f"limit is {most}, but must be above 0, or None for all lines")
    lines: list[AuditLine] = []
    damaged = 0
    before = _MAX_NUMBER
    while most is None or len(lines) < most:
        wanted = _MAX_PAGE if most is None else min(most - len(lines), _MAX_PAGE)
        try:
            page = request(f"get/audit?before={before};limit={wanted}{parameters}")
        except NotFound as error:
            raise _of_earlier_version(error) from error
        damaged += page.damaged
        earlier = [line for line in page.lines if line.number < before]
        if not earlier:
            break
        lines = earlier + lines
        before = lines[0].number
        if page.oldest is None or page.oldest >= before:
            break
    if damaged:
        warnings.warn(
            f"{damaged} lines of the audit log cannot be read and are left out: check the disk of "
            "the daemon",
            RuntimeWarning,
            stacklevel=3,
        )
    return HtmlList(lines)


def _of_earlier_version(error: NotFound) -> JostleError:
    if "known" in error.details:
        return Unavailable("the daemon is of an earlier version, which has no audit log")
    return error


def _unix_secs(what: str, when: datetime | timedelta) -> float:
    if isinstance(when, timedelta):
        when = datetime.now(UTC) - when
    if not isinstance(when, datetime) or when.tzinfo is None:
        raise invalid(
            what,
            f"{what} is {when!r}, but must be a datetime with a time zone, such as "
            "datetime(2026, 11, 28, tzinfo=UTC), or how long ago, such as timedelta(hours=2)",
        )
    return round(max(when.timestamp(), 0.0), 3)
