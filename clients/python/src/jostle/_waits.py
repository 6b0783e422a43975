"""The ids of waits for conditions."""

from __future__ import annotations

import threading
import time
import uuid
from collections import deque

# The daemon may still know a wait that has ended. Ids are used again since zenoh keeps an entry for
# each key of a liveliness token, in a table of 65,535 keys.
_REUSE_DELAY_SECS = 15.0


class WaitIds:
    """The ids of the waits of a session."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._session = uuid.uuid4().hex
        self._count = 0
        # Those of waits that have ended, and when, the first one first.
        self._free: deque[tuple[float, str]] = deque()

    def take(self) -> str:
        """An id that no other wait has."""
        with self._lock:
            if self._free and time.monotonic() - self._free[0][0] >= _REUSE_DELAY_SECS:
                return self._free.popleft()[1]
            self._count += 1
            return f"{self._session}-{self._count}"

    def give_back(self, wait_id: str) -> None:
        """Notes that a wait has ended."""
        with self._lock:
            self._free.append((time.monotonic(), wait_id))
