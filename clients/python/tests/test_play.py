"""Runs of experiments as swarms, and swarms as the files of experiments."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon
from jostle import aio

TURN = """name = "turn"
seed = 4
replicates = 2
duration = 4
[spec]
n = 12
dt = 0.05
[[grid]]
share = [0.2, 0.5]
[[at]]
time = 0.5
inform = { select = { fraction = "$share" }, direction = 1 }
[[at]]
from = 1
until = 3
every = 0.5
set = { noise = { ramp = [0, 0.4] } }
[[at]]
time = 2
inject = { count = 3, direction = 2 }
"""
STEPS = 80


@pytest.fixture
def hashes(client: jostle.Client) -> dict[str, str]:
    """The hash of the last state of each run, by its name."""
    experiment = client.submit(TURN).wait(MAX_WAIT_SECS)
    rows = {row.run: row.state_hash for row in experiment.rows()}
    experiment.delete()
    return rows


def test_a_played_run_has_the_hash_of_the_run(
    client: jostle.Client, hashes: dict[str, str], tmp_path: Path
) -> None:
    file = tmp_path / "turn.toml"
    file.write_text(TURN)
    names = list(hashes)
    for run, expected in [(None, names[0]), (3, names[2]), (names[3], names[3])]:
        swarm = client.play(file, run, name="live")
        assert swarm.status().scheduled == 7
        swarm.step(STEPS)
        assert swarm.status().state_hash == hashes[expected]
        swarm.delete()
    swarm = client.play(TURN, 2)
    assert swarm.name == "turn"
    with pytest.raises(jostle.AlreadyExists):
        client.play(TURN, 2)
    assert swarm.status().scheduled == 7
    swarm.delete()


def test_a_run_is_played_from_asyncio(daemon: Daemon, hashes: dict[str, str]) -> None:
    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            swarm = await client.play(TURN, run=2, name="live")
            await swarm.step(STEPS)
            assert (await swarm.status()).state_hash == list(hashes.values())[1]
            await swarm.delete()

    asyncio.run(main())


@pytest.mark.parametrize("killed_before", [0, 1, 4])
def test_the_same_call_continues_after_a_kill(tmp_path: Path, killed_before: int) -> None:
    daemon = Daemon(tmp_path)
    endpoint = daemon.endpoint
    sent = 0
    with jostle.connect(endpoint, timeout=0.5) as client:
        rows = client.submit(TURN).wait(MAX_WAIT_SECS).rows()
        command = client._session.command

        def kill_before(key: str, *args: Any, **kwargs: Any) -> bytes:
            nonlocal sent
            if key.endswith("/cmd/batch"):
                if sent == killed_before:
                    daemon.kill()
                sent += 1
            return command(key, *args, **kwargs)

        client._session.command = kill_before  # type: ignore[method-assign]
        with pytest.raises((jostle.Unavailable, jostle.DeadlineExceeded)) as caught:
            client.play(TURN, run=4, name="live", request_id="play")
        assert any("same request_id" in note for note in caught.value.__notes__)
        assert sent == killed_before + 1
    daemon = Daemon(tmp_path, listen=endpoint)
    with jostle.connect(endpoint) as client:
        for _ in range(2):
            swarm = client.play(TURN, run=4, name="live", request_id="play")
            assert swarm.status().scheduled == 7
        swarm.step(STEPS)
        assert swarm.status().state_hash == rows[3].state_hash
    assert daemon.stop() == 0


def test_a_played_run_with_conditions_has_the_hash_of_the_run(client: jostle.Client) -> None:
    source = (
        TURN
        + """[[at]]
