"""Every argument of calls that connect is sent to the daemon or on its command line."""

from __future__ import annotations

import asyncio
import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import jostle
import rows_of_connections as table
from conftest import find_free_endpoint
from jostle import aio, env
from recorder import TOKEN, Recorder, Sent, credentials, fake_jostled
from rows import Arguments, File, Row, parameters

FORMS = pytest.mark.parametrize("form", ["blocking", "awaited"])


@pytest.fixture(scope="module")
def unknown() -> Iterator[Recorder]:
    """A recorder without authentication."""
    recorder = Recorder(find_free_endpoint())
    yield recorder
    recorder.close()


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorder]:
    """A recorder that requires credentials."""
    recorder = Recorder(find_free_endpoint(), tmp_path_factory.mktemp("known") / "passwords")
    yield recorder
    recorder.close()


@pytest.fixture(autouse=True)
def _nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("JOSTLE_ENDPOINT", "JOSTLE_CREDENTIALS", "JOSTLED"):
        monkeypatch.delenv(name, raising=False)


def _filled(taken: Arguments, folder: Path, stands: dict[str, Any]) -> Arguments:
    def fill(value: Any) -> Any:
        if isinstance(value, table.Stand):
            return stands[value.name]
        return value.make(folder) if isinstance(value, File) else value

    kwargs = {name: fill(it) for name, it in taken.kwargs.items()}
    return Arguments(tuple(map(fill, taken.args)), kwargs)


def _pause(form: str, call: str, taken: Arguments) -> None:
    """Connects and pauses a swarm."""
    if form == "blocking":
        with getattr(jostle, call)(*taken.args, **taken.kwargs) as client:
            client.swarm("school").pause()
        return

    async def main() -> None:
        async with getattr(aio, call)(*taken.args, **taken.kwargs) as client:
            await client.swarm("school").pause()

    asyncio.run(main())


@FORMS
@pytest.mark.parametrize("row", parameters(table.CONNECTS))
def test_connecting_sends_what_its_row_contains(
    row: Row, form: str, known: Recorder, unknown: Recorder, tmp_path: Path
) -> None:
    recorder = known if row.sent[0].attachment == TOKEN else unknown
    recorder.clear()
    stands = {"endpoint": recorder.endpoint, "credentials": credentials(tmp_path / "ada")}
    _pause(form, row.call, _filled(row.arguments, tmp_path, stands))
    assert recorder.sent() == row.sent


@FORMS
def test_environment_variables_set_endpoint_and_credentials(
    form: str,
    known: Recorder,
    unknown: Recorder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain, proven = table.CONNECTS[0].sent, table.CONNECTS[-1].sent
    for recorder in (known, unknown):
        recorder.clear()
    monkeypatch.setenv("JOSTLE_ENDPOINT", unknown.endpoint)
    _pause(form, "connect", Arguments((), {}))
    assert unknown.sent() == plain
    monkeypatch.setenv("JOSTLE_ENDPOINT", known.endpoint)
    monkeypatch.setenv("JOSTLE_CREDENTIALS", str(credentials(tmp_path / "ada")))
    _pause(form, "connect", Arguments((), {}))
    assert known.sent() == proven
    # Arguments precede the environment, and that precedes the credentials.
    monkeypatch.setenv("JOSTLE_ENDPOINT", "tcp/127.0.0.1:1")
    _pause(form, "connect", Arguments((known.endpoint,), {}))
    monkeypatch.delenv("JOSTLE_ENDPOINT")
    there = credentials(tmp_path / "there", known.endpoint)
    _pause(form, "connect", Arguments((), {"credentials": there}))
    assert known.sent() == 3 * proven


def _arguments(folder: Path) -> Sent:
    line = (folder / "arguments").read_text(encoding="utf-8").splitlines()
    data = Path(line[4])
    line[4] = data.name if data.parent == folder.resolve() else "(temporary)"
    return Sent("jostled", line, None)


@FORMS
@pytest.mark.parametrize("row", parameters(table.LOCALS))
def test_a_local_daemon_is_started_with_the_arguments_of_its_row(
    row: Row, form: str, unknown: Recorder, tmp_path: Path
) -> None:
    unknown.clear()
    stands = {"program": fake_jostled(tmp_path, unknown.endpoint)}
    _pause(form, row.call, _filled(row.arguments, tmp_path, stands))
    assert [_arguments(tmp_path), *unknown.sent()] == row.sent


@FORMS
def test_a_local_daemon_shows_that_it_starts_if_it_is_requested(
    form: str, unknown: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = fake_jostled(tmp_path, unknown.endpoint)
    for show in (True, False):
        _pause(form, "local", Arguments((), {"jostled": program, "show": show}))
        assert bool(capsys.readouterr().err) == show


@FORMS
@pytest.mark.parametrize("row", parameters(table.EXPERIMENTS))
def test_an_experiment_is_submitted_as_its_row_contains(
    row: Row, form: str, unknown: Recorder, tmp_path: Path
) -> None:
    stands = {"endpoint": unknown.endpoint}
    settings: dict[str, Any] = {"client": "ada@lab", "timeout": 7.5}
    if form == "blocking":
        with jostle.connect(unknown.endpoint, **settings) as client:
            unknown.clear()
            taken = _filled(row.arguments, tmp_path, {**stands, "client": client})
            jostle.experiment(*taken.args, **taken.kwargs)
    else:

        async def main() -> None:
            async with aio.connect(unknown.endpoint, **settings) as client:
                unknown.clear()
                taken = _filled(row.arguments, tmp_path, {**stands, "client": client})
                await aio.experiment(*taken.args, **taken.kwargs)

        asyncio.run(main())
    assert unknown.sent() == row.sent


def _without_name(sent: Sent) -> Sent:
    """The message without the swarm name that an environment generates."""
    own = re.compile(r"env-[0-9a-f]{32}")
    body = sent.body
    if body is not None and own.fullmatch(str(body["args"].get("name"))):
        body = {**body, "args": {**body["args"], "name": "env-(fresh)"}}
    return dataclasses.replace(sent, selector=own.sub("env-(fresh)", sent.selector), body=body)


@pytest.mark.parametrize("name", table.ENVS)
def test_an_environment_sends_what_its_rows_contain(
    name: str, unknown: Recorder, tmp_path: Path
) -> None:
    unknown.clear()
    unknown.controller = "env"
    made, *calls = table.ENVS[name]
    taken = _filled(made.arguments, tmp_path, {"endpoint": unknown.endpoint})
    world = getattr(env, name)(*taken.args, **taken.kwargs)
    for row in calls:
        getattr(world, row.call.split(".")[2])(*row.arguments.args, **row.arguments.kwargs)
    expected = [sent for row in table.ENVS[name] for sent in row.sent]
    assert [_without_name(it) for it in unknown.sent()] == expected
