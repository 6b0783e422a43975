"""Arguments of callers: names, selections and starts, and their encoding as JSON.

Numbers and columns of numbers may be NumPy's.
"""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, SupportsFloat, SupportsIndex, TypedDict

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import InvalidArgument, invalid
from ._spec import Disc, Given

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_MAX_LABEL_BYTES = 256
# No request nests deeper; a list that contains itself would recurse without end.
_MAX_DEPTH = 16


# They separate measures, and parameters of a request.
_SEPARATORS = ",;&=?#"


class Ids(TypedDict):
    """Individuals by id."""

    ids: Sequence[int]


class Count(TypedDict):
    """A number of individuals, drawn by the daemon."""

    count: int


class Fraction(TypedDict):
    """A fraction of the individuals, 0 to 1, drawn by the daemon; rounded to a whole number."""

    fraction: float


class Region(TypedDict):
    """A disc: absolute centre and radius, body sizes."""

    x: float
    y: float
    radius: float


class Pose(TypedDict):
    """Absolute position, body sizes, and heading, radians from +x."""

    x: float
    y: float
    alpha: float


class Within(TypedDict):
    """All individuals whose centre is in a disc."""

    within: Region


class Informed(TypedDict):
    """All individuals with a direction of their own, or all without one."""

    informed: bool


class AlongCount(TypedDict):
    """A number of individuals, and a direction in radians, counter-clockwise from +x."""

    count: int
    along: float


class Foremost(TypedDict):
    """The individuals furthest along a direction."""

    foremost: AlongCount


Select = Ids | Count | Fraction | Within | Informed | Foremost
"""Selects individuals: a dictionary of one of these shapes. `ids`, `count`, … make them."""


def ids(individuals: Iterable[SupportsIndex]) -> Ids:
    """Selects individuals by id.

        swarm.inform(jostle.ids(state.id[state.x > 0]), direction=0.0)

    Args:
        individuals: The ids, shape (m,).

    Raises:
        InvalidArgument: One of them is not a whole number, or they are a boolean mask.
    """
    return {"ids": id_list("select.ids", individuals)}


def count(individuals: SupportsIndex) -> Count:
    """Selects a number of individuals, which the daemon draws from the swarm's seed.

        swarm.remove(jostle.count(3))

    Raises:
        InvalidArgument: It is not a whole number.
    """
    return {"count": whole("select.count", individuals)}


def fraction(share: float) -> Fraction:
    """Selects a fraction of the individuals, 0 to 1, which the daemon draws from the swarm's seed.

    swarm.inform(jostle.fraction(0.1), direction=0.0)
    """
    return {"fraction": share}


def within(x: float, y: float, radius: float) -> Within:
    """Selects all individuals whose centre is in a disc.

        swarm.uninform(jostle.within(0.0, 0.0, radius=5.0))

    Args:
        x: Absolute position of the centre, body sizes.
        y: Absolute position of the centre, body sizes.
        radius: Radius, body sizes.
    """
    return {"within": {"x": x, "y": y, "radius": radius}}


def informed(is_informed: bool = True) -> Informed:
    """Selects all individuals with a direction of their own, or with `False` all without one.

    swarm.inform(jostle.informed(), direction=math.pi / 2)
    """
    return {"informed": is_informed}


def foremost(count: SupportsIndex, along: float) -> Foremost:
    """Selects the individuals furthest along a direction.

        swarm.inform(jostle.foremost(3, along=0.0), direction=math.pi / 2)

    Args:
        count: Number of individuals.
        along: The direction, radians, counter-clockwise from +x.

    Raises:
        InvalidArgument: `count` is not a whole number.
    """
    return {"foremost": {"count": whole("select.foremost.count", count), "along": along}}


def check_select(select: Select) -> Select:
    """Returns `select` if it is a mapping; the daemon checks the rest.

    Raises:
        InvalidArgument: It is not.
    """
    if not isinstance(select, Mapping):
        raise invalid(
            "select",
            f"select is {select!r}, but must be a selection such as jostle.count(3) or "
            "jostle.ids([1, 2])",
        )
    return select