when = "order > 0.02 for 0.4"
inject = { count = 2 }
[stop]
when = "nematic >= 0 for 3.5"
"""
    )
    experiment = client.submit(source).wait(MAX_WAIT_SECS)
    row = experiment.rows()[1]
    experiment.delete()
    swarm = client.play(source, 2, name="live")
    assert len(swarm.status().when or []) == 2
    with pytest.raises(jostle.IncorrectState, match="condition"):
        swarm.run(until_step=STEPS, rate=None, wait=True)
    status = swarm.status()
    assert 0 < status.step < STEPS
    assert status.state_hash == row.state_hash
    swarm.delete()


def test_a_played_run_from_a_snapshot_has_the_hash_of_the_run(
    client: jostle.Client, tmp_path: Path
) -> None:
    grown = client.create("grown", {"n": 12, "dt": 0.05, "seed": 9})
    grown.step(30)
    grown.snapshot().save(tmp_path / "grown.snapshot")
    file = tmp_path / "turn.toml"
    file.write_text('start = "grown.snapshot"\n' + TURN)
    experiment = client.submit(file).wait(MAX_WAIT_SECS)
    rows = experiment.rows()
    experiment.delete()
    assert len({row.state_hash for row in rows}) == len(rows)
    for number, row in enumerate(rows, start=1):
        swarm = client.play(file, number, name="live")
        assert swarm.status().step == 0
        swarm.step(STEPS)
        assert swarm.status().state_hash == row.state_hash
        swarm.delete()
    grown.delete()


@pytest.mark.parametrize(
    ("source", "run", "message"),
    [
        (TURN, 5, "there is no run"),
        (TURN, 0, "there is no run"),
        (TURN, "share=9 #0", "there is no run"),
        (TURN, -1, "there is no run"),
        (TURN + '[stop]\nwhen = "order > 0"\n', 1, "holds at step 0"),
        (TURN.replace("time = 2", "time = nan"), 1, "line 19, column 8"),
        ("name = 1\n", 1, "line 1"),
    ],
)
def test_a_run_that_cannot_be_played_is_rejected(
    client: jostle.Client, source: str, run: Any, message: str
) -> None:
    with pytest.raises(jostle.InvalidArgument, match=message):
        client.play(source, run, name="live")
    assert "live" not in [it.swarm for it in client.swarms()]


def test_a_run_that_is_no_number_is_rejected(client: jostle.Client) -> None:
    with pytest.raises(jostle.InvalidArgument, match="run"):
        client.play(TURN, math.nan)  # type: ignore[arg-type]


def test_more_commands_than_can_be_scheduled_leave_no_swarm(client: jostle.Client) -> None:
    many = TURN.replace("every = 0.5", "every = 0.05").replace("duration = 4", "duration = 100")
    many = many.replace("until = 3", "until = 90")
    with pytest.raises(jostle.ResourceExhausted, match="larger `every`"):
        client.play(many, name="live")
    assert "live" not in [it.swarm for it in client.swarms()]


def test_more_conditions_than_can_wait_leave_no_swarm(client: jostle.Client) -> None:
    when = '[[at]]\nwhen = "order > 0.9999"\nset = { pi2 = 1 }\n'
    with pytest.raises(jostle.ResourceExhausted) as caught:
        client.play(TURN + 17 * when, name="live")
    assert any("was not scheduled" in note for note in caught.value.__notes__)
    assert "live" not in [it.swarm for it in client.swarms()]
    swarm = client.play(TURN + 16 * when, name="live")
    assert len(swarm.status().when or []) == 16
    swarm.delete()


def test_the_file_of_a_steered_swarm_has_a_run_with_its_hash(
    client: jostle.Client, tmp_path: Path
) -> None:
    swarm = client.create("led", jostle.Spec(n=12, seed=5, dt=0.05))
    with swarm.join("pilot", jostle.ids([0, 4]), on_timeout="free") as pilot:
        for k in range(6):
            pilot.advance(3, direction=0.1 * k, weight=2.0)
        swarm.set(pi2=0.75)
        pilot.advance(5, direction=[-1.0, 2.5])
    swarm.step(4)
    expected = swarm.status().state_hash
    path = tmp_path / "found.toml"
    assert swarm.as_experiment(path) == path.read_text()
    csv = tmp_path / "found.setpoints.csv"
    assert csv.read_text().startswith("step,id,direction,weight\n0,0,0,2\n0,4,0,2\n3,0,0.1,2\n")
    for source in (path, swarm.as_experiment()):
        experiment = client.submit(source, name="again").wait(MAX_WAIT_SECS)
        assert [row.state_hash for row in experiment.rows()] == [expected]
        experiment.delete()
    with pytest.raises(jostle.InvalidArgument, match="setpoints"):
        client.play(path)
    # Other set-points are another experiment, and errors name their line.
    experiment = client.submit(path, name="again").wait(MAX_WAIT_SECS)
    csv.write_text(csv.read_text().replace("3,0,0.1,2", "3,0,0.2,2"))
    with pytest.raises(jostle.AlreadyExists):
        client.submit(path, name="again")
    csv.write_text(csv.read_text().replace("3,0,0.2,2", "3,0,nan,2"))
    with pytest.raises(jostle.InvalidArgument, match=r"found\.setpoints\.csv, line 4, column 3"):
        client.submit(path, name="other")
    csv.unlink()
    with pytest.raises(FileNotFoundError):
        client.submit(path, name="other")
    experiment.delete()
    # Runs with other seeds.
    experiment = client.submit(swarm.as_experiment(replicates=3)).wait(MAX_WAIT_SECS)
    rows = experiment.rows()
    assert len({row.state_hash for row in rows} - {expected}) == 3
    experiment.delete()
    for wrong in (0, -1, 100_001):
        with pytest.raises(jostle.InvalidArgument, match="replicates"):
            swarm.as_experiment(replicates=wrong)
    with pytest.raises(jostle.InvalidArgument, match="setpoints"):
        swarm.as_experiment(tmp_path / "a b.toml")
    swarm.delete()
