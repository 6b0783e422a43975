"""When a request that failed is sent again: one policy for every kind of request."""

from __future__ import annotations

import random
import time

from ._cancel import sleep
from ._errors import Busy, Contested, JostleError, NotFound, PermissionDenied, Unavailable

# The file `tests/outages.toml` of the repository defines these numbers for all clients.
FIRST_DELAY_SECS = 0.05
GROWTH = 2.0
MAX_DELAY_SECS = 1.0
JITTER = 0.5
MAX_SILENT_RETRIES = 2
# The commands whose replies a daemon forgets when it ends: another run would execute them again.
FORGOTTEN_COMMANDS = ("discard", "experiment", "record", "replay", "seek")

FAILED = (Busy, Unavailable, NotFound, PermissionDenied, Contested)
"""The errors of a request that may be sent again; `Backoff.sleep` decides."""


class Backoff:
    """Limits the attempts of a request.

    Attempts end `seconds` after `began` (by `time.monotonic`), or after `failing_secs` in which
    every attempt failed. `was_interrupted` is whether the daemon was not reachable before.
    """

    def __init__(
        self, began: float, seconds: float, failing_secs: float, *, was_interrupted: bool = False
    ) -> None:
        self._began = began
        self._deadline = began + seconds
        self._failing_secs = failing_secs
        self.reset()
        self._was_interrupted = was_interrupted

    @property
    def elapsed(self) -> float:
        """Seconds since the first attempt."""
        return time.monotonic() - self._began

    @property
    def is_settled(self) -> bool:
        """Whether so many replies are missing that no connection that breaks can be the cause."""
        return self._silent > MAX_SILENT_RETRIES and not self._was_interrupted

    @property
    def remaining(self) -> float:
        """Seconds until the deadline."""
        return self._deadline - time.monotonic()

    def reset(self) -> None:
        """Starts over with the shortest delay, since an attempt did not fail."""
        self._give_up_at: float | None = None
        self._delay = FIRST_DELAY_SECS
        self._silent = 0
        self._was_interrupted = False

    def sleep(self, error: JostleError) -> float:
        """Sleeps before the next attempt, and returns how many seconds attempts may still take.

        Raises:
            JostleError: `error`, if another attempt cannot help or there is no time for it.
        """
        now = time.monotonic()
        if self._give_up_at is None:
            self._give_up_at = min(self._deadline, now + self._failing_secs)
        if isinstance(error, Unavailable):
            self._was_interrupted = True
        elif error.details.get("is_silence"):
            # After an interruption a daemon may be connected before its swarms are. While a
            # connection breaks, a swarm may disappear before its daemon does.
            self._silent += 1
            if self.is_settled:
                raise error
        elif not isinstance(error, Busy):
            raise error
        delay = self._delay * random.uniform(1.0 - JITTER, 1.0 + JITTER)
        if now + delay >= self._give_up_at:
            raise error
        sleep(delay)
        self._delay = min(GROWTH * self._delay, MAX_DELAY_SECS)
        return self._give_up_at - now - delay
