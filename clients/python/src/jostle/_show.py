"""What notebooks show of things: tables as HTML. Whatever came from elsewhere is escaped."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")

_ROWS_AT_AN_END = 12
_LONGEST_LIST = 100
_LONGEST_TEXT = 120
_CELL = 'style="text-align:left;vertical-align:top;white-space:nowrap"'


class Shown(msgspec.Struct, frozen=True, kw_only=True):
    """A message that a notebook shows as a table of its fields."""

    def _repr_html_(self) -> str:
        return facts(type(self).__name__, _fields(self))


class Listed(list[T]):
    """A list that a notebook shows as a table, with a row for each."""

    def _repr_html_(self) -> str:
        if not self:
            return "<p>none</p>"
        left_out = max(0, len(self) - 2 * _ROWS_AT_AN_END)
        first = len(self) if not left_out else _ROWS_AT_AN_END
        rows = [_fields(item) for item in self[:first] + self[first + left_out :]]
        every = dict.fromkeys(name for row in rows for name in row)
        names = [name for name in every if any(_says(row.get(name)) for row in rows)]
        cells = [[row.get(name) for name in names] for row in rows]
        if left_out:
            cells.insert(first, [f"… {left_out} more …"] + [None] * (len(names) - 1))
        return table(names, cells)


def facts(title: str, fields: Mapping[str, Any]) -> str:
    """A table of names and what each is, without those of which nothing is said."""
    rows = "".join(
        f"<tr><th {_CELL}>{_text(name)}</th><td {_CELL}>{_cell(value)}</td></tr>"
        for name, value in fields.items()
        if _says(value)
    )
    return f"<table><caption {_CELL}><b>{_text(title)}</b></caption>{rows}</table>"


def table(names: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table with a heading for each column."""
    head = "".join(f"<th {_CELL}>{_text(name)}</th>" for name in names)
    body = "".join(
        f"<tr>{''.join(f'<td {_CELL}>{_cell(value)}</td>' for value in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def bar(share: float | None, text: str) -> str:
    """A bar that is full to `share`, or of which nothing is known, with a text under it."""
    full = "" if share is None else f' value="{min(max(share, 0.0), 1.0):.4f}"'
    return (
        '<div style="max-width:520px;font:12px system-ui,sans-serif">'
        f'<progress style="width:100%" max="1"{full}></progress><div>{_text(text)}</div></div>'
    )


def trouble(error: Exception) -> str:
    """What is shown in place of something that cannot be asked."""
    return f"<p><b>{_text(type(error).__name__)}</b>: {_text(str(error))}</p>"


def _fields(item: object) -> dict[str, Any]:
    if not isinstance(item, msgspec.Struct):
        return {"": item}
    # A time as people read it.
    shown = {"unix_secs": "when"} if hasattr(item, "when") else {}
    names = [shown.get(name, name) for name in item.__struct_fields__]
    fields = {name: getattr(item, name) for name in names}
    # That nothing is missing goes without saying.
    if not fields.get("skipped"):
        fields.pop("skipped", None)
    return fields


def _says(value: object) -> bool:
    return value is not None and value != [] and value != {}


def _cell(value: object) -> str:
    if isinstance(value, msgspec.Struct):
        told = ((name, it) for name, it in _fields(value).items() if _says(it))
        return "<br>".join(f"{_text(name)}: {_cell(it)}" for name, it in told)
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.0f}" if 1e5 <= abs(value) < 1e15 else f"{value:.5g}"
    if isinstance(value, bool | int | str):
        return _text(str(value))
    if isinstance(value, datetime):
        return value.strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + "Z"
    if isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
        return Listed(value)._repr_html_()
    if isinstance(value, list | tuple) and not any(isinstance(it, list | dict) for it in value):
        return ", ".join(_cell(it) for it in value[:_LONGEST_LIST]) + (
            ", …" if len(value) > _LONGEST_LIST else ""
        )
    return f"<code>{_text(json.dumps(msgspec.to_builtins(value), ensure_ascii=False))}</code>"


def _text(text: str) -> str:
    """A text as HTML; a very long one is cut."""
    return html.escape(text if len(text) <= _LONGEST_TEXT else text[:_LONGEST_TEXT] + " …")