def disc(radius: float | None = None) -> Disc:
    """A start: individuals drawn uniformly in a disc, without overlap.

        jostle.Spec(n=50, start=jostle.disc(10.0))

    Args:
        radius: Radius of the disc, body sizes; None is √n, at least 1.
    """
    return Disc(radius)


def given(x: ArrayLike, y: ArrayLike, alpha: ArrayLike) -> Given:
    """A start: every individual at an exact pose.

        jostle.Spec(n=2, start=jostle.given([0.0, 3.0], [0.0, 0.0], [0.0, math.pi]))

    Args:
        x: Absolute positions, shape (n,), body sizes.
        y: Absolute positions, shape (n,), body sizes.
        alpha: Headings, shape (n,), radians, counter-clockwise from +x.

    Raises:
        InvalidArgument: They are not columns of finite numbers of the same length.
    """
    columns: list[list[float]] = []
    for name, values in (("x", x), ("y", y), ("alpha", alpha)):
        field = f"spec.start.{name}"
        column = numbers(name, values, field)
        if column.ndim != 1:
            raise invalid(field, f"{name} has shape {column.shape}, not (n,)")
        if not np.isfinite(column).all():
            raise invalid(field, f"{name} holds a number that is not finite")
        columns.append(column.tolist())
    lengths = [len(column) for column in columns]
    if len(set(lengths)) != 1:
        raise invalid(
            "spec.start", f"x, y and alpha have lengths {lengths}, but must be of one length"
        )
    return Given(*columns)


