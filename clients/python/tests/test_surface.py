"""The public interface, against a checked listing: removing a line breaks users.

With `JOSTLE_RECORD` set the test writes the listing, `tests/surface.txt`, instead.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import typing
from collections.abc import Iterator
from pathlib import Path

import msgspec

import jostle
from jostle import aio, env

LISTING = Path(__file__).with_name("surface.txt")
COMMAND = "JOSTLE_RECORD=1 target/venv/bin/python -m pytest clients/python/tests/test_surface.py"
"""The command that writes it."""


def describe(name: str, thing: object) -> Iterator[str]:
    """One line for each public name, with its signature."""
    if inspect.isfunction(thing):
        yield f"{_def(thing)} {name}{inspect.signature(thing)}"
    elif isinstance(thing, type):
        bases = ", ".join(base.__name__ for base in thing.__bases__ if base is not object)
        yield f"class {name}({bases})"
        if issubclass(thing, msgspec.Struct):
            for field in msgspec.structs.fields(thing):
                yield f"    {field.name}{'' if field.required else ' = …'}"
        elif dataclasses.is_dataclass(thing):
            for column in dataclasses.fields(thing):
                yield f"    {column.name}: {column.type}"
        elif typing.is_typeddict(thing):
            for key, annotation in thing.__annotations__.items():
                yield f"    {key}: {getattr(annotation, '__forward_arg__', annotation)}"
        members = dict(vars(thing))
        for base in thing.__mro__:
            # Members inherited from a private class of the package count as its own.
            if base.__module__.startswith("jostle.") and base.__name__ not in jostle.__all__:
                members = {**vars(base), **members}
        for member, value in sorted(members.items()):
            if member.startswith("_"):
                continue
            if isinstance(value, property):
                yield f"    {member} (property)"
            elif inspect.isfunction(value):
                yield f"    {_def(value)} {member}{inspect.signature(value)}"
    else:
        yield f"{name}: {thing}"


def _def(function: object) -> str:
    return "async def" if inspect.iscoroutinefunction(function) else "def"


def listing() -> str:
    """Everything in `__all__`, in its order, then `jostle.aio` and `jostle.env`."""
    lines = [line for name in jostle.__all__ for line in describe(name, getattr(jostle, name))]
    for name in aio.__all__:
        lines += describe(f"aio.{name}", getattr(aio, name))
    for name in env.__all__:
        kind, *members = describe(f"env.{name}", getattr(env, name))
        lines += [kind, f"    {inspect.signature(getattr(env, name))}", *members]
    return "\n".join(lines) + "\n"


def test_the_public_surface_is_the_one_listed() -> None:
    if "JOSTLE_RECORD" in os.environ:
        LISTING.write_text(listing(), encoding="utf-8")
    assert listing() == LISTING.read_text(encoding="utf-8"), f"`{COMMAND}` writes {LISTING}"


def test_all_is_sorted_and_complete() -> None:
    assert list(jostle.__all__) == sorted(jostle.__all__)
    assert list(aio.__all__) == sorted(aio.__all__)
    assert list(env.__all__) == sorted(env.__all__)
    public = {
        name
        for name, thing in vars(jostle).items()
        if not name.startswith("_") and not inspect.ismodule(thing)
    }
    assert public == set(jostle.__all__)


def test_every_error_is_in_one_tree() -> None:
    errors = [
        thing
        for thing in map(jostle.__dict__.get, jostle.__all__)
        if isinstance(thing, type) and issubclass(thing, jostle.JostleError)
    ]
    assert len(errors) == 15
    assert all(error in errors or not issubclass(error, Exception) for error in _classes())
    assert len({error.code for error in errors}) == len(errors)


def _classes() -> list[type]:
    return [thing for thing in vars(jostle).values() if isinstance(thing, type)]
