"""Environments for learning, against a real daemon."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test.parallel_test import parallel_api_test
from pettingzoo.test.seed_test import parallel_seed_test

import jostle
import jostle.env
from conftest import JOSTLED, MAX_WAIT_SECS, Daemon
from jostle.env import ParallelEnv, ShepherdEnv
from test_local import is_running

FOLDER = Path(__file__).resolve().parents[1]
Env = ParallelEnv | ShepherdEnv
KINDS: list[type[Env]] = [ParallelEnv, ShepherdEnv]


@pytest.fixture(autouse=True)
def _jostled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("JOSTLED", str(JOSTLED))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(params=KINDS)
def make(request: pytest.FixtureRequest, daemon: Daemon) -> Iterator[Callable[..., Env]]:
    """Creates environments on the shared daemon, and closes them after the test."""
    made: list[Env] = []

    def make(n: int = 8, informed: int = 2, **arguments: Any) -> Env:
        env: Env = request.param(n, informed, endpoint=daemon.endpoint, **arguments)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


def act(env: Env, number: float) -> Any:
    """An action from a number, the same for every agent."""
    if isinstance(env, ParallelEnv):
        vector = np.array([np.cos(number), np.sin(number)], np.float32)
        return dict.fromkeys(env.agents, vector)
    return np.array([np.sin(number), 0.3, np.cos(number), -0.5], np.float32)


def of_first(env: Env, observed: Any) -> Any:
    """The value of the first agent."""
    return observed["informed_0"] if isinstance(env, ParallelEnv) else observed


def hashes(env: Env, seed: int | None, actions: int = 5) -> list[str]:
    """The hashes of an episode's states."""
    _, info = env.reset(seed=seed)
    seen = [of_first(env, info)["state_hash"]]
    for number in range(actions):
        *_, info = env.step(act(env, number))
        seen.append(of_first(env, info)["state_hash"])
    return seen


def test_the_parallel_environment_passes_the_check_of_pettingzoo() -> None:
    with ParallelEnv(n=8, informed=3, max_steps=20, steps_per_action=5) as env:
        parallel_api_test(env, num_cycles=50)


def test_seeds_of_the_parallel_environment_pass_the_check_of_pettingzoo() -> None:
    parallel_seed_test(lambda: ParallelEnv(n=8, informed=3), num_cycles=20)  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("n", [1, 20])
def test_the_shepherd_passes_the_check_of_gymnasium(n: int) -> None:
    env = gymnasium.make("jostle/Shepherd-v0", n=n, informed=1)
    assert isinstance(env.unwrapped, ShepherdEnv)
    check_env(env.unwrapped)
    env.close()


def test_the_same_seed_and_actions_are_the_same_bytes(make: Callable[..., Env]) -> None:
    one, two = make(noise=0.05), make(noise=0.05)
    first = hashes(one, 7)
    # Earlier episodes and the choice of the environment do not matter.
    assert hashes(one, None) != first
    assert hashes(one, 7) == first
    assert hashes(two, 7) == first
    assert hashes(one, None) == hashes(two, None)
    assert hashes(two, 8) != first
    assert len(set(first)) == len(first)


def test_two_environments_are_independent(make: Callable[..., Env]) -> None:
    one, two = make(), make()
    alone = [hashes(one, 1), hashes(two, 2)]
    observed: list[list[str]] = [[], []]
    for env, seed, seen in ((one, 1, observed[0]), (two, 2, observed[1])):
        seen.append(of_first(env, env.reset(seed=seed)[1])["state_hash"])
    for number in range(5):
        for env, seen in zip((one, two), observed, strict=True):
            seen.append(of_first(env, env.step(act(env, number))[-1])["state_hash"])
    assert observed == alone


def in_another_process(kind: type[Env]) -> list[str]:
    env = kind(n=8, informed=2)
    seen = hashes(env, 7)
    env.close()
    return seen


def test_two_processes_have_daemons_of_their_own(make: Callable[..., Env]) -> None:
    env = make()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for seen in pool.map(in_another_process, [type(env)] * 2):
            assert seen == hashes(env, 7)


