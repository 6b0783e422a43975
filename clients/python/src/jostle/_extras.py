"""What is not installed with the package itself."""

from __future__ import annotations

import importlib
from typing import Any


def need(module: str, extra: str) -> Any:
    """Imports what `pip install jostle[extra]` brings.

    Raises:
        ImportError: It is not there; the message says how to get it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not module.startswith(error.name):
            raise
        raise ImportError(
            f"this needs {error.name}: `pip install 'jostle[{extra}]'` brings it", name=error.name
        ) from None
