"""Whether this is a notebook, and what it shows in one place, again and again."""

from __future__ import annotations

import sys
from typing import Any, Protocol

from ._extras import need


class Place(Protocol):
    """A place in a notebook."""

    def update(self, shown: object) -> None:
        """Shows something else there."""


def is_notebook() -> bool:
    """Whether what is displayed is seen in a notebook."""
    # Where there is a kernel, it has been imported.
    kernel = sys.modules.get("ipykernel.zmqshell")
    ipython = sys.modules.get("IPython")
    if kernel is None or ipython is None:
        return False
    return isinstance(ipython.get_ipython(), kernel.ZMQInteractiveShell)


def place(html: str) -> Place:
    """Shows `html` here and returns the place.

    Raises:
        ImportError: There is no IPython.
    """
    display = need("IPython.display", "notebook")
    shown: Place = display.display(display.HTML(html), display_id=True)
    return shown


def as_html(html: str) -> Any:
    """What a place takes."""
    return need("IPython.display", "notebook").HTML(html)