def numbers(name: str, values: ArrayLike, field: str) -> NDArray[np.float64]:
    """An array of numbers.

    Raises:
        InvalidArgument: They are not numbers.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise invalid(field, f"{name} is not a column of numbers: {error}") from error


def poses(rows: ArrayLike) -> list[Pose]:
    """Poses of bodies, for `jostle.Inject(at=…)`.

        jostle.Inject(at=jostle.poses([[12.0, 0.0, math.pi]]))

    Args:
        rows: Rows of x, y, alpha, shape (m, 3), absolute positions in body sizes, headings in
            radians.

    Raises:
        InvalidArgument: They are of another shape, or not numbers.
    """
    columns = numbers("`at`", rows, "at")
    if columns.ndim != 2 or columns.shape[1] != 3:
        raise invalid("at", f"`at` has shape {columns.shape}, not (m, 3): rows of x, y, alpha")
    return [{"x": x, "y": y, "alpha": alpha} for x, y, alpha in columns.tolist()]


def id_list(what: str, individuals: Iterable[SupportsIndex]) -> list[int]:
    """Returns ids of any type as a list of int.

    Raises:
        InvalidArgument: One of them is not a whole number, or they are a boolean mask.
    """
    if not isinstance(individuals, Iterable):
        raise invalid(
            what, f"{what} is {individuals!r}, but must be several whole numbers, such as [1, 2]"
        )
    given = list(individuals)
    if any(isinstance(one, bool | np.bool_) for one in given):
        raise invalid(
            what,
            f"{what} is a boolean mask, but must be ids: use `state.id[mask]`, or, if no "
            "individual was removed, `np.flatnonzero(mask)`",
        )
    return [whole(what, one) for one in given]


def whole(what: str, number: SupportsIndex) -> int:
    """Returns a whole number of any type as an int.

    Raises:
        InvalidArgument: It is not a whole number; True and False are none.
    """
    if isinstance(number, bool):
        raise invalid(what, f"{what} is {number}, but must be a whole number")
    try:
        return operator.index(number)
    except TypeError as error:
        raise invalid(what, f"{what} is {number!r}, but must be a whole number") from error


def whole_or_none(what: str, number: SupportsIndex | None) -> int | None:
    """A whole number, if there is one."""
    return None if number is None else whole(what, number)


def whole_from_0(what: str, number: SupportsIndex) -> int:
    """Returns a whole number of any type as an int.

    Raises:
        InvalidArgument: It is not a whole number, or below 0.
    """
    value = whole(what, number)
    if value < 0:
        raise invalid(what, f"{what} is {number}, but must not be below 0")
    return value


def check_name(what: str, name: str) -> str:
    """Returns `name` if it is valid.

    A name becomes part of a key, where `*` or `/` would address other swarms.

    Raises:
        InvalidArgument: It is invalid.
    """
    if not isinstance(name, str) or _NAME.fullmatch(name) is None:
        raise invalid(
            what, f"{name!r} cannot name a {what}: names match ^[a-z0-9][a-z0-9_-]{{0,63}}$"
        )
    return name


def check_measure(name: str) -> str:
    """Returns `name` if a request may contain it as one measure; the daemon knows the measures.

    Raises:
        InvalidArgument: It is no text, or has a character that separates measures or parameters.
    """
    if not isinstance(name, str) or set(name) & set(_SEPARATORS):
        raise invalid(
            "names", f"{name!r} names no measure: give each name of its own, such as 'order'"
        )
    return name


def check_parameter(what: str, text: str) -> str:
    """Returns `text` if a query may have it as the value of a parameter.

    Raises:
        InvalidArgument: It is not a text of 1 to 256 bytes, or has a `;`, which separates
            parameters.
    """
    check_label(what, text)
    if ";" in text:
        raise invalid(
            what, f"{what} is {text[:40]!r}, and a `;` cannot be sent: search the result instead"
        )
    return text


def measure_names(names: Sequence[str]) -> list[str]:
    """The names of published measures as a list; the daemon knows the measures.

    Raises:
        InvalidArgument: It is a single text, or has something else than texts.
    """
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise invalid(
            "measures", f"{names!r} is no list of measures: give one such as ['drift', 'milling']"
        )
    return list(names)


def check_condition(condition: str) -> str:
    """Returns `condition` if a query may contain it; the daemon reads it.

    Raises:
        InvalidArgument: It is not a text, or has a `;`, which separates parameters.
    """
    if not isinstance(condition, str):
        raise invalid(
            "condition",
            f"condition is {condition!r}, but must be a text such as 'order > 0.9 for 20'",
        )
    if ";" in condition:
        raise invalid("condition", f"`condition` contains a `;`: {condition!r}")
    return condition


def check_label(what: str, label: str) -> str:
    """Returns `label` if a request may contain it.

    Raises:
        InvalidArgument: It is not a text of 1 to 256 bytes.
    """
    if not isinstance(label, str) or not 0 < len(label.encode()) <= _MAX_LABEL_BYTES:
        raise invalid(
            what,
            f"{what} is {str(label)[:40]!r}, but must be a text of 1 to {_MAX_LABEL_BYTES} bytes",
        )
    return label


def check_seconds(what: str, seconds: float) -> float:
    """Returns `seconds` as a float.

    Raises:
        InvalidArgument: They are not finite, or not above 0.
    """
    # Lock-step calls this thousands of times a second; `isinstance` of a protocol is slow, so it
    # comes last.
    is_number = isinstance(seconds, float | int | SupportsFloat)
    if not is_number or not 0.0 < float(seconds) < math.inf:
        raise invalid(what, f"{what} is {seconds!r}, but must be finite seconds above 0")
    return float(seconds)


def to_json(message: Mapping[str, Any]) -> bytes:
    """Encodes a request. JSON has no NaN and no infinity, so they are rejected.

    Raises:
        InvalidArgument: A number is not finite, or a value is not a number, text or column.
    """
    try:
        return json.dumps(message, allow_nan=False, default=_plain).encode()
    except (TypeError, ValueError, RecursionError) as error:
        field = _find_not_finite(message)
        if field is not None:
            raise invalid(field, f"{field} is not a finite number") from error
        raise InvalidArgument(f"the arguments cannot be sent: {error}") from error


def _plain(value: object) -> object:
    """A struct, a NumPy scalar or a NumPy array as a value of JSON."""
    if isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value, enc_hook=_plain)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, SupportsIndex):
        return operator.index(value)
    raise TypeError(f"{value!r} is not a number, a text, a column or a struct of jostle")


def _find_not_finite(value: object, path: str = "", depth: int = 0) -> str | None:
    """The first number that is not finite, as a path such as `select.within.x`."""
    if depth > _MAX_DEPTH:
        return None
    if isinstance(value, msgspec.Struct | np.ndarray | np.generic):
        value = _plain(value)
    if isinstance(value, float) and not math.isfinite(value):
        return path
    parts: Iterable[tuple[str, object]] = ()
    if isinstance(value, Mapping):
        # The caller knows the arguments, not the envelope around them.
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
