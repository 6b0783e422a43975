"""Exponential backoff between the attempts of a request."""

from __future__ import annotations

import random
import time

from ._cancel import sleep
from ._errors import JostleError

# Doubled after each attempt. Jitter of half the delay spreads the attempts of many clients.
_FIRST_DELAY_SECS = 0.02
_MAX_DELAY_SECS = 0.5


class Backoff:
    """Limits the attempts of a request.

    Attempts end `seconds` after `began` (by `time.monotonic`), or after `failing_secs` in which
    every attempt failed.
    """

    def __init__(self, began: float, seconds: float, failing_secs: float) -> None:
        self._began = began
        self._deadline = began + seconds
        self._failing_secs = failing_secs
        self.reset()

    @property
    def elapsed(self) -> float:
        """Seconds since the first attempt."""
        return time.monotonic() - self._began

    @property
    def remaining(self) -> float:
        """Seconds until the deadline."""
        return self._deadline - time.monotonic()

    def reset(self) -> None:
        """Starts over with the shortest delay, since an attempt did not fail."""
        self._give_up_at: float | None = None
        self._delay = _FIRST_DELAY_SECS

    def sleep(self, error: JostleError) -> float:
        """Sleeps before the next attempt, and returns how many seconds attempts may still take.

        Raises:
            JostleError: `error`, if there is no time for another attempt.
        """
        now = time.monotonic()
        if self._give_up_at is None:
            self._give_up_at = min(self._deadline, now + self._failing_secs)
        delay = self._delay * random.uniform(0.5, 1.5)
        if now + delay >= self._give_up_at:
            raise error
        sleep(delay)
        self._delay = min(2.0 * self._delay, _MAX_DELAY_SECS)
        return self._give_up_at - now - delay
