"""A live view in a notebook: a picture that follows a swarm in place."""

from __future__ import annotations

import threading
import time
from typing import Protocol

from ._arguments import check_seconds
from ._draw import Camera
from ._errors import DeadlineExceeded, JostleError
from ._notebook import Display
from ._repr import error_html
from ._state import State, draw_state
from ._stream import Stream
from ._threads import start_thread

_POLL_INTERVAL_SECS = 0.2


class _Swarm(Protocol):
    """What a view needs of a `Swarm`."""

    @property
    def name(self) -> str: ...

    def states(self, *, timeout: float | None = None) -> Stream[State]:
        """Its states."""

    def _repr_html_(self) -> str: ...


class View:
    """A picture of a swarm that follows it; `Swarm.view` makes one.

        swarm.view()           # as the last expression of a cell

    It starts when a notebook displays it, and continues while other cells run. It ends after its
    duration, with `stop()`, or when the swarm is deleted.
    """

    def __init__(self, swarm: _Swarm, seconds: float, hz: float) -> None:
        self._swarm = swarm
        self._seconds = check_seconds("seconds", seconds)
        self._pause = 1.0 / check_seconds("hz", hz)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def __repr__(self) -> str:
        live = self._thread is not None and self._thread.is_alive()
        return f"View({self._swarm.name!r}{', live' if live else ''})"

    def show(self) -> None:
        """Displays it and returns when it has ended; Ctrl-C, or the stop button, ends it.

        Raises:
            ImportError: IPython is missing: `pip install jostle[notebook]`.
        """
        self._ipython_display_()
        try:
            self.wait()
        finally:
            self.stop()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it has ended; returns whether it has within `timeout` seconds."""
        if self._thread is not None:
            self._thread.join(timeout)
        return self._thread is None or not self._thread.is_alive()

    def stop(self) -> None:
        """Ends it and leaves the last picture; a second call does nothing."""
        self._stopping.set()
        self.wait()

    def _ipython_display_(self) -> None:
        self.stop()
        self._stopping.clear()
        shown = Display(self._swarm._repr_html_())
        self._thread = start_thread(lambda: self._follow(shown), "jostle-view")

    def _follow(self, shown: Display) -> None:
        ends = time.monotonic() + self._seconds
        camera = Camera()
        try:
            with self._swarm.states(timeout=_POLL_INTERVAL_SECS) as states:
                while time.monotonic() < ends and not self._stopping.is_set():
                    try:
                        state = next(states)
                    except DeadlineExceeded:
                        # The swarm is paused.
                        continue
                    except StopIteration:
                        return
                    shown.update(draw_state(state, camera))
                    self._stopping.wait(self._pause)
        except JostleError as error:
            shown.update(error_html(error))
