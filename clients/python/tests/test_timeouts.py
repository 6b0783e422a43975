"""Every `timeout` has effect: a call to a daemon that never replies ends then."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import find_free_endpoint
from jostle import aio
from recorder import Recorder, fake_jostled
from timeouts import ENDED

TIMEOUT_SECS = 0.4
# How long a client waits beyond the timeout, as its documentation states.
GRACE_SECS = 2.0
# On a busy machine a thread may wake this much later.
TOLERANCE_SECS = 20.0
# Without a timeout of the call, that of the client applies, or a longer one.
CLIENT_SECS = 10 * TOLERANCE_SECS

Outcome = tuple[type[jostle.JostleError] | None, float]


@pytest.fixture
def silent() -> Iterator[Recorder]:
    """A recorder that can be made to reply to nothing."""
    recorder = Recorder(find_free_endpoint())
    yield recorder
    recorder.close()


def _check(outcomes: dict[str, Outcome]) -> None:
    assert outcomes.keys() == ENDED.keys()
    wrong = []
    for call, (error, seconds) in outcomes.items():
        ended = ENDED[call]
        most = ended.exchanges * (TIMEOUT_SECS + GRACE_SECS) + TOLERANCE_SECS
        if error is not ended.error or not TIMEOUT_SECS <= seconds <= most:
            wrong.append(f"{call} ended with {error} after {seconds:.1f} s")
    assert wrong == []


def _time(work: Callable[[], object]) -> Outcome:
    began = time.monotonic()
    try:
        work()
    except jostle.JostleError as error:
        return type(error), time.monotonic() - began
    return None, time.monotonic() - began


def _prepare(client: jostle.Client, call: str) -> Callable[[], object]:
    """Executes the preparation of the call, and returns the call."""
    owner, method = call.split(".")
    target: Any = client
    if owner == "Experiment":
        target = client.experiment("small")
    elif owner != "Client":
        target = client.swarm("school")
    if owner == "Controller":
        target = target.join(method)
    args, kwargs = (
        ENDED[call].arguments.args,
        {**ENDED[call].arguments.kwargs, "timeout": TIMEOUT_SECS},
    )
    if call in ("Swarm.states", "Swarm.orders", "Swarm.events"):
        stream = getattr(target, method)(*args, **kwargs)
        if method == "states":
            next(stream)
        return lambda: next(stream)
    return lambda: getattr(target, method)(*args, **kwargs)


def test_each_timeout_ends_a_call(silent: Recorder, tmp_path: Path) -> None:
    program = fake_jostled(tmp_path, silent.endpoint)
    with jostle.connect(silent.endpoint, timeout=CLIENT_SECS) as client:
        calls = {call: _prepare(client, call) for call in ENDED if "." in call}
        calls["connect"] = lambda: jostle.connect(silent.endpoint, timeout=TIMEOUT_SECS)
        calls["local"] = lambda: jostle.local(jostled=program, timeout=TIMEOUT_SECS)
        silent.is_mute = lambda key: True
        with ThreadPoolExecutor(len(calls)) as pool:
            began = {call: pool.submit(_time, work) for call, work in calls.items()}
            try:
                deadline = time.monotonic() + 2 * TOLERANCE_SECS
                outcomes = {call: _ended(work, deadline) for call, work in began.items()}
            finally:
                silent.release()
    _check(outcomes)


def _ended(work: Future[Outcome], deadline: float) -> Outcome:
    """The outcome of a call; one that is not over at the deadline has no error."""
    try:
        return work.result(max(0.0, deadline - time.monotonic()))
    except TimeoutError:
        return None, float("inf")


async def _time_awaited(work: Callable[[], Awaitable[object]]) -> Outcome:
    began = time.monotonic()
    try:
        await asyncio.wait_for(_awaitable(work), 2 * TOLERANCE_SECS)
    except jostle.JostleError as error:
        return type(error), time.monotonic() - began
    except TimeoutError:
        return None, float("inf")
    return None, time.monotonic() - began


async def _awaitable(work: Callable[[], Awaitable[object]]) -> object:
    return await work()


async def _prepare_awaited(client: aio.Client, call: str) -> Callable[[], Awaitable[object]]:
    owner, method = call.split(".")
    target: Any = client
    if owner == "Experiment":
        target = client.experiment("small")
    elif owner != "Client":
        target = client.swarm("school")
    if owner == "Controller":
        target = await target.join(method)
    args, kwargs = (
        ENDED[call].arguments.args,
        {**ENDED[call].arguments.kwargs, "timeout": TIMEOUT_SECS},
    )
    if call in ("Swarm.states", "Swarm.orders", "Swarm.events"):
        stream: aio.Stream[Any] = await getattr(target, method)(*args, **kwargs)
        if method == "states":
            await anext(stream)
        return lambda: anext(stream)
    return lambda: getattr(target, method)(*args, **kwargs)


def test_each_timeout_ends_an_awaited_call(silent: Recorder, tmp_path: Path) -> None:
    program = fake_jostled(tmp_path, silent.endpoint)

    async def main() -> dict[str, Outcome]:
        async with aio.connect(silent.endpoint, timeout=CLIENT_SECS) as client:
            calls = {call: await _prepare_awaited(client, call) for call in ENDED if "." in call}
            calls["connect"] = lambda: aio.connect(silent.endpoint, timeout=TIMEOUT_SECS)
            calls["local"] = lambda: aio.local(jostled=program, timeout=TIMEOUT_SECS)
            silent.is_mute = lambda key: True
            try:
                outcomes = await asyncio.gather(*map(_time_awaited, calls.values()))
            finally:
                silent.release()
            return dict(zip(calls, outcomes, strict=True))

    _check(asyncio.run(main()))


@pytest.mark.parametrize("form", ["blocking", "awaited"])
def test_a_wait_for_an_experiment_that_goes_on_ends(form: str, silent: Recorder) -> None:
    silent.phase = "running"
    with jostle.connect(silent.endpoint) as client:
        experiment = client.experiment("small")
        if form == "blocking":
            error, seconds = _time(lambda: experiment.wait(TIMEOUT_SECS))
        else:
            error, seconds = asyncio.run(
                _time_awaited(lambda: aio.Experiment(experiment).wait(TIMEOUT_SECS))
            )
    assert error is jostle.DeadlineExceeded
    assert TIMEOUT_SECS <= seconds < TOLERANCE_SECS


@pytest.mark.parametrize("form", ["blocking", "awaited"])
@pytest.mark.parametrize("stream", ["states", "orders", "events"])
def test_the_timeout_of_the_client_ends_the_opening_of_a_stream(
    stream: str, form: str, silent: Recorder
) -> None:
    # The timeout of the stream only limits the wait for an item.
    with (
        jostle.connect(silent.endpoint, timeout=TIMEOUT_SECS) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        silent.is_mute = lambda key: True
        swarm = client.swarm("school")
        target: Any = swarm if form == "blocking" else aio.Swarm(swarm)

        def open_() -> Any:
            return getattr(target, stream)(timeout=CLIENT_SECS)

        try:
            if form == "blocking":
                work = pool.submit(_time, open_)
                error, seconds = _ended(work, time.monotonic() + 2 * TOLERANCE_SECS)
            else:
                error, seconds = asyncio.run(_time_awaited(open_))
        finally:
            silent.release()
    assert error is jostle.Unavailable
    assert TIMEOUT_SECS + GRACE_SECS <= seconds < TIMEOUT_SECS + GRACE_SECS + TOLERANCE_SECS
