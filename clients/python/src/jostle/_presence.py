"""Whether a swarm is reachable, from its and its daemon's liveliness tokens."""

from __future__ import annotations

from enum import Enum, auto

# How long after a swarm's token its daemon's token may disappear, if the daemon ends.
_DAEMON_TOKEN_TIMEOUT_SECS = 1.0
# How long after a daemon's token the tokens of its swarms may appear.
_SWARM_TOKEN_TIMEOUT_SECS = 3.0
# The interval of queries to a daemon that does not reply.
_RETRY_INTERVAL_SECS = 1.0


class State(Enum):
    """Which of the two tokens are declared."""

    PRESENT = auto()
    """That of the swarm."""

    MISSING = auto()
    """That of its daemon; the swarm was deleted, or the daemon's token disappears, too."""

    AWAY = auto()
    """None."""

    EXPECTED = auto()
    """That of its daemon, which came back; the swarm's may appear."""


class Presence:
    """The state of a swarm and its daemon; times are those of `time.monotonic`.

    As in the Rust client, `clients/rust/src/presence.rs`, but a daemon's token that disappeared
    together with the swarm's counts even if it is back before anybody looks.
    """

    def __init__(self) -> None:
        self.state = State.PRESENT
        self._until: float | None = None
        self._is_node_there = True

    @property
    def deadline(self) -> float | None:
        """When to ask the daemon for its swarms, unless a token changes the state earlier."""
        return self._until

    def swarm_token(self, is_alive: bool, now: float) -> None:
        """The token of the swarm appeared or disappeared."""
        if is_alive:
            self._become(State.PRESENT, None)
        elif self.state is State.PRESENT:
            if self._is_node_there:
                self._become(State.MISSING, now + _DAEMON_TOKEN_TIMEOUT_SECS)
            else:
                self._become(State.AWAY, None)

    def node_token(self, is_alive: bool, now: float) -> None:
        """The token of its daemon appeared or disappeared."""
        self._is_node_there = is_alive
        if not is_alive and self.state is not State.PRESENT:
            self._become(State.AWAY, None)
        elif is_alive and self.state is State.AWAY:
            self._become(State.EXPECTED, now + _SWARM_TOKEN_TIMEOUT_SECS)

    def ask_later(self, now: float) -> None:
        """The daemon did not reply."""
        self._until = now + _RETRY_INTERVAL_SECS

    def _become(self, state: State, until: float | None) -> None:
        self.state, self._until = state, until