def test_vectors_of_environments_work_in_processes_that_were_forked() -> None:
    # An environment connects at the first reset, so it can be created before the fork.
    code = (
        "import gymnasium, jostle.env\n"
        "make = lambda: gymnasium.make('jostle/Shepherd-v0', n=6, informed=1)\n"
        "env = gymnasium.vector.AsyncVectorEnv([make, make], context='fork')\n"
        "observed, _ = env.reset(seed=[3, 3])\n"
        "observed, *_ = env.step(env.action_space.sample() * 0.0)\n"
        "print((observed[0] == observed[1]).all())\n"
        "env.close()\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ran.returncode, ran.stdout.strip()) == (0, "True"), ran.stderr


@pytest.mark.parametrize("spec", [{}, {"dt": 0.05, "pi1": 2.0}])
def test_the_reward_is_the_drift(
    make: Callable[..., Env], client: jostle.Client, spec: dict[str, float]
) -> None:
    goal = 2.0
    env = make(goal=goal, max_steps=4, steps_per_action=25, **spec)
    env.reset(seed=3)
    (swarm,) = [client.swarm(it.swarm) for it in client.swarms() if it.swarm.startswith("env-")]
    start = swarm.state()
    rewards = []
    for number in range(4):
        before = swarm.state()
        _, reward, terminated, truncated, info = env.step(act(env, 0.2 * number))
        after = swarm.state()
        moved = after.position.mean(axis=0) - before.position.mean(axis=0)
        assert after.step - before.step == 25
        along = moved @ (np.cos(goal), np.sin(goal))
        rewards.append(of_first(env, reward))
        assert rewards[-1] == pytest.approx(along / (after.time - before.time))
        assert of_first(env, terminated) is False
        assert of_first(env, truncated) is (number == 3)
        assert of_first(env, info)["state_hash"] == swarm.status().state_hash
        assert of_first(env, info)["drift"] == pytest.approx(np.mean(rewards))
        assert (after.step - start.step, after.time) == (
            of_first(env, info)["step"],
            of_first(env, info)["time"],
        )
    with pytest.raises(jostle.IncorrectState, match="reset"):
        env.step(act(env, 0.0))
    env.reset()


def test_actions_are_preferences_in_the_frame_of_the_goal(
    daemon: Daemon, client: jostle.Client
) -> None:
    with ParallelEnv(6, 3, goal=1.0, max_weight=4.0, endpoint=daemon.endpoint) as env:
        env.reset(seed=1)
        left, half, nothing = ([0.0, 1.0], [0.5, 0.0], [0.0, 0.0])
        actions = {f"informed_{i}": np.array(it) for i, it in enumerate((left, half, nothing))}
        env.step(actions)
        (state,) = [
            client.swarm(it.swarm).state() for it in client.swarms() if it.swarm.startswith("env-")
        ]
    assert state.weight == pytest.approx([4.0, 2.0, 0, 0, 0, 0])
    assert state.direction[:2] == pytest.approx([1.0 + np.pi / 2, 1.0])


def test_the_shepherd_informs_only_individuals_at_its_place(
    daemon: Daemon, client: jostle.Client
) -> None:
    with ShepherdEnv(12, 3, goal=1.0, max_weight=4.0, endpoint=daemon.endpoint) as env:
        env.reset(seed=1)
        (swarm,) = [client.swarm(it.swarm) for it in client.swarms() if it.swarm.startswith("env-")]
        for sign in (-1.0, 1.0, 1.0):
            before = swarm.state()
            env.step(np.array([sign, 0.0, -1.0, 0.0]))
            after = swarm.state()
            along = before.position @ (np.cos(1.0), np.sin(1.0))
            assert after.informed.sum() == 3
            # The individuals behind or ahead of the centre.
            assert (sign * (along - along.mean())[after.informed] > 0.0).all()
            assert after.weight[after.informed] == pytest.approx(4.0)
            assert after.direction[after.informed] == pytest.approx(1.0 + np.pi)
        env.step(np.zeros(4))
        assert not swarm.state().informed.any()


def test_local_observations_are_correct(daemon: Daemon) -> None:
    start = jostle.given([0.0, 0.0, 2.0, -9.0], [0.0, 2.0, 0.0, 0.0], [0.0, 1.0, np.pi, -np.pi / 2])
    goal = np.pi / 2
    env = ParallelEnv(4, 2, goal=goal, neighbours=3, endpoint=daemon.endpoint, start=start)
    observed, _ = env.reset(seed=1)
    env.close()
    # Along the goal is up, to its left is -x.
    first = observed["informed_0"]
    assert first[:2] == pytest.approx([0.0, -1.0], abs=1e-6)
    centre = np.array([0.5, 1.75])
    assert first[2:4] == pytest.approx(centre / (2.0 + np.hypot(*centre)), abs=1e-6)
    assert first[6:8] == pytest.approx([1 / 3, 0.0], abs=1e-6)
    assert first[8] == 0.0
    # Two neighbours at equal distances; the one with the lower id comes first.
    assert first[9:13] == pytest.approx([2 / 3, 0.0, np.sin(1.0), -np.cos(1.0)], abs=1e-6)
    assert first[13:17] == pytest.approx([0.0, -2 / 3, 0.0, 1.0], abs=1e-6)
    assert not first[17:].any()


def test_observations_from_above_are_correct(daemon: Daemon) -> None:
    start = jostle.given([-3.0, 3.0, 3.0, -3.0], [1.0, 1.0, -1.0, -1.0], [0.0, 0.0, 0.0, np.pi])
    env = ShepherdEnv(4, 1, endpoint=daemon.endpoint, start=start)
    observed, _ = env.reset(seed=1)
    env.close()
    spread = np.sqrt(10.0)
    assert observed[:5] == pytest.approx([0.5, 0.0, spread / (2.0 + spread), 0.8, 0.0], abs=1e-6)
    grid = observed[7:].reshape(5, 5, 3)
    assert grid[..., 0].sum() == pytest.approx(1.0)
    # A row is 4/5 of the spread, so all are in the middle row.
    assert grid[2, 1] == pytest.approx([0.5, 0.0, 0.0], abs=1e-6)
    assert grid[2, 3] == pytest.approx([0.5, 1.0, 0.0], abs=1e-6)


def test_all_goals_are_equivalent(make: Callable[..., Env]) -> None:
    x, y, alpha = np.array([0.0, 1.0, 0.0, 3.0]), np.array([0.0, 1.5, 2.5, 1.0]), np.arange(4.0)
    turn = 1.1
    c, s = np.cos(turn), np.sin(turn)
    observed = []
    for goal, start in (
        (0.0, jostle.given(x, y, alpha)),
        (turn, jostle.given(c * x - s * y, s * x + c * y, alpha + turn)),
    ):
        env = make(n=4, goal=goal, start=start)
        seen = [of_first(env, env.reset(seed=1)[0])]
        for number in range(3):
            observation, reward, *_ = env.step(act(env, number))
            seen += [of_first(env, observation), [of_first(env, reward)]]
        observed.append(np.concatenate(seen))
    assert observed[0] == pytest.approx(observed[1], abs=1e-5)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_observations_are_within_their_space(make: Callable[..., Env], n: int) -> None:
    env = make(n=n, informed=1)
    space = (
        env.observation_space("informed_0")
        if isinstance(env, ParallelEnv)
        else env.observation_space
    )
    observed = [of_first(env, env.reset(seed=1)[0])]
    for number in range(3):
        observed.append(of_first(env, env.step(act(env, number))[0]))
    assert all(one in space for one in observed)
    # Observations do not share memory, so a stored one never changes.
    assert not any(np.shares_memory(a, b) for a, b in itertools.pairwise(observed))


def test_a_picture_shows_the_group(make: Callable[..., Env]) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    env.step(act(env, 0.0))
    picture = env.render()
    assert picture is not None
    assert picture.shape == (360, 520, 3)
    assert picture.dtype == np.uint8
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert {(255, 255, 255), (0x8F, 0xB3, 0xD1), (0xF2, 0xA1, 0x54)} <= colours
    quiet = make()
    quiet.reset(seed=1)
    assert quiet.render() is None


def test_closing_ends_the_private_daemon_and_can_be_repeated() -> None:
    for kind in KINDS:
        env = kind(n=3, informed=1)
        env.close()
        env = kind(n=3, informed=1)
        env.reset(seed=1)
        client = env._world._client
        assert isinstance(client, jostle.Local)
        pid = client.pid
        env.close()
        env.close()
        assert not is_running(pid)
        with pytest.raises(jostle.IncorrectState, match="closed"):
            env.reset(seed=1)
        with pytest.raises(jostle.IncorrectState):
            env.step(act(env, 0.0))


def test_closing_deletes_the_swarm_and_leaves_a_shared_daemon(
    make: Callable[..., Env], client: jostle.Client
) -> None:
    before = {it.swarm for it in client.swarms()}
    env = make()
    env.reset(seed=1)
    assert len(client.swarms()) == len(before) + 1
    env.close()
    assert {it.swarm for it in client.swarms()} == before


def test_a_killed_daemon_is_an_error_without_a_wait() -> None:
    env = ShepherdEnv(n=3, informed=1)
    env.reset(seed=1)
    client = env._world._client
    assert isinstance(client, jostle.Local)
    os.kill(client.pid, signal.SIGKILL)
    began = time.monotonic()
    with pytest.raises(jostle.Unavailable, match="gone"):
        env.step(act(env, 0.0))
    with pytest.raises(jostle.IncorrectState, match="reset"):
        env.step(act(env, 0.0))
    assert time.monotonic() - began < MAX_WAIT_SECS
    env.reset(seed=1)
    another = env._world._client
    assert isinstance(another, jostle.Local)
    assert another.pid != client.pid
    env.step(act(env, 0.0))
    env.close()


def test_a_change_of_the_swarm_by_another_client_is_an_error(
    make: Callable[..., Env], client: jostle.Client
) -> None:
    env = make()
    first = hashes(env, 5, 1)
    (swarm,) = [client.swarm(it.swarm) for it in client.swarms() if it.swarm.startswith("env-")]
    swarm.reset()
    with pytest.raises(jostle.Conflict):
        env.step(act(env, 0.0))
    assert hashes(env, 5, 1) == first
    swarm.delete()
    with pytest.raises(jostle.NotFound):
        env.step(act(env, 0.0))
    assert hashes(env, 5, 1) == first


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"n": 0}, "n"),
        ({"informed": 9}, "informed"),
        ({"informed": 0}, "informed"),
        ({"max_weight": 0.0}, "max_weight"),
        ({"goal": float("nan")}, "goal"),
        ({"steps_per_action": 0}, "steps_per_action"),
        ({"max_steps": -1}, "max_steps"),
        ({"render_mode": "human"}, "render_mode"),
        ({"seed": 3}, "seed"),
        ({"pie": 3}, "pie"),
    ],
)
def test_a_wrong_argument_is_named(
    make: Callable[..., Env], arguments: dict[str, Any], field: str
) -> None:
    with pytest.raises(jostle.InvalidArgument, match=field):
        make(**arguments)


