"""What the environments are handed in."""

from __future__ import annotations

import math
from typing import SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import whole_from_0
from .._errors import InvalidArgument


def read_action(name: str, action: ArrayLike, size: int) -> NDArray[np.float64]:
    """An action as numbers from -1 to 1; what is beyond is taken as that.

    Raises:
        InvalidArgument: It is of another shape, or not finite.
    """
    numbers = np.asarray(action, float)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise InvalidArgument(
            f"{name} is {action!r}: it takes {size} finite numbers", details={"field": name}
        )
    clipped: NDArray[np.float64] = np.clip(numbers, -1.0, 1.0)
    return clipped


def at_least_1(name: str, value: SupportsIndex) -> int:
    """A whole number of at least 1.

    Raises:
        InvalidArgument: It is none.
    """
    number = whole_from_0(name, value)
    if number == 0:
        raise InvalidArgument(f"{name!r} is 0: 1 or more", details={"field": name})
    return number


def finite(name: str, value: float) -> float:
    """A number that is finite.

    Raises:
        InvalidArgument: It is none.
    """
    number = float(value)
    if not math.isfinite(number):
        raise InvalidArgument(f"{name!r} is {value!r}: a finite number", details={"field": name})
    return number


def positive(name: str, value: float) -> float:
    """A number above 0.

    Raises:
        InvalidArgument: It is none.
    """
    number = finite(name, value)
    if number <= 0.0:
        raise InvalidArgument(f"{name!r} is {value!r}: above 0", details={"field": name})
    return number


def check_render_mode(mode: str | None) -> str | None:
    """A render mode that there is.

    Raises:
        InvalidArgument: It is none.
    """
    if mode not in (None, "rgb_array"):
        raise InvalidArgument(
            f"`render_mode` is {mode!r}: 'rgb_array' or None", details={"field": "render_mode"}
        )
    return mode
