"""What callers hand in: names, selections, starts, and how they become JSON.

Whatever NumPy has for a number or a column of numbers is taken as one.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, SupportsFloat, SupportsIndex, TypedDict, cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from ._errors import InvalidArgument
from ._spec import Disc, Given

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_MAX_LABEL_BYTES = 256
# No request nests deeper; a list within itself has no end.
_DEEPEST = 16


class Ids(TypedDict):
    """These individuals."""

    ids: Sequence[int]


class Count(TypedDict):
    """This many, drawn by the daemon."""

    count: int


class Fraction(TypedDict):
    """This share, 0 to 1, drawn by the daemon; rounded to a whole number of individuals."""

    fraction: float


class Region(TypedDict):
    """A disc: absolute centre and radius, body sizes."""

    x: float
    y: float
    radius: float


class Pose(TypedDict):
    """Where a body is: absolute position, body sizes, and heading, radians from +x."""

    x: float
    y: float
    alpha: float


class Within(TypedDict):
    """All whose centre is in a disc."""

    within: Region


class AlongCount(TypedDict):
    """How many, and along which direction in radians, counter-clockwise from +x."""

    count: int
    along: float


class Foremost(TypedDict):
    """The ones furthest along a direction."""

    foremost: AlongCount


Select = Ids | Count | Fraction | Within | Foremost
"""Which individuals a command is about: a dictionary of one of these shapes."""


def ids(individuals: Iterable[SupportsIndex]) -> Ids:
    """Selects individuals by id, such as `ids(state.id[state.x > 0])`.

    Raises:
        InvalidArgument: One of them is no whole number.
    """
    if not isinstance(individuals, Iterable):
        raise InvalidArgument(
            f"select.ids is {individuals!r}, but must be several whole numbers, such as [1, 2]",
            details={"field": "select.ids"},
        )
    return {"ids": [whole("select.ids", individual) for individual in individuals]}


def count(individuals: SupportsIndex) -> Count:
    """Selects so many individuals, drawn by the daemon from the swarm's seed."""
    return {"count": whole("select.count", individuals)}


def fraction(share: float) -> Fraction:
    """Selects a share of the individuals, 0 to 1, drawn by the daemon from the swarm's seed."""
    return {"fraction": share}


def within(x: float, y: float, radius: float) -> Within:
    """Selects all whose centre is in a disc: absolute centre and radius, body sizes."""
    return {"within": {"x": x, "y": y, "radius": radius}}


def foremost(count: SupportsIndex, along: float) -> Foremost:
    """Selects the `count` individuals furthest along a direction, in radians from +x."""
    return {"foremost": {"count": whole("select.foremost.count", count), "along": along}}


def check_select(select: Select) -> Select:
    """Returns `select` if it may be a selection.

    Raises:
        InvalidArgument: It is none.
    """
    if not isinstance(select, Mapping):
        raise InvalidArgument(
            f"select is {select!r}, but must be a selection such as jostle.count(3) or "
            "jostle.ids([1, 2])",
            details={"field": "select"},
        )
    return select


def disc(radius: float | None = None) -> Disc:
    """A start drawn uniformly in a disc; its radius in body sizes, None is √n, at least 1."""
    return Disc(radius)


def given(x: ArrayLike, y: ArrayLike, alpha: ArrayLike) -> Given:
    """A start with every individual exactly where it is told, to the bit.

    Args:
        x: Absolute positions, shape (n,), body sizes.
        y: Absolute positions, shape (n,), body sizes.
        alpha: Headings, shape (n,), radians, counter-clockwise from +x.

    Raises:
        InvalidArgument: They are no columns of one length, of finite numbers.
    """
    columns = [_column(name, c) for name, c in (("x", x), ("y", y), ("alpha", alpha))]
    lengths = [len(column) for column in columns]
    if len(set(lengths)) != 1:
        raise InvalidArgument(
            f"x, y and alpha have lengths {lengths}, but must be of one length",
            details={"field": "spec.start"},
        )
    return Given(*columns)


def _column(name: str, values: ArrayLike) -> list[float]:
    field = {"field": f"spec.start.{name}"}
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"{name} is no column of numbers: {error}", details=field) from error
    if column.ndim != 1:
        raise InvalidArgument(f"{name} has shape {column.shape}, not (n,)", details=field)
    if not np.isfinite(column).all():
        raise InvalidArgument(f"{name} holds a number that is not finite", details=field)
    return cast("list[float]", column.tolist())