def test_an_error_of_the_daemon_is_raised(make: Callable[..., Env]) -> None:
    with pytest.raises(jostle.InvalidArgument, match="pi1"):
        make(pi1=0.5).reset(seed=1)
    env = make(max_weight=1e5)
    env.reset(seed=1)
    with pytest.raises(jostle.InvalidArgument, match=r"dt|weight"):
        env.step(act(env, 0.0))


def test_a_wrong_action_is_rejected(daemon: Daemon) -> None:
    env = ParallelEnv(4, 2, endpoint=daemon.endpoint)
    env.reset(seed=1)
    good = np.zeros(2)
    for actions, reason in (
        ({"informed_0": good}, "informed_1"),
        ({"informed_0": good, "informed_1": np.zeros(3)}, "informed_1"),
        ({"informed_0": good, "informed_1": np.array([np.nan, 0.0])}, "informed_1"),
    ):
        with pytest.raises(jostle.InvalidArgument, match=reason):
            env.step(actions)
    # The action has changed nothing.
    env.step(dict.fromkeys(env.agents, good))
    env.close()


def test_without_the_extra_the_error_names_it() -> None:
    for missing in ("gymnasium", "pettingzoo"):
        code = (
            f"import sys\nsys.modules[{missing!r}] = None\nimport jostle\n"
            "try:\n    import jostle.env\nexcept ImportError as error:\n    print(error)\n"
        )
        ran = subprocess.run(
            [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
        )
        assert "pip install 'jostle[env]'" in ran.stdout


def test_the_example_trains_and_compares(tmp_path: Path) -> None:
    figure = tmp_path / "train.svg"
    ran = subprocess.run(
        [
            sys.executable,
            *("-W", "error", FOLDER / "examples" / "train.py", "--quick", "--figure", figure),
        ],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert re.search(
        r"learned is [+-]\d\.\d{3} ± \d\.\d{3} better, on \d of 4 held-out", ran.stdout
    ), ran.stdout
    assert figure.read_text(encoding="utf-8").startswith("<?xml")
