"""Checks of the arguments of environments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, SupportsIndex

import gymnasium.error
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import whole_from_0
from .._errors import IncorrectState, invalid


class ResetNeeded(IncorrectState, gymnasium.error.ResetNeeded):
    """No episode is in progress: call `reset`. Also gymnasium's error of that name."""


def check_options(options: Mapping[str, Any] | None) -> None:
    """Checks the options of `reset`, of which there are none.

    Raises:
        InvalidArgument: There are some.
    """
    if options:
        names = ", ".join(map(repr, options))
        raise invalid(
            "options",
            f"unknown options of `reset`: {names}; it has none: give such arguments to the "
            "environment's class",
        )


def read_action(name: str, action: ArrayLike, size: int) -> NDArray[np.float64]:
    """An action as numbers clipped to -1 to 1.

    Raises:
        InvalidArgument: It is of another shape, or not finite.
    """
    numbers = np.asarray(action, float)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise invalid(name, f"{name} is {action!r}, but must be {size} finite numbers")
    clipped: NDArray[np.float64] = np.clip(numbers, -1.0, 1.0)
    return clipped


def at_least_1(name: str, value: SupportsIndex) -> int:
    """A whole number of at least 1.

    Raises:
        InvalidArgument: It is not.
    """
    number = whole_from_0(name, value)
    if number == 0:
        raise invalid(name, f"{name!r} is 0: use 1 or more")
    return number


def finite(name: str, value: float) -> float:
    """A finite number.

    Raises:
        InvalidArgument: It is not.
    """
    number = float(value)
    if not math.isfinite(number):
        raise invalid(name, f"{name!r} is {value!r}: use a finite one")
    return number


def positive(name: str, value: float) -> float:
    """A number above 0.

    Raises:
        InvalidArgument: It is not.
    """
    number = finite(name, value)
    if number <= 0.0:
        raise invalid(name, f"{name!r} is {value!r}: use one above 0")
    return number
