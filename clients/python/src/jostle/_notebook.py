"""Detects a notebook, and displays HTML in it that can be replaced."""

from __future__ import annotations

import sys

from ._extras import import_extra


def is_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    # A kernel has imported it.
    kernel = sys.modules.get("ipykernel.zmqshell")
    ipython = sys.modules.get("IPython")
    if kernel is None or ipython is None:
        return False
    return isinstance(ipython.get_ipython(), kernel.ZMQInteractiveShell)


class Display:
    """HTML in the output of a notebook's cell, which can be replaced.

    Raises:
        ImportError: IPython is missing.
    """

    def __init__(self, html: str) -> None:
        self._ipython = import_extra("IPython.display", "notebook")
        self._handle = self._ipython.display(self._ipython.HTML(html), display_id=True)

    def update(self, html: str) -> None:
        """Replaces it."""
        self._handle.update(self._ipython.HTML(html))
