"""The times of a published state, and the set-points in it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import mcap.reader
import numpy as np
import pandas as pd
import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually
from jostle import aio
from jostle._attachment import Arrival
from jostle._state import FrameReader
from test_recording import begin

Create = Callable[..., jostle.Swarm]


def check_times(state: jostle.State, began: datetime) -> None:
    """A state of a step since `began` that was published and received since."""
    stepped, published = state.stepped_at, state.published_at
    assert stepped is not None
    assert published is not None
    assert began <= stepped <= published <= datetime.now(UTC)
    assert state.received_unix_nanos is not None
    assert state.latency is not None
    assert 0 <= state.latency < MAX_WAIT_SECS
    received = published + timedelta(seconds=state.latency)
    assert received <= datetime.now(UTC) + timedelta(microseconds=1)


def check_unknown(state: jostle.State) -> None:
    """A state to which nothing is attached."""
    assert (state.stepped_at, state.published_at, state.latency) == (None, None, None)
    assert (state.attachment, state.received_unix_nanos) == (None, None)
    assert dict(state.sequences) == {}


def test_a_published_state_has_its_times(create: Create) -> None:
    swarm = create(n=3, rate=1, publish_every=1)
    check_unknown(swarm.state())
    # Datetimes have microseconds.
    began = datetime.now(UTC) - timedelta(microseconds=1)
    check_unknown(swarm.step(state=True))
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        check_unknown(next(states))
        swarm.run(until_step=20)
        for state in states:
            check_times(state, began)
            if state.step == 20:
                break
        swarm.reset()
        after = next(state for state in states if state.step == 0)
    assert (after.stepped_at, dict(after.sequences)) == (None, {})
    assert after.published_at is not None
    assert after.latency is not None


def test_the_time_in_the_queue_does_not_count(create: Create) -> None:
    swarm = create(n=3, publish_every=1)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        next(states)

        def was_received_before_it_was_read() -> bool:
            swarm.step()
            swarm.status()
            read = time.time_ns()
            received = next(states).received_unix_nanos
            return received is not None and received < read

        eventually("a state waits in the queue", was_received_before_it_was_read)


def test_a_published_state_has_its_times_in_asyncio(daemon: Daemon) -> None:
    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            spec = jostle.Spec(n=3, rate=1, publish_every=1)
            async with await client.create("awaited", spec) as swarm:
                began = datetime.now(UTC) - timedelta(microseconds=1)
                async with swarm.states(timeout=MAX_WAIT_SECS) as states:
                    check_unknown(await anext(states))
                    await swarm.run(until_step=5)
                    async for state in states:
                        # That of step 0 may be published late.
                        if state.step > 0:
                            check_times(state, began)
                        if state.step == 5:
                            break
                await swarm.delete()

    asyncio.run(main())


def test_a_state_has_the_number_of_the_set_points_in_it(create: Create) -> None:
    swarm = create(n=4, rate=2, publish_every=1)
    with (
        swarm.join("ada", jostle.ids([1]), mode="free_running", deadline=60.0) as ada,
        swarm.states(timeout=MAX_WAIT_SECS) as states,
    ):
        swarm.run()
        numbers = []
        for weight in (2.0, 3.0):
            sent = time.time_ns()
            number = ada.put(direction=0.5, weight=weight)
            numbers.append(number)
            for state in states:
                if state.sequences.get("ada") == number:
                    break
                assert state.weight[1] != weight
            assert (state.weight[1], dict(state.sequences)) == (weight, {"ada": number})
            assert state.received_unix_nanos is not None
            # The latency from a set-point to the state with it.
            assert 0 < state.received_unix_nanos - sent < MAX_WAIT_SECS * 1e9
        assert numbers[0] < numbers[1]
        swarm.pause()


def test_an_older_daemon_attaches_nothing(create: Create) -> None:
    present = create(n=3).state()
    reader = FrameReader(lambda _: replace(present, frame=present.frame + 1), lambda: present)
    (first,) = reader.first()
    check_unknown(first)
    (read,) = reader.read(b"", Arrival(7, None))
    assert (read.stepped_at, read.published_at, read.latency) == (None, None, None)
    assert (read.received_unix_nanos, dict(read.sequences)) == (7, {})


def test_a_table_has_the_times(create: Create) -> None:
    swarm = create(n=3, publish_every=1)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        present = next(states)
        swarm.step()
        stepped = next(state for state in states if state.step == 1)
    table = jostle.frame([present, stepped])
    times = table[["stepped_unix_secs", "published_unix_secs"]]
    assert (times.dtypes == np.float64).all()
    assert times[table.step == 0].isna().all(axis=None)
    assert stepped.stepped_at is not None
    assert stepped.published_at is not None
    expected = [stepped.stepped_at.timestamp(), stepped.published_at.timestamp()]
    assert np.abs(times[table.step == 1] - expected).max(axis=None) < 2e-6


def recorded(daemon: Daemon, swarm: jostle.Swarm, path: Path, *options: str) -> jostle.Recording:
    """A recording of a swarm that runs."""
    recorder = begin(daemon, swarm, path, *options, "--steps", "10")
    swarm.run()
    recorder.communicate(timeout=MAX_WAIT_SECS)
    assert recorder.returncode == 0
    swarm.pause()
    return jostle.read_recording(path)


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_a_recording_of_published_states_has_both_times(
    daemon: Daemon, create: Create, tmp_path: Path, suffix: str
) -> None:
    swarm = create(n=3, rate=1, publish_every=1)
    began = time.time()
    swarm.step()
    path = tmp_path / f"take.{suffix}"
    recording = recorded(daemon, swarm, path, "--published")
    table = recording.frame()
    # The first one is queried.
    published = table[table.published_unix_secs.notna()]
    assert published.step.nunique() > 3
    assert (published.stepped_unix_secs <= published.published_unix_secs).all()
    assert (published.stepped_unix_secs > began - 1e-6).all()
    assert (published.published_unix_secs < time.time()).all()
    steps = published.groupby("step").stepped_unix_secs
    assert (steps.nunique() == 1).all()
    assert steps.first().is_monotonic_increasing
    frames = list(recording)
    assert (frames[0].stepped_unix_secs, frames[0].published_unix_secs) == (None, None)
    assert frames[-1].stepped_unix_secs == published.stepped_unix_secs.iloc[-1]
    if suffix == "parquet":
        read = pd.read_parquet(path)
        columns = ["stepped_unix_secs", "published_unix_secs"]
        pd.testing.assert_frame_equal(read[columns], table[columns], check_exact=True)
        return
    with path.open("rb") as file:
        messages = mcap.reader.make_reader(file).iter_messages(topics=["state"])
        times = {it.sequence: it.publish_time for _, _, it in messages}
    for frame in frames[1:]:
        assert frame.published_unix_secs == times[frame.frame] / 1e9


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_a_recording_by_the_daemon_has_the_times_of_its_steps(
    daemon: Daemon, create: Create, tmp_path: Path, suffix: str
) -> None:
    swarm = create(n=3, rate=1, publish_every=1)
    began = time.time()
    table = recorded(daemon, swarm, tmp_path / f"take.{suffix}").frame()
    assert table.step.nunique() == 11
    assert table.published_unix_secs.isna().all()
    assert table.stepped_unix_secs[table.step == 0].isna().all()
    stepped = table.stepped_unix_secs[table.step > 0]
    assert ((stepped > began - 1e-6) & (stepped < time.time())).all()
    assert stepped.is_monotonic_increasing
