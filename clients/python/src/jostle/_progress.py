"""Progress bars on a terminal and in a notebook."""

from __future__ import annotations

import sys
import time
from typing import Self

from ._notebook import Display, is_notebook
from ._repr import bar_html

# Work that is shorter shows no bar, which would only flash.
_DELAY_SECS = 0.7


class Bar:
    """A progress bar on standard error or in a notebook.

    It is displayed if `show` is True, or if it is None, on a terminal and in a notebook, after a
    delay.

    Attributes:
        is_wanted: Whether it may be displayed.
    """

    def __init__(self, name: str, show: bool | None) -> None:
        self._name = name
        # A process without a console has no standard error.
        is_interactive = is_notebook() or (sys.stderr is not None and sys.stderr.isatty())
        self.is_wanted = is_interactive if show is None else show
        self._from = time.monotonic() + (_DELAY_SECS if show is None else 0.0)
        self._is_shown = False
        self._display: Display | None = None

    def show(self, share: float | None, text: str = "") -> None:
        """Displays the finished share, 0 to 1; None is unknown."""
        if self.is_wanted and (self._is_shown or time.monotonic() >= self._from):
            self._is_shown = True
            self._draw(share, text)

    def end(self, text: str) -> None:
        """Displays the end, if anything was displayed before."""
        if self._is_shown:
            self._draw(1.0, text)

    def _draw(self, share: float | None, text: str) -> None:
        percent = "" if share is None else f" {100 * share:3.0f} %"
        line = f"{self._name}{percent} {text}"
        if not is_notebook():
            sys.stderr.write(f"\r\x1b[K{line}")
            sys.stderr.flush()
        elif self._display is None:
            self._display = Display(bar_html(share, line))
        else:
            self._display.update(bar_html(share, line))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        if self._is_shown and self._display is None:
            sys.stderr.write("\n")
