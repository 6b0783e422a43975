"""How far something is that takes long: a bar, if somebody looks on."""

from __future__ import annotations

import importlib
import sys
import time
from types import TracebackType
from typing import Any, Protocol, Self

from . import _show
from ._notebook import Place, as_html, is_notebook, place

_WHOLE = 1000
# What takes no longer needs no bar, and one that only flashes up is none.
_DELAY_SECS = 0.7


class Bar:
    """A bar on standard error or in a notebook, shown if `show`, or if anyone looks on there.

    Nobody asked for the latter: it comes only when the work has taken a moment already.
    """

    def __init__(self, name: str, show: bool | None) -> None:
        self._name = name
        self._is_wanted = is_watched() if show is None else show
        self._from = time.monotonic() + (_DELAY_SECS if show is None else 0.0)
        self._shown: _Bar | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether there is anyone to show it to."""
        return self._is_wanted

    def show(self, share: float | None, text: str = "") -> None:
        """Shows that so much is done, 0 to 1; None if that is not known."""
        if self._is_wanted and (self._shown is not None or time.monotonic() >= self._from):
            self._shown = self._shown or _bar(self._name)
            self._shown.show(share, text)

    def end(self, text: str) -> None:
        """Shows that all is done, if anything was shown of it."""
        if self._shown is not None:
            self._shown.show(1.0, text)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._shown is not None:
            self._shown.close()


def is_watched() -> bool:
    """Whether anyone sees what is shown: a terminal or a notebook."""
    # Without a console there is no standard error either.
    return is_notebook() or (sys.stderr is not None and sys.stderr.isatty())


class _Bar(Protocol):
    """One way to show how far something is."""

    def show(self, share: float | None, text: str) -> None:
        """Shows it."""

    def close(self) -> None:
        """Leaves the last."""


class _Plain:
    """A line that changes."""

    def __init__(self, name: str) -> None:
        self._name = name

    def show(self, share: float | None, text: str) -> None:
        done = "" if share is None else f" {100 * share:3.0f} %"
        sys.stderr.write(f"\r\x1b[K{self._name}{done} {text}")
        sys.stderr.flush()

    def close(self) -> None:
        sys.stderr.write("\n")


class _Tqdm:
    """The bar of tqdm."""

    def __init__(self, tqdm: Any, name: str) -> None:
        form = "{desc} {percentage:3.0f}%|{bar}|{postfix} [{elapsed}<{remaining}]"
        self._bar = tqdm.tqdm(total=_WHOLE, desc=name, bar_format=form)

    def show(self, share: float | None, text: str) -> None:
        self._bar.set_postfix_str(text, refresh=share is None)
        if share is not None:
            self._bar.update(round(_WHOLE * share) - self._bar.n)

    def close(self) -> None:
        self._bar.close()


class _Notebook:
    """A bar of the browser's, in one place."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._place: Place | None = None

    def show(self, share: float | None, text: str) -> None:
        done = "" if share is None else f" {100 * share:.0f} %"
        shown = _show.bar(share, f"{self._name}{done} {text}")
        if self._place is None:
            self._place = place(shown)
        else:
            self._place.update(as_html(shown))

    def close(self) -> None:
        """Nothing to do: the last stays."""


def _bar(name: str) -> _Bar:
    if is_notebook():
        return _Notebook(name)
    try:
        # Not the one that chooses by itself: in a notebook that wants widgets.
        return _Tqdm(importlib.import_module("tqdm"), name)
    except ImportError:
        return _Plain(name)
