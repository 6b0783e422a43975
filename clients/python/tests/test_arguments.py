"""Every argument of every call is sent: the messages are compared with literal tables.

The client and the connection are real; a `Recorder` stands in for the daemon. Each row is called
blocking and awaited. `test_arguments_complete.py` checks that no argument is without a row.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jostle
import rows_of_clients
import rows_of_swarms
from arguments import ENVELOPE, SHOWN, TAKEN, VALUES
from conftest import MAX_WAIT_SECS, find_free_endpoint
from jostle import aio
from jostle._arguments import to_json
from recorder import Recorder, Sent, credentials, fixture
from rows import CLIENT, TIMEOUT_SECS, Arguments, File, Row, cmd, parameters

ROWS = [*rows_of_swarms.ROWS, *rows_of_clients.ROWS]
FIRST = {row.call: row for row in reversed(ROWS)}
"""The first row of each call."""

Perform = Callable[[Row, Path], object]


class Clients:
    """A recorder, and a client of either kind that is connected to it."""

    def __init__(self, folder: Path, is_known: bool) -> None:
        passwords = folder / "passwords" if is_known else None
        self.recorder = Recorder(find_free_endpoint(), passwords, has_claims=True)
        proof = credentials(folder / "credentials") if is_known else None
        settings: dict[str, Any] = {
            "client": CLIENT,
            "timeout": TIMEOUT_SECS,
            "credentials": proof,
        }
        self.blocking = jostle.connect(self.recorder.endpoint, **settings)

        async def connect() -> aio.Client:
            return await aio.connect(self.recorder.endpoint, **settings)

        self.awaited = asyncio.run(connect())
        # Before its first command a client asks for the data of the daemon.
        self.blocking.swarm("school").pause()
        asyncio.run(self.awaited.swarm("school").pause())

    def close(self) -> None:
        """Closes all of them."""
        self.blocking.close()
        asyncio.run(self.awaited.close())
        self.recorder.close()

    def perform(self, form: str, row: Row, folder: Path) -> list[Sent]:
        """Makes the call of the row, and returns what was sent."""
        self.recorder.clear()
        taken = Arguments(
            tuple(_made(it, folder) for it in row.arguments.args),
            {name: _made(it, folder) for name, it in row.arguments.kwargs.items()},
        )
        if form == "blocking":
            self._call(row, taken)
        else:
            asyncio.run(self._await(row, taken))
        return self.recorder.sent(1)

    def _call(self, row: Row, taken: Arguments) -> None:
        owner, method = row.call.split(".")
        target: Any = self.blocking
        if owner == "Experiment":
            target = self.blocking.experiment("small")
        elif owner != "Client":
            target = self.blocking.swarm("school")
        if owner == "Controller":
            target = target.join(row.name, jostle.ids([1, 2]), **_mode(method), **row.joined)
            self.recorder.clear()
        result = _bound(target, method, taken)(*taken.args, **taken.kwargs)
        if isinstance(result, jostle.Stream):
            result.close()

    async def _await(self, row: Row, taken: Arguments) -> None:
        owner, method = row.call.split(".")
        target: Any = self.awaited
        if owner == "Experiment":
            target = self.awaited.experiment("small")
        elif owner != "Client":
            target = self.awaited.swarm("school")
        if owner == "Controller":
            target = await target.join(row.name, jostle.ids([1, 2]), **_mode(method), **row.joined)
            self.recorder.clear()
        result = await _bound(target, method, taken)(*taken.args, **taken.kwargs)
        if isinstance(result, aio.Stream):
            await result.close()


def _mode(method: str) -> dict[str, Any]:
    """The mode in which a controller must join for a method; the default, or that of `put`."""
    return {"mode": "free_running"} if method == "put" else {}


def _bound(target: Any, method: str, taken: Arguments) -> Any:
    """The method; with `at_step`, which is taken out, that of the swarm at this step."""
    step = taken.kwargs.pop("at_step", None)
    return getattr(target if step is None else target.at(step), method)


def _made(value: Any, folder: Path) -> Any:
    return value.make(folder) if isinstance(value, File) else value


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Clients]:
    """Clients with credentials."""
    clients = Clients(tmp_path_factory.mktemp("known"), is_known=True)
    yield clients
    clients.close()


@pytest.fixture(scope="module")
def unknown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Clients]:
    """Clients without."""
    clients = Clients(tmp_path_factory.mktemp("unknown"), is_known=False)
    yield clients
    clients.close()


@pytest.mark.parametrize("form", ["blocking", "awaited"])
@pytest.mark.parametrize("row", parameters(ROWS))
def test_each_call_sends_what_its_row_contains(
    row: Row, form: str, known: Clients, tmp_path: Path
) -> None:
    assert known.perform(form, row, tmp_path) == row.sent


def _options() -> Iterator[Any]:
    for call, names in TAKEN.items():
        cases: dict[str, dict[str, Any]] = {"all": {name: ENVELOPE[name][0] for name in names}}
        for name in names:
            cases |= {f"{name}={value}": {name: value} for value in ENVELOPE[name]}
        for case, options in cases.items():
            yield pytest.param(call, options, id=f"{call}-{case}")


@pytest.mark.parametrize("form", ["blocking", "awaited"])
@pytest.mark.parametrize(("call", "options"), list(_options()))
def test_each_call_sends_the_options_that_it_takes(
    call: str, options: dict[str, Any], form: str, known: Clients, tmp_path: Path
) -> None:
    first = FIRST[call]
    taken = Arguments(first.arguments.args, {**first.arguments.kwargs, **options})
    added = {"timeout_secs" if it == "timeout" else it: value for it, value in options.items()}
    (sent,) = first.sent
    expected = Sent(sent.selector, {**sent.body, **added}, sent.attachment)
    row = Row(call, taken, [expected])
    assert known.perform(form, row, tmp_path) == row.sent


def _without_one() -> Iterator[Any]:
    """Each row without each of its optional arguments."""
    for index, row in enumerate(ROWS):
        owner, method = row.call.split(".")
        signature = inspect.signature(getattr(getattr(jostle, owner), method))
        bound = signature.bind(None, *row.arguments.args, **row.arguments.kwargs)
        given = {**bound.arguments, **bound.arguments.get("options", {})}
        given = {it: value for it, value in given.items() if it not in ("self", "options")}
        for name, value in given.items():
            parameter = signature.parameters.get(name)
            default = None if parameter is None else parameter.default
            if default is inspect.Parameter.empty or _is_same(value, default):
                continue
            rest = {it: value for it, value in given.items() if it != name}
            yield pytest.param(row, Arguments((), rest), id=f"{row.call}-{index}-{name}")


def _is_same(one: Any, other: Any) -> bool:
    return one is other or (type(one) is type(other) and bool(np.all(one == other)))


@pytest.mark.parametrize(("row", "rest"), list(_without_one()))
def test_an_argument_left_out_changes_what_is_sent(
    row: Row, rest: Arguments, known: Clients, tmp_path: Path
) -> None:
    # So no row can match a client that drops an argument.
    changed = Row(row.call, rest, [], row.joined, row.name)
    try:
        sent = known.perform("blocking", changed, tmp_path)
    except (jostle.InvalidArgument, TypeError):
        return
    assert sent != row.sent


@pytest.mark.parametrize("form", ["blocking", "awaited"])
@pytest.mark.parametrize(
    "call",
    [
        "Swarm.status",
        "Swarm.pause",
        "Swarm.join",
        "Controller.put",
        "Client.create",
        "Client.hello",
    ],
)
def test_a_client_without_credentials_sends_no_proof(
    call: str, form: str, unknown: Clients, tmp_path: Path
) -> None:
    row = FIRST[call]
    anonymous = [Sent(it.selector, it.body, None) for it in row.sent]
    assert unknown.perform(form, row, tmp_path) == anonymous


def test_a_command_sent_again_is_the_same_but_for_its_timeout(known: Clients) -> None:
    recorder = known.recorder
    recorder.clear()
    recorder.is_mute = lambda key: key.endswith("/cmd/pause")
    options: dict[str, Any] = {"at_step": 41, "expect_step": 40, "expect_epoch": 3}
    with ThreadPoolExecutor(1) as pool:
        try:
            pause = known.blocking.swarm("school").at(41).pause
            reply = pool.submit(pause, expect_step=40, expect_epoch=3, timeout=3600)
            assert recorder.holds(2)
            # The held queries end at their timeout; the next request gets a reply.
            recorder.is_mute = lambda key: False
            reply.result(MAX_WAIT_SECS)
        finally:
            recorder.release()
    # A client without a reply sends more requests than that.
    first = recorder.sent(1)[0]
    assert first == cmd("pause", {}, **options, timeout_secs=3600.0)
    assert recorder.repeats != []
    for repeat in recorder.repeats:
        assert 0 < repeat.body["timeout_secs"] < 3600
        body = {**repeat.body, "timeout_secs": 3600.0}
        assert Sent(repeat.selector, body, repeat.attachment) == first


@pytest.mark.parametrize("form", ["blocking", "awaited"])
@pytest.mark.parametrize("call", SHOWN)
def test_a_bar_is_shown_if_it_is_requested(
    call: str, form: str, known: Clients, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for show in (True, False):
        folder = tmp_path / str(show)
        folder.mkdir()
        taken = Arguments(SHOWN[call].args, {**SHOWN[call].kwargs, "show": show})
        # A waiting call shows a bar once the daemon has replied that it takes longer.
        known.recorder.late = [{**fixture("error.deadline_exceeded"), "step": 45}]
        known.perform(form, Row(call, taken, []), folder)
        known.recorder.late = []
        assert bool(capsys.readouterr().err) == show


@pytest.mark.parametrize(("call", "taken", "value"), VALUES)
def test_each_helper_returns_what_is_sent(call: str, taken: Arguments, value: Any) -> None:
    made = getattr(jostle, call)(*taken.args, **taken.kwargs)
    assert to_json({"args": made}) == to_json({"args": value})
