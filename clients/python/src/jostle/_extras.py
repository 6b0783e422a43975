"""Optional dependencies."""

from __future__ import annotations

import importlib
from typing import Any


def import_extra(module: str, extra: str) -> Any:
    """Imports a module of the extra `extra`.

    Raises:
        ImportError: It is not installed; the message has the remedy.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not module.startswith(error.name):
            raise
        raise ImportError(
            f"{error.name} is missing: `pip install 'jostle[{extra}]'` installs it", name=error.name
        ) from None
