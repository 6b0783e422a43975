"""How often and how long something is tried again."""

from __future__ import annotations

import random
import time

from ._cancel import rest
from ._errors import JostleError

# Twice as long each time, and about half more or less so that many do not come back at one moment.
_FIRST_PAUSE_SECS = 0.02
_LONGEST_PAUSE_SECS = 0.5


class Patience:
    """Lasts for `seconds`, and no longer than `trouble_secs` when nothing but trouble comes.

    `began` is when it began, by `time.monotonic`.
    """

    def __init__(self, began: float, seconds: float, trouble_secs: float) -> None:
        self._began = began
        self._deadline = began + seconds
        self._trouble_secs = trouble_secs
        self.recover()

    @property
    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self._began

    @property
    def remaining(self) -> float:
        """Seconds until the deadline."""
        return self._deadline - time.monotonic()

    def recover(self) -> None:
        """Takes trouble there was for over."""
        self._give_up: float | None = None
        self._pause = _FIRST_PAUSE_SECS

    def pause(self, trouble: JostleError) -> float:
        """Waits a little before the next try, and returns how long the one after may take.

        Raises:
            JostleError: `trouble`, if there is no time for another try.
        """
        now = time.monotonic()
        if self._give_up is None:
            self._give_up = min(self._deadline, now + self._trouble_secs)
        pause = self._pause * random.uniform(0.5, 1.5)
        if now + pause >= self._give_up:
            raise trouble
        rest(pause)
        self._pause = min(2.0 * self._pause, _LONGEST_PAUSE_SECS)
        return self._give_up - now - pause
