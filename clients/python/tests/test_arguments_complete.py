"""The tables of arguments are complete, for the package and for the contract."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import contract
import jostle
import rows_of_clients
import rows_of_connections
import rows_of_swarms
from arguments import (
    ENVELOPE,
    NO_REQUEST,
    NOT_AROUND,
    NOT_OFFERED,
    NOT_SENT,
    SHOWN,
    TAKEN,
    VALUES,
)
from jostle import aio, env
from jostle._options import Options
from rows import Row
from timeouts import ENDED

SCHEMAS = contract.schemas()
ROWS: list[Row] = [
    *rows_of_swarms.ROWS,
    *rows_of_clients.ROWS,
    *rows_of_connections.ROWS,
]


def _is_own(thing: object) -> bool:
    module = str(getattr(thing, "__module__", None))
    return inspect.isroutine(thing) and module.partition(".")[0] == "jostle"


def _members(name: str, kind: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    inherited = {
        id(member)
        for base in kind.__mro__[1:]
        if base.__name__ in jostle.__all__
        for _, member in inspect.getmembers(base)
    }
    for member, thing in inspect.getmembers(kind, _is_own):
        if not member.startswith("_") and id(thing) not in inherited:
            yield f"{name}.{member}", thing


def public_calls() -> dict[str, Callable[..., Any]]:
    """Every function, method and environment that a user may call, by its name in the tables."""
    calls: dict[str, Callable[..., Any]] = {}
    for module, start in ((jostle, ""), (env, "env.")):
        for name in module.__all__:
            thing = getattr(module, name)
            if thing is jostle.AtStep:
                # Its calls are those of `Swarm` with the option `at_step`.
                continue
            if isinstance(thing, type):
                calls |= _members(f"{start}{name}", thing)
                if module is env:
                    calls[f"{start}{name}"] = thing
            elif inspect.isfunction(thing):
                calls[name] = thing
    return calls


def awaited_calls() -> dict[str, Callable[..., Any]]:
    """The same for `jostle.aio`."""
    calls: dict[str, Callable[..., Any]] = {}
    for name in aio.__all__:
        thing = getattr(aio, name)
        # An opening has the methods of a coroutine, which the event loop calls.
        if thing in (aio.AtStep, aio.Opening):
            continue
        if isinstance(thing, type):
            calls |= {
                f"{name}.{member}": it
                for member, it in vars(thing).items()
                if not member.startswith("_") and inspect.isfunction(it)
            }
        else:
            calls[name] = thing
    return calls


def parameters(call: Callable[..., Any]) -> dict[str, Any]:
    """Its arguments, and the default of each."""
    found: dict[str, Any] = {}
    for name, parameter in inspect.signature(call).parameters.items():
        if name == "options" and parameter.kind is parameter.VAR_KEYWORD:
            found |= dict.fromkeys(Options.__annotations__)
        elif name != "self":
            found[name] = parameter.default
    return found


def given(row: Row, call: Callable[..., Any]) -> set[str]:
    """The arguments of a row that differ from their defaults."""
    signature = inspect.signature(call)
    subject = [None] if "self" in signature.parameters else []
    arguments = signature.bind(*subject, *row.arguments.args, **row.arguments.kwargs).arguments
    defaults = parameters(call)
    found = {*arguments.pop("options", {})}
    for name, value in arguments.items():
        # A selection or an array is never a default.
        is_plain = isinstance(value, str | int | float | None)
        if name in defaults and not (is_plain and value == defaults[name]):
            found.add(name)
    return found


CALLS = public_calls()


def takes(name: str) -> dict[str, Any]:
    """What a call takes, also `at_step` if `Swarm.at` has it."""
    owner, _, method = name.rpartition(".")
    has_step = owner == "Swarm" and hasattr(jostle.AtStep, method)
    return parameters(CALLS[name]) | ({"at_step": None} if has_step else {})


def _covered() -> set[tuple[str, str]]:
    covered = {(row.call, name) for row in ROWS for name in given(row, CALLS[row.call])}
    covered |= {(call, name) for call, names in TAKEN.items() for name in names}
    covered |= {(call, "show") for call in SHOWN}
    for call, taken, _ in VALUES:
        signature = inspect.signature(CALLS[call])
        bound = signature.bind(*taken.args, **taken.kwargs)
        covered |= {(call, name) for name in bound.arguments}
    return covered


def test_every_argument_of_every_call_has_a_row_or_a_reason() -> None:
    every = {(name, it) for name in CALLS for it in takes(name)}
    covered = _covered()
    assert every - covered == NOT_SENT.keys(), "no row of rows_of_*.py has it"
    assert covered - every == set()


def test_every_call_has_a_row_or_a_reason() -> None:
    called = {row.call for row in ROWS} | {call for call, *_ in VALUES}
    without = {name for name, call in CALLS.items() if not parameters(call)}
    assert without - called == NO_REQUEST.keys()


def test_every_awaited_call_is_one_of_the_tables() -> None:
    awaited = awaited_calls()
    assert awaited.keys() <= CALLS.keys()
    for name, call in awaited.items():
        assert parameters(call).keys() == parameters(CALLS[name]).keys(), name


def test_the_options_of_commands_are_the_ones_of_the_tables() -> None:
    assert ENVELOPE.keys() == {*Options.__annotations__, "at_step"}
    for name in CALLS:
        if name not in rows_of_connections.CALLS:
            # A timeout that is not sent is in another table.
            taken = {it for it in takes(name) if it in ENVELOPE and (name, it) not in NOT_SENT}
            assert taken - {"timeout"} == {*TAKEN.get(name, ())} - {"timeout"}, name


@pytest.mark.parametrize("form", [jostle, aio])
def test_a_command_at_a_step_takes_what_it_takes_of_the_swarm(form: Any) -> None:
    methods = {name for name in vars(form.AtStep) if not name.startswith("_")}
    assert methods == {name[6:] for name, names in TAKEN.items() if "at_step" in names}
    for method in methods:
        both = [parameters(getattr(it, method)) for it in (form.AtStep, form.Swarm)]
        # A run that begins later cannot be waited for.
        assert both[0] == {k: v for k, v in both[1].items() if k not in ("wait", "show")}, method


def test_every_timeout_has_a_row_of_its_own() -> None:
    timed = {name for name, call in CALLS.items() if "timeout" in parameters(call)}
    assert timed - {"View.wait"} == ENDED.keys()


# The fields of a schema, and of a message, as paths such as `.select.within.x` and `.mode=free`.


def _paths(
    schema: dict[str, Any], definitions: dict[str, Any], at: str = ""
) -> Iterator[tuple[str, Any]]:
    """Every path of a schema, with the default there."""
    if "$ref" in schema:
        schema = {**definitions[schema["$ref"].removeprefix("#/$defs/")], **schema}
    if "const" in schema:
        yield f"{at}={schema['const']}", None
    for variant in (*schema.get("oneOf", ()), *schema.get("anyOf", ())):
        yield from _paths(variant, definitions, at)
    for name, field in schema.get("properties", {}).items():
        yield f"{at}.{name}", field.get("default")
        yield from _paths(field, definitions, f"{at}.{name}")
    if isinstance(schema.get("items"), dict):
        yield from _paths(schema["items"], definitions, f"{at}[]")


def _found(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Every path of a message, with the value there."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield f"{at}.{name}", part
            yield from _found(part, f"{at}.{name}")
    elif isinstance(value, list):
        for part in value:
            yield from _found(part, f"{at}[]")
    elif isinstance(value, str):
        yield f"{at}={value}", value


def _sent(verb: str) -> list[Any]:
    """The arguments of a verb in every row."""
    bodies = [it.body for row in ROWS for it in row.sent if _verb(it.selector) == verb]
    return bodies if verb == "control" else [body["args"] for body in bodies]


def _verb(selector: Any) -> str | None:
    *_, kind, last = ["", *str(selector).split("/")]
    return {"cmd": last, "ctl": "control"}.get(kind)


VERBS = sorted(name.removesuffix(".args") for name in SCHEMAS if name.endswith(".args"))


@pytest.mark.parametrize("verb", VERBS)
def test_every_argument_of_the_contract_has_a_row_or_a_reason(verb: str) -> None:
    schema = SCHEMAS[f"{verb}.args"]
    rows = [path for args in _sent(verb) for path in _found(args)]
    assert _sent(verb) != []
    missing = set()
    for path, default in _paths(schema, schema.get("$defs", {})):
        values = [value for at, value in rows if at == path]
        if all(default is not None and value == default for value in values):
            missing.add(path)
    assert missing == {path for of, path in NOT_OFFERED if of == verb}


def test_the_envelope_of_the_contract_is_offered_with_every_command_or_has_a_reason() -> None:
    fields = {"timeout_secs": "timeout"}
    envelope = {fields.get(it, it) for it in SCHEMAS["request"]["properties"]} - {"args"}
    missing = {
        (call, name) for call, taken in TAKEN.items() for name in envelope if name not in taken
    }
    assert missing == NOT_AROUND.keys()
    # The calls without options of their own send a command under the client's timeout.
    commands = {row.call for row in ROWS for it in row.sent if "/cmd/" in str(it.selector)}
    assert commands - TAKEN.keys() == rows_of_connections.WITHOUT_OPTIONS.keys()
