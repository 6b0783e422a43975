"""Swarms far from the origin: what reads positions says the same as at the origin."""

from __future__ import annotations

import asyncio
import csv
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ase.io
import numpy as np
import pytest
from numpy.typing import NDArray

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, Daemon, eventually
from jostle import aio
from jostle._draw import Camera
from jostle._state import draw_state
from jostle.env import ParallelEnv, ShepherdEnv
from test_notebook import bodies

Create = Callable[..., jostle.Swarm]
Floats = NDArray[np.float64]

# At whole origins, between them, and where a group leaves the origin it began with: half of 1,024.
PLACES = {
    "far": (1e4, -3e3),
    "whole": (-10 * 1024.0, 3 * 1024.0),
    "edge": (511.5, -512.25),
    "farther": (-9e5, 7e5),
}


@pytest.fixture(params=PLACES)
def place(request: pytest.FixtureRequest) -> Floats:
    """Where a group begins; `JOSTLE_SEED` draws another."""
    given = os.environ.get("JOSTLE_SEED")
    if given is not None:
        drawn = np.random.default_rng(int(given)).uniform(-1e5, 1e5, 2)
        return np.round(drawn * 64.0) / 64.0
    return np.array(PLACES[request.param])


def start(n: int, place: Floats | None = None, seed: int = 1) -> dict[str, Any]:
    """Poses without overlap. Numbers are multiples of 2⁻¹⁰, so that a sum with a place is exact."""
    random = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    grid = np.array([(i % side, i // side) for i in range(n)], float) * 1.75
    position = grid - 0.875 * side + random.integers(-60, 60, (n, 2)) / 1024.0
    x, y = (position + (0.0 if place is None else place)).T
    alpha = random.integers(-3000, 3000, n) / 1024.0
    return {"kind": "given", "x": x.tolist(), "y": y.tolist(), "alpha": alpha.tolist()}


def measured(swarm: jostle.Swarm) -> Floats:
    """All measures of a state; NaN where one is undefined."""
    values = swarm.measures()
    return np.array([np.nan if it is None else it for it in values.values()])


@pytest.mark.parametrize("kind", [ParallelEnv, ShepherdEnv])
def test_observations_and_rewards_are_those_at_the_origin(
    kind: type[ParallelEnv | ShepherdEnv], place: Floats, daemon: Daemon
) -> None:
    seen: list[list[Floats]] = []
    pictures: list[list[Floats]] = []
    for where in (None, place):
        env = kind(
            12,
            3,
            goal=0.4,
            steps_per_action=40,
            max_steps=6,
            endpoint=daemon.endpoint,
            render_mode="rgb_array",
            start=start(12, where),
        )
        observed, info = env.reset(seed=4)
        random = np.random.default_rng(7)
        numbers, shown = [], []
        for _ in range(6):
            numbers.append(numbers_of(observed))
            shown.append(np.asarray(env.render(), float))
            if isinstance(env, ParallelEnv):
                actions = {agent: random.uniform(-1, 1, 2) for agent in env.agents}
                observed, rewards, _, _, infos = env.step(actions)
                reward, info = next(iter(rewards.values())), next(iter(infos.values()))
            else:
                observed, reward, _, _, info = env.step(random.uniform(-1, 1, 4))
            numbers.append(np.array([reward, info["drift"], info["order"], info["time"]]))
        env.close()
        seen.append(numbers)
        pictures.append(shown)
    for one, other in zip(*seen, strict=True):
        assert other == pytest.approx(one, abs=2e-6)
    assert float(seen[0][-1][0]) != 0.0
    for one, other in zip(*pictures, strict=True):
        # A rim is in part of its pixel's colour.
        assert np.abs(one - other).max() <= 2.0


def numbers_of(observed: Any) -> Floats:
    """The numbers of all agents."""
    if isinstance(observed, dict):
        return np.concatenate([observed[agent] for agent in sorted(observed)]).astype(float)
    return np.asarray(observed, float)


def change(swarm: jostle.Swarm, place: Floats) -> list[Any]:
    """Commands with absolute places; returns whom they concern."""
    x, y = place
    ids = [
        swarm.inform(jostle.within(x - 2.5, y - 2.5, 2.0), direction=0.5).ids,
        swarm.inject(at=[[x + 9.0, y - 1.0, 2.5]], direction=0.5).ids,
        swarm.inject(3, within=(float(x) - 12.0, float(y), 2.0)).ids,
    ]
    swarm.step(60)
    ids.append(swarm.uninform(jostle.within(x + 9.0, y - 1.0, 3.0)).ids)
    ids.append(swarm.inform(jostle.foremost(2, along=1.0), direction=0.5).ids)
    ids.append(swarm.remove(jostle.within(x - 12.0, y, 1.25)).ids)
    swarm.step(60)
    return ids


def test_commands_states_measures_and_pictures_are_those_at_the_origin(
    place: Floats, create: Create
) -> None:
    nothing = np.zeros(2)
    swarms = [create(20, seed=3, start=start(20, it)) for it in (nothing, place)]
    informed, injected, *_ = whom = change(swarms[0], nothing)
    assert change(swarms[1], place) == whom
    assert (len(informed) > 0, len(injected)) == (True, 1)
    here, there = (swarm.state() for swarm in swarms)
    assert there.origin != here.origin
    assert np.array_equal(here.id, there.id)
    # Doubles are as coarse as this there.
    coarse = 1e-6 + 4.0 * float(np.spacing(np.abs(place).max()))
    assert there.position - place == pytest.approx(here.position, abs=coarse)
    assert there.alpha == pytest.approx(here.alpha, abs=1e-6)
    assert there.order.order == pytest.approx(here.order.order, abs=1e-7)
    assert there.order.drift == pytest.approx(here.order.drift, abs=1e-7)
    tables = [jostle.frame(it) for it in (here, there)]
    for axis, of in zip("xy", place, strict=True):
        assert (tables[1][axis] - of).to_numpy() == pytest.approx(
            tables[0][axis].to_numpy(), abs=coarse
        )
    assert measured(swarms[1]) == pytest.approx(measured(swarms[0]), abs=1e-6, nan_ok=True)
    for name in ("pair_correlation", "neighbour_density"):
        one, other = (swarm.histogram(name, bins=5, max=3.0)[1] for swarm in swarms)
        assert other == pytest.approx(one, rel=1e-5)
    pictures = [bodies(draw_state(it)) for it in (here, there)]
    assert len(pictures[0]) == 2 * here.n
    for (_, wide, ends), (_, also, others) in zip(*pictures, strict=True):
        assert also == pytest.approx(wide, abs=0.011)
        assert others == pytest.approx(ends, abs=0.11)


def test_a_camera_follows_a_group_that_walks_over_origins(create: Create) -> None:
    # The group walks 30 body sizes, from one origin to the next.
    swarm = create(10, start=start(10, np.array([500.0, 0.0])))
    swarm.inform(jostle.fraction(1.0), direction=0.0, weight=5.0)
    camera, origins, before = Camera(), set(), None
    for _ in range(30):
        state = swarm.step(50, state=True)
        origins.add(state.origin)
        shown = bodies(draw_state(state, camera))
        middle = np.mean([ends.mean(axis=0) for _, _, ends in shown], axis=0)
        assert np.abs(middle - (260.0, 180.0)).max() < 60.0
        centre = state.position.mean(axis=0)
        if before is not None:
            # 1 time unit, at most at the free speed.
            assert 0.3 < np.hypot(*(centre - before)) <= 1.0 + 1e-9
        before = centre
    assert len(origins) == 2


def test_rewards_are_the_drift_of_a_group_that_walks_over_origins(
    daemon: Daemon, client: jostle.Client
) -> None:
    rewards = {}
    for kind in (ParallelEnv, ShepherdEnv):
        env = kind(
            6,
            6,
            steps_per_action=50,
            max_steps=20,
            endpoint=daemon.endpoint,
            start=start(6, np.array([505.0, -3e3])),
        )
        env.reset(seed=2)
        (swarm,) = [client.swarm(it.swarm) for it in client.swarms() if it.swarm.startswith("env-")]
        origins, found = set(), []
        for _ in range(20):
            if isinstance(env, ParallelEnv):
                every = env.step({it: np.array([1.0, 0.0]) for it in env.agents})
                reward, drift = every[1]["informed_0"], every[4]["informed_0"]["drift"]
            else:
                _, reward, _, _, info = env.step(np.array([0.0, 0.0, 1.0, 0.0]))
                drift = info["drift"]
            found.append(float(reward))
            origins.add(swarm.state().origin)
            assert drift == pytest.approx(np.mean(found), abs=1e-9)
        env.close()
        assert len(origins) == 2
        assert (np.abs(found) <= 1.0 + 1e-9).all()
        rewards[kind] = found
    assert np.mean(rewards[ParallelEnv][-5:]) > 0.9


def test_recordings_and_their_copies_are_those_at_the_origin(
    place: Floats, client: jostle.Client, create: Create, tmp_path: Path
) -> None:
    frames, live = [], []
    for name, where in (("here", np.zeros(2)), ("there", place)):
        swarm = create(8, seed=6, start=start(8, where))
        begun = client.record(swarm.name, every=5, steps=100)
        states = [swarm.state()]
        states += [swarm.step(5, state=True) for _ in range(20)]
        live.append(states)
        eventually(
            "it has ended",
            lambda begun=begun: all(  # type: ignore[misc]
                it.phase != "recording"
                for it in client.recordings()
                if it.recording == begun.recording
            ),
        )
        folder = client.fetch_recording(begun.recording, tmp_path / name, show=False)
        recording = jostle.read_recording(folder)
        frames.append(list(recording))
        assert len(frames[-1]) == len(states)
        for frame, state in zip(frames[-1], states, strict=True):
            assert np.array_equal(frame.position, state.position)
        with recording.to_csv(tmp_path / f"{name}.csv").open(newline="") as file:
            rows = list(csv.reader(file))
        columns = dict(zip(rows[0], np.array(rows[1:]).T, strict=True))
        everyone = np.concatenate([it.position for it in states])
        assert np.array_equal(columns["x"].astype(float), everyone[:, 0])
        assert np.array_equal(columns["y"].astype(float), everyone[:, 1])
        atoms = ase.io.read(recording.to_extxyz(tmp_path / f"{name}.xyz"), ":", format="extxyz")
        assert np.array_equal(np.concatenate([it.positions[:, :2] for it in atoms]), everyone)
        # Played back: the same positions at the same steps.
        (part,) = folder.iterdir()
        with client.replay(part, name="played") as played:
            for state in (states[0], states[7], states[-1]):
                played.seek(step=state.step)
                again = played.state()
                assert (again.step, again.origin) == (state.step, state.origin)
                assert np.array_equal(again.position, state.position)
            played.delete()
        client.delete_recording(begun.recording)
    coarse = 1e-6 + 4.0 * float(np.spacing(np.abs(place).max()))
    for one, other in zip(*frames, strict=True):
        assert other.position - place == pytest.approx(one.position, abs=coarse)
        assert other.order == pytest.approx(one.order, abs=1e-7)


def test_a_group_that_is_created_again_goes_on_from_its_place(
    place: Floats, client: jostle.Client, create: Create
) -> None:
    swarm = create(9, seed=5, start=start(9, place))
    swarm.step(50)
    state = swarm.state()
    x, y = state.position.T
    again = create(9, seed=5, start=jostle.given(x, y, state.alpha))
    assert np.array_equal(again.state().position, state.position)
    assert again.step(state=True).origin == state.origin
    name = f"{swarm.name}-restored"
    restored = client.restore(swarm.snapshot(), name)
    forked = swarm.fork(f"{swarm.name}-forked")
    try:
        expected = swarm.step(30).state_hash
        assert restored.step(30).state_hash == expected
        assert forked.step(30).state_hash == expected
    finally:
        restored.delete()
        forked.delete()


COLUMNS = [
    *("order", "milling", "front", "spread", "radius_of_gyration", "neighbour_gap.median"),
    *("turning_rate", "speed.informed", "speed.others", "msd(0.5)", "contacts_per_body"),
]


def test_experiments_have_the_results_of_those_at_the_origin(
    place: Floats, daemon: Daemon, client: jostle.Client, jostled_named: None
) -> None:
    rows, paths, tables = [], [], []
    for name, where in (("here", np.zeros(2)), ("there", place)):
        x, y = (float(it) for it in where)
        experiment = client.submit(
            {
                "name": name,
                "seed": 2,
                "duration": 4,
                "spec": {"n": 9, "start": start(9, where)},
                "at": [
                    {
                        "step": 10,
                        "inform": {
                            "select": {"within": {"x": x - 1.0, "y": y - 1.0, "radius": 2.0}},
                            "direction": 0.25,
                        },
                        "inject": {"at": [{"x": x + 8.0, "y": y + 1.0, "alpha": 3.0}]},
                    },
                    {
                        "time": 2,
                        "uninform": {"select": {"within": {"x": x - 2.0, "y": y, "radius": 2.0}}},
                    },
                ],
                "measure": {"columns": COLUMNS, "series_every": 20, "record_every": 20},
            }
        ).wait(MAX_WAIT_SECS)
        (row,) = experiment.rows()
        assert row.fault is None
        rows.append([row.v, row.v_pd, *(it.value for it in row.extra or [])])
        tables.append(experiment.series())
        paths.append(experiment.trajectory(row.run))

        async def awaited(row: jostle.ResultRow = row, name: str = name) -> Any:
            async with aio.connect(daemon.endpoint) as other:
                return await other.experiment(name).trajectory(row.run)

        assert asyncio.run(awaited()).equals(paths[-1])
        experiment.delete()
    here, there = (np.array([np.nan if it is None else it for it in row], float) for row in rows)
    assert len(here) == 2 + len(COLUMNS)
    assert there == pytest.approx(here, abs=1e-6, nan_ok=True)
    for column in COLUMNS:
        one, other = (table[column].to_numpy() for table in tables)
        assert other == pytest.approx(one, abs=1e-6, nan_ok=True), column
    coarse = 1e-6 + 4.0 * float(np.spacing(np.abs(place).max()))
    for axis, of in zip("xy", place, strict=True):
        one, other = (path[axis].to_numpy() for path in paths)
        assert other - of == pytest.approx(one, abs=coarse)
    for column in ("id", "step", "informed"):
        assert (paths[0][column] == paths[1][column]).all()
    assert paths[0].informed.any()


def test_the_command_line_draws_a_far_group_as_one_at_the_origin(
    place: Floats, daemon: Daemon, create: Create, tmp_path: Path
) -> None:
    texts = []
    for name, where in (("here", None), ("there", place)):
        swarm = create(9, seed=5, start=start(9, where))
        swarm.inform(jostle.ids([2]), direction=1.0)
        swarm.step(20)
        out = tmp_path / f"{name}.svg"
        line = [str(JOSTLED.with_name("jostle")), "-e", daemon.endpoint]
        subprocess.run([*line, "plot", "snapshot", swarm.name, "-o", str(out)], check=True)
        texts.append(out.read_text().replace(swarm.name, "swarm"))
    numbers = [np.array(re.findall(r"-?\d+(?:\.\d+)?", text), float) for text in texts]
    shapes = [re.sub(r"-?\d+(?:\.\d+)?", "#", text) for text in texts]
    assert shapes[0] == shapes[1]
    assert numbers[1] == pytest.approx(numbers[0], abs=0.021)


class Screen:
    """`jostle watch` on a terminal of 30 lines of 100 columns."""

    def __init__(self, endpoint: str, swarm: str) -> None:
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        line = [str(JOSTLED.with_name("jostle")), "-e", endpoint, "watch", swarm]
        self._process = subprocess.Popen(
            line,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={**os.environ, "TERM": "xterm-256color"},
        )
        os.close(theirs)
        self._written = b""

    def bodies(self) -> dict[tuple[int, int], str]:
        """The cells of dots that are shown now, by line and column."""
        while select.select([self._ours], [], [], 0.05)[0]:
            self._written += os.read(self._ours, 65536)
        cells: dict[tuple[int, int], str] = {}
        row = column = 1
        text = self._written.decode(errors="ignore")
        for place, letter in re.findall(r"\x1b\[([\d;?]*[A-Za-z])|([^\x1b])", text):
            if match := re.fullmatch(r"(\d+);(\d+)H", place):
                row, column = int(match[1]), int(match[2])
            if letter:
                cells[row, column] = letter
                column += 1
        return {at: it for at, it in cells.items() if "\u2800" < it <= "\u28ff"}

    def close(self) -> None:
        """Leaves it with its key."""
        os.write(self._ours, b"q")
        assert self._process.wait(MAX_WAIT_SECS) == 0
        os.close(self._ours)


@pytest.mark.parametrize("place", [(1e4, -3e3), (-9e5, 7e5)])
def test_the_terminal_shows_a_far_group_as_one_at_the_origin(
    place: tuple[float, float], daemon: Daemon, create: Create
) -> None:
    shown = []
    for where in (None, np.array(place)):
        # Dots that are fixed in the plane are at the same places of both: at multiples of 1,000.
        swarm = create(9, seed=5, start=start(9, where))
        swarm.inform(jostle.ids([2]), direction=1.0)
        swarm.step(20)
        shown.append(Screen(daemon.endpoint, swarm.name))
    here, there = shown
    eventually("the same dots", lambda: len(here.bodies()) > 40 and here.bodies() == there.bodies())
    for screen in shown:
        screen.close()
