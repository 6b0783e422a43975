"""Whether a swarm is reachable, from its and its daemon's liveliness tokens."""

from __future__ import annotations

from enum import Enum, auto

# How long after a swarm's token its daemon's token may disappear, if the daemon ends.
_DAEMON_TOKEN_TIMEOUT_SECS = 1.0
# How long after a daemon's token the tokens of its swarms may appear.
_SWARM_TOKEN_TIMEOUT_SECS = 3.0


class _State(Enum):
    PRESENT = auto()
    # The token of the swarm disappeared; that of its daemon may do so, too.
    MISSING = auto()
    # That of its daemon disappeared, too.
    AWAY = auto()
    # Its daemon is back; its own token may appear.
    EXPECTED = auto()


class Change(Enum):
    """What has become of a swarm whose token disappeared."""

    AWAY = auto()
    """Its daemon is not reachable."""

    DELETED = auto()
    """Its daemon is reachable, and it is not."""

    NOT_RECOVERED = auto()
    """Its daemon came back without it."""


class Presence:
    """The state of a swarm and its daemon; times are those of `time.monotonic`.

    The same machine as that of the Rust client, `clients/rust/src/presence.rs`.
    """

    def __init__(self) -> None:
        self._state = _State.PRESENT
        self._until: float | None = None
        self._is_node_there = True

    @property
    def is_present(self) -> bool:
        """Whether the token of the swarm is declared."""
        return self._state is _State.PRESENT

    @property
    def is_away(self) -> bool:
        """Whether the daemon is not reachable."""
        return self._state is _State.AWAY

    @property
    def deadline(self) -> float | None:
        """When to call `judge`, unless a token changes the state earlier."""
        return self._until

    def swarm_token(self, is_alive: bool, now: float) -> bool:
        """The token of the swarm appeared or disappeared; returns whether it is back."""
        if is_alive:
            is_back = not self.is_present
            self._become(_State.PRESENT, None)
            return is_back
        if self.is_present:
            # Without the token of its daemon no other token can change the verdict.
            wait = _DAEMON_TOKEN_TIMEOUT_SECS if self._is_node_there else 0.0
            self._become(_State.MISSING, now + wait)
        return False

    def node_token(self, is_alive: bool, now: float) -> None:
        """The token of its daemon appeared or disappeared."""
        self._is_node_there = is_alive
        if self._state is _State.MISSING and not is_alive:
            self._until = now
        elif self._state is _State.AWAY and is_alive:
            self._become(_State.EXPECTED, now + _SWARM_TOKEN_TIMEOUT_SECS)
        elif self._state is _State.EXPECTED and not is_alive:
            self._become(_State.AWAY, None)

    def judge(self, is_node_there: bool) -> Change | None:
        """What has become of the swarm; called after the deadline has passed."""
        if self._state is _State.MISSING:
            if is_node_there:
                return Change.DELETED
            self._become(_State.AWAY, None)
            return Change.AWAY
        if self._state is _State.EXPECTED:
            if is_node_there:
                return Change.NOT_RECOVERED
            self._become(_State.AWAY, None)
        return None

    def _become(self, state: _State, until: float | None) -> None:
        self._state, self._until = state, until
