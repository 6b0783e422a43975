"""What is said about a daemon that is not reachable, by calls that wait for it."""

from __future__ import annotations

import logging
import time

RECONNECT_TIMEOUT_SECS = 60.0
"""How long a wait for a swarm or an experiment tolerates a daemon that is not reachable."""

_logger = logging.getLogger("jostle")


class Outage:
    """Logs once when the daemon is not reachable, and once when it is back.

    `what` goes on meanwhile, such as "the stream of states of swarm 'school'". Both are warnings,
    which Python prints if the program does not configure logging.
    """

    def __init__(self, endpoint: str, what: str) -> None:
        self._endpoint = endpoint
        self._what = what
        self._since: float | None = None
        self._is_logged = False

    @property
    def is_ongoing(self) -> bool:
        """Whether it has begun, or may have."""
        return self._since is not None

    def may_begin(self) -> None:
        """A request failed, perhaps because of an outage: its success shows that it was one."""
        if self._since is None:
            self._since = time.monotonic()

    def begin(self, at: float | None = None, why: str = "is not reachable") -> None:
        """The daemon is not reachable, since `at` or now; a second call does nothing."""
        if not self._is_logged:
            self._is_logged = True
            self._since = at or self._since or time.monotonic()
            _logger.warning("the daemon at %s %s: %s waits for it", self._endpoint, why, self._what)

    def end(self) -> None:
        """The daemon is reachable; does nothing if it was all the time."""
        if self._since is None:
            return
        self.begin()
        seconds = time.monotonic() - self._since
        self._since, self._is_logged = None, False
        _logger.warning(
            "the daemon at %s is back after %.1f s: %s goes on",
            self._endpoint,
            seconds,
            self._what,
        )
