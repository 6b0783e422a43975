"""A live view in a notebook: a picture that follows a swarm in place."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from . import _show
from ._arguments import check_seconds
from ._draw import Camera, draw
from ._ends import join_at_exit
from ._errors import DeadlineExceeded, JostleError
from ._notebook import Place, as_html, place

if TYPE_CHECKING:
    from ._swarm import Swarm

_LOOK_AGAIN_SECS = 0.2


class View:
    """A picture of a swarm that follows it; `Swarm.view` makes one.

    As the last thing in a cell it begins, and goes on while other cells are run. It ends by
    itself, with `stop()`, or when the swarm or its daemon goes.
    """

    def __init__(self, swarm: Swarm, seconds: float, hz: float) -> None:
        self._swarm = swarm
        self._seconds = check_seconds("seconds", seconds)
        self._pause = 1.0 / check_seconds("hz", hz)
        self._told = threading.Event()
        self._thread: threading.Thread | None = None

    def __repr__(self) -> str:
        live = self._thread is not None and self._thread.is_alive()
        return f"View({self._swarm.name!r}{', live' if live else ''})"

    def show(self) -> None:
        """Shows it here and returns when it has ended; Ctrl-C, or the stop button, ends it."""
        self._ipython_display_()
        try:
            self.wait()
        finally:
            self.stop()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it has ended, and says whether it has within `timeout` seconds."""
        if self._thread is not None:
            self._thread.join(timeout)
        return self._thread is None or not self._thread.is_alive()

    def stop(self) -> None:
        """Leaves the last picture; harmless when done already."""
        self._told.set()
        self.wait()

    def _ipython_display_(self) -> None:
        self.stop()
        self._told.clear()
        shown = place(self._swarm._repr_html_())
        self._thread = threading.Thread(
            target=self._follow, args=(shown,), name="jostle-view", daemon=True
        )
        join_at_exit(self._thread)
        self._thread.start()

    def _follow(self, shown: Place) -> None:
        ends = time.monotonic() + self._seconds
        camera = Camera()
        try:
            with self._swarm.states(timeout=_LOOK_AGAIN_SECS) as states:
                while time.monotonic() < ends and not self._told.is_set():
                    try:
                        state = next(states)
                    except DeadlineExceeded:
                        # It stands still.
                        continue
                    except StopIteration:
                        return
                    shown.update(as_html(draw(state, camera=camera)))
                    self._told.wait(self._pause)
        except JostleError as error:
            shown.update(as_html(_show.trouble(error)))
