"""Threads for calls that wait: as many as there are calls under way, and none for long after."""

from __future__ import annotations

import atexit
import threading
from collections import deque
from collections.abc import Callable

from ._ends import join_at_exit

# A thread is kept this long for the next call, seconds: in a loop of calls none is started anew.
_IDLE_SECS = 2.0


class Workers:
    """Calls each piece of work in a thread of its own at once, in one that is free if there is.

    A pool of a fixed size would be stuck when each of its threads waits for something that only
    the work behind it brings about.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._work: deque[Callable[[], None]] = deque()
        self._idle = 0
        self.is_over = False

    def start(self, work: Callable[[], None]) -> None:
        """Has `work` called, which raises nothing; here and now when the interpreter ends."""
        if self.is_over:
            work()
            return
        with self._changed:
            self._work.append(work)
            if len(self._work) <= self._idle:
                self._changed.notify()
                return
        # Not one that keeps the interpreter from exiting.
        thread = threading.Thread(target=self._run, name="jostle-worker", daemon=True)
        join_at_exit(thread)
        thread.start()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._idle += 1
                self._changed.wait_for(lambda: bool(self._work) or self.is_over, _IDLE_SECS)
                self._idle -= 1
                if not self._work:
                    return
                work = self._work.popleft()
            work()
            # What the work held is not held while there is none.
            del work

    def end(self) -> None:
        """Has every thread end when its work is done."""
        with self._changed:
            self.is_over = True
            self._changed.notify_all()


workers = Workers()
"""Those of this process."""

# Before the links are closed, which ends what the threads are still waiting for.
atexit.register(workers.end)
