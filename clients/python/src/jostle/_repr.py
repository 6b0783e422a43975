"""How notebooks display messages: tables as HTML. All text from a daemon is escaped."""

from __future__ import annotations

import functools
import html
import json
from datetime import datetime
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")

# Rows at the beginning and at the end of a long list.
_END_ROWS = 12
_MAX_LIST = 100
_MAX_TEXT = 120
_CELL = 'style="text-align:left;vertical-align:top;white-space:nowrap"'


class HtmlStruct(msgspec.Struct, frozen=True, kw_only=True):
    """A message that a notebook displays as a table of its fields."""

    def _repr_html_(self) -> str:
        title = _text(type(self).__name__)
        rows = "".join(
            f"<tr><th {_CELL}>{_text(name)}</th><td {_CELL}>{_cell(value)}</td></tr>"
            for name, value in _fields(self).items()
            if _has_value(value)
        )
        return f"<table><caption {_CELL}><b>{title}</b></caption>{rows}</table>"

    def __reduce__(self) -> tuple[object, ...]:
        # Without fields that are not set: picklers search all modules for the name of `UNSET`.
        given = {name: getattr(self, name) for name in self.__struct_fields__}
        given = {name: value for name, value in given.items() if value is not msgspec.UNSET}
        return functools.partial(type(self), **given), ()


class HtmlList(list[T]):
    """A list that a notebook displays as a table with a row for each item."""

    def _repr_html_(self) -> str:
        if not self:
            return "<p>none</p>"
        omitted = max(0, len(self) - 2 * _END_ROWS)
        first = len(self) if not omitted else _END_ROWS
        rows = [_fields(item) for item in self[:first] + self[first + omitted :]]
        every = dict.fromkeys(name for row in rows for name in row)
        names = [name for name in every if any(_has_value(row.get(name)) for row in rows)]
        cells = [[row.get(name) for name in names] for row in rows]
        if omitted:
            cells.insert(first, [f"… {omitted} more …"] + [None] * (len(names) - 1))
        head = "".join(f"<th {_CELL}>{_text(name)}</th>" for name in names)
        lines = ("".join(f"<td {_CELL}>{_cell(value)}</td>" for value in row) for row in cells)
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def bar_html(share: float | None, text: str) -> str:
    """A progress bar with a text below; `share` is 0 to 1, None is unknown."""
    full = "" if share is None else f' value="{min(max(share, 0.0), 1.0):.4f}"'
    return (
        '<div style="max-width:520px;font:12px system-ui,sans-serif">'
        f'<progress style="width:100%" max="1"{full}></progress><div>{_text(text)}</div></div>'
    )


def error_html(error: Exception) -> str:
    """An error, in place of what could not be queried."""
    return f"<p><b>{_text(type(error).__name__)}</b>: {_text(str(error))}</p>"


def _fields(item: object) -> dict[str, Any]:
    if not isinstance(item, msgspec.Struct):
        return {"": item}
    # The time as a date.
    renamed = {"unix_secs": "when"} if hasattr(item, "when") else {}
    names = [renamed.get(name, name) for name in item.__struct_fields__]
    fields = {name: getattr(item, name) for name in names}
    if not fields.get("skipped"):
        fields.pop("skipped", None)
    return fields


def _has_value(value: object) -> bool:
    return value not in (None, msgspec.UNSET, [], {})


def _cell(value: object) -> str:
    if isinstance(value, msgspec.Struct):
        fields = ((name, it) for name, it in _fields(value).items() if _has_value(it))
        return "<br>".join(f"{_text(name)}: {_cell(it)}" for name, it in fields)
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.0f}" if 1e5 <= abs(value) < 1e15 else f"{value:z.5g}"
    if isinstance(value, bool | int | str):
        return _text(str(value))
    if isinstance(value, datetime):
        return value.strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + "Z"
    if isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
        return HtmlList(value)._repr_html_()
    if isinstance(value, list | tuple) and not any(isinstance(it, list | dict) for it in value):
        return ", ".join(_cell(it) for it in value[:_MAX_LIST]) + (
            ", …" if len(value) > _MAX_LIST else ""
        )
    return f"<code>{_text(json.dumps(msgspec.to_builtins(value), ensure_ascii=False))}</code>"


def _text(text: str) -> str:
    """A text as HTML, truncated if it is very long."""
    return html.escape(text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + " …")