def poses(rows: ArrayLike) -> list[Pose]:
    """Where bodies are to be, one row each, for `jostle.Inject(at=…)`.

    Args:
        rows: x, y, alpha: shape (m, 3), absolute positions in body sizes, headings in radians.

    Raises:
        InvalidArgument: They are of another shape, or no numbers.
    """
    try:
        columns = np.asarray(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(
            f"`at` holds no rows of numbers: {error}", details={"field": "at"}
        ) from error
    if columns.ndim != 2 or columns.shape[1] != 3:
        raise InvalidArgument(
            f"`at` has shape {columns.shape}, not (m, 3): rows of x, y, alpha",
            details={"field": "at"},
        )
    return [{"x": x, "y": y, "alpha": alpha} for x, y, alpha in columns.tolist()]


def whole(what: str, number: SupportsIndex) -> int:
    """Returns `number` as an int, whatever kind of whole number it is.

    Raises:
        InvalidArgument: It is none.
    """
    try:
        return operator.index(number)
    except TypeError as error:
        raise InvalidArgument(
            f"{what} is {number!r}, but must be a whole number", details={"field": what}
        ) from error


def whole_from_0(what: str, number: SupportsIndex) -> int:
    """Returns `number` as an int, if it is whole and not below 0.

    Raises:
        InvalidArgument: It is not.
    """
    if whole(what, number) < 0:
        raise InvalidArgument(
            f"{what} is {number}, but must not be below 0", details={"field": what}
        )
    return whole(what, number)


def check_name(what: str, name: str) -> str:
    """Returns `name` if it may name a swarm or a node.

    A name becomes part of a key, where `*` or `/` would mean other swarms.

    Raises:
        InvalidArgument: It may not.
    """
    if not isinstance(name, str) or _NAME.fullmatch(name) is None:
        raise InvalidArgument(
            f"{name!r} cannot name a {what}: names match ^[a-z0-9][a-z0-9_-]{{0,63}}$",
            details={"field": what},
        )
    return name


def check_label(what: str, label: str) -> str:
    """Returns `label` if a request may bear it.

    Raises:
        InvalidArgument: It is no text, empty, or longer than 256 bytes.
    """
    if not isinstance(label, str) or not 0 < len(label.encode()) <= _MAX_LABEL_BYTES:
        raise InvalidArgument(
            f"{what} is {str(label)[:40]!r}, but must be a text of 1 to {_MAX_LABEL_BYTES} bytes",
            details={"field": what},
        )
    return label


def check_seconds(what: str, seconds: float) -> float:
    """Returns `seconds` if one can wait that long.

    Raises:
        InvalidArgument: They are not finite, or not above 0.
    """
    # Lock-step comes by here thousands of times a second, and a protocol is slow to look at: last.
    is_number = isinstance(seconds, float | int | SupportsFloat)
    if not is_number or not 0.0 < float(seconds) < math.inf:
        raise InvalidArgument(
            f"{what} is {seconds!r}, but must be finite seconds above 0", details={"field": what}
        )
    return float(seconds)


def to_json(message: Mapping[str, Any]) -> bytes:
    """Writes a request.

    JSON has no NaN and no infinity, and what would be sent instead means something else, so they
    are refused here.

    Raises:
        InvalidArgument: A number is not finite, or something is not a number, text or column.
    """
    try:
        return json.dumps(message, allow_nan=False, default=_plain).encode()
    except (TypeError, ValueError, RecursionError) as error:
        field = _find_not_finite(message)
        if field is not None:
            raise InvalidArgument(
                f"{field} is not a finite number", details={"field": field}
            ) from error
        raise InvalidArgument(f"the arguments cannot be sent: {error}") from error


def _plain(value: object) -> object:
    """What JSON can say of a struct, a NumPy scalar or a NumPy array."""
    if isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value, enc_hook=_plain)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, SupportsIndex):
        return operator.index(value)
    raise TypeError(f"{value!r} is no number, text, column or struct of jostle's")


def _find_not_finite(value: object, path: str = "", depth: int = 0) -> str | None:
    """The first number that is not finite, as a path such as `select.within.x`."""
    if depth > _DEEPEST:
        return None
    if isinstance(value, msgspec.Struct | np.ndarray | np.generic):
        value = _plain(value)
    if isinstance(value, float) and not math.isfinite(value):
        return path
    parts: Iterable[tuple[str, object]] = ()
    if isinstance(value, Mapping):
        # The arguments are what the caller sees, not the envelope they are in.
        parts = (
            (f"{path}.{key}" if path else ("" if key == "args" else str(key)), part)
            for key, part in value.items()
        )
    elif isinstance(value, list | tuple):
        parts = ((f"{path}[{index}]", part) for index, part in enumerate(value))
    for part_path, part in parts:
        found = _find_not_finite(part, part_path, depth + 1)
        if found is not None:
            return found
    return None
