"""Copies of environments: pickled, deep, forked, and in the processes of vector environments."""

from __future__ import annotations

import copy
import gc
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
import supersuit
from gymnasium.error import ResetNeeded

import jostle
import jostle.env
from conftest import MAX_WAIT_SECS, Daemon
from jostle.env import ParallelEnv, ShepherdEnv
from test_env import Env, act, hashes, of_first
from test_env import _jostled as _jostled
from test_env import make as make
from test_local import is_running

Make = Callable[..., Env]
KINDS: list[type[Env]] = [ParallelEnv, ShepherdEnv]


@pytest.fixture(autouse=True)
def _no_swarm_is_left(daemon: Daemon, client: jostle.Client) -> Iterator[None]:
    before = swarms(client)
    yield
    assert swarms(client) == before


def steps(env: Env, numbers: list[float]) -> list[str]:
    """The hashes of the states that actions lead to."""
    return [of_first(env, env.step(act(env, number))[-1])["state_hash"] for number in numbers]


def swarms(client: jostle.Client) -> set[str]:
    """The swarms of environments on the shared daemon."""
    return {it.swarm for it in client.swarms() if it.swarm.startswith("env-")}


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: env.fork()], ids=["deep", "fork"])
def test_a_copy_goes_on_from_the_present_state(make: Make, copied: Callable[[Env], Env]) -> None:
    env = make(noise=0.05, max_steps=9, render_mode="rgb_array")
    env.reset(seed=5)
    steps(env, [0.0])
    env.render()
    steps(env, [1.0])
    twin, other = copied(env), copied(env)
    assert type(twin) is type(env)
    pictures: list[Any] = [twin.render(), env.render()]
    assert np.array_equal(*pictures)
    same = [2.0, 3.0, 4.0]
    elsewhere = steps(other, [0.5, 0.5, 0.5])
    ahead = steps(twin, same)
    assert steps(env, same) == ahead
    assert elsewhere != ahead
    # Also observations, rewards and infos, a copy of a copy, and the end of the episode.
    further = copied(twin)
    results = [one.step(act(one, 5.0)) for one in (env, twin, further)]
    for result in results[1:]:
        assert repr(result) == repr(results[0])
    for one in (env, twin, further):
        steps(one, [0.0, 0.0, 0.0])
        with pytest.raises(ResetNeeded, match="over"):
            one.step(act(env, 0.0))
    # The next seeds are those of the original, too.
    assert hashes(env, None) == hashes(twin, None) == hashes(further, None)
    assert hashes(other, 5) == hashes(env, 5)


def test_an_action_of_a_copy_changes_no_other(make: Make) -> None:
    env = make()
    first = hashes(env, 5)
    env.reset(seed=5)
    twin = env.fork()
    steps(twin, [9.0, 9.0])
    twin.reset(seed=6)
    assert steps(env, [0, 1, 2, 3, 4]) == first[1:]


def test_a_second_thread_is_refused_and_the_episode_goes_on(make: Make) -> None:
    env = make(n=50, steps_per_action=100)
    env.reset(seed=1)
    barrier = threading.Barrier(2)

    def work() -> list[str]:
        refused = []
        for number in range(20):
            barrier.wait(MAX_WAIT_SECS)
            try:
                env.step(act(env, number))
            except jostle.IncorrectState as error:
                refused.append(str(error))
        return refused

    with ThreadPoolExecutor(2) as pool:
        done = [pool.submit(work), pool.submit(work)]
        refused = [said for one in done for said in one.result(MAX_WAIT_SECS)]
    assert refused
    assert not [said for said in refused if "reset" in said]
    env.step(act(env, 0.0))


def test_copies_are_deleted_by_their_close_or_with_their_parent(
    make: Make, client: jostle.Client
) -> None:
    before = swarms(client)
    env = make()
    env.reset(seed=1)
    one, two = env.fork(), env.fork()
    three = two.fork()
    assert len(swarms(client) - before) == 4
    one.close()
    one.close()
    assert len(swarms(client) - before) == 3
    two.close()
    assert len(swarms(client) - before) == 1
    with pytest.raises(jostle.IncorrectState, match="closed"):
        three.step(act(three, 0.0))
    four = env.fork()
    steps(env, [0.0])
    env.close()
    assert swarms(client) == before
    for closed in (one, two, three, four, env):
        with pytest.raises(jostle.IncorrectState, match="closed"):
            closed.reset()
        with pytest.raises(jostle.IncorrectState, match="closed"):
            closed.fork()


def test_a_copy_that_nothing_references_is_deleted(make: Make, client: jostle.Client) -> None:
    before = swarms(client)
    env = make()
    env.reset(seed=1)
    for _ in range(5):
        steps(env.fork(), [0.0])
        gc.collect()
    # The last one is deleted at the next fork or reset.
    assert len(swarms(client) - before) == 2
    env.reset()
    assert len(swarms(client) - before) == 1


def test_a_copy_that_nothing_references_and_another_client_deleted_is_no_error(
    make: Make, client: jostle.Client
) -> None:
    env = make()
    env.reset(seed=1)
    for goes_on in (env.reset, env.fork):
        before = swarms(client)
        steps(env.fork(), [0.0])
        gc.collect()
        (dropped,) = swarms(client) - before
        client.swarm(dropped).delete()
        goes_on()


def test_copies_share_the_private_daemon_and_end_with_it() -> None:
    for kind in KINDS:
        env = kind(n=3, informed=1)
        env.reset(seed=1)
        twin = env.fork()
        client = env._world._client
        assert isinstance(client, jostle.Local)
        assert twin._world._client is client
        assert len(client.swarms()) == 2
        pid = client.pid
        twin.close()
        assert len(client.swarms()) == 1
        last = env.fork()
        env.close()
        assert not is_running(pid)
        with pytest.raises(jostle.IncorrectState, match="closed"):
            last.step(act(last, 0.0))
        last.close()


def test_a_copy_before_the_first_reset_is_a_new_environment(make: Make) -> None:
    env = make()
    twin = copy.deepcopy(env)
    with pytest.raises(ResetNeeded):
        twin.step(act(twin, 0.0))
    assert hashes(twin, 3) == hashes(env, 3)
    twin.close()
    env.reset()


def test_a_swarm_that_another_client_changed_is_not_copied(
    make: Make, client: jostle.Client
) -> None:
    before = swarms(client)
    env = make()
    env.reset(seed=1)
    (name,) = swarms(client) - before
    client.swarm(name).inject(1)
    with pytest.raises(jostle.Conflict, match="another client"):
        env.fork()
    assert swarms(client) - before == {name}


def test_the_copy_of_a_wrapped_environment_goes_on(daemon: Daemon) -> None:
    env = gymnasium.make(
        "jostle/Shepherd-v0", n=6, informed=1, max_episode_steps=9, endpoint=daemon.endpoint
    )
    env.reset(seed=4)
    action = np.array([0.3, 0.2, 1.0, 0.0], np.float32)
    env.step(action)
    twin = copy.deepcopy(env)
    assert env.step(action)[-1]["state_hash"] == twin.step(action)[-1]["state_hash"]
    twin.close()
    env.close()


@pytest.mark.parametrize("module", [pickle, cloudpickle])
def test_a_pickled_environment_has_its_arguments_and_no_episode(make: Make, module: Any) -> None:
    env = make(pi1=3.0, start=jostle.disc(9.0), max_steps=7, render_mode="rgb_array")
    unused = module.dumps(env)
    first = hashes(env, 3)
    for data in (unused, module.dumps(env)):
        # Picklers search all modules for the name of this object, and may find another one.
        assert b"UNSET" not in data
        twin = module.loads(data)
        assert getattr(twin, "agents", []) == []
        with pytest.raises(ResetNeeded):
            twin.step({} if isinstance(env, ParallelEnv) else act(twin, 0.0))
        assert hashes(twin, 3) == first
        twin.close()
    # The original is where it was.
    steps(env, [0.0])


def test_a_spec_is_copied_without_what_is_not_set() -> None:
    for spec in (
        jostle.Spec(n=3),
        jostle.Spec(n=2, measures=["drift"], start=jostle.given([0, 3], [0, 0], [0, 0])),
    ):
        for other in (pickle.loads(pickle.dumps(spec)), copy.copy(spec), copy.deepcopy(spec)):
            assert other == spec
        assert b"UNSET" not in pickle.dumps(spec)


def test_an_unknown_option_of_reset_is_refused(make: Make) -> None:
    env = make()
    for options in ({"unknown": 1}, {"options": 2}, {"seed": 1, "n": 3}):
        with pytest.raises(jostle.InvalidArgument, match=repr(next(iter(options)))) as caught:
            env.reset(seed=1, options=options)
        assert caught.value.details["field"] == "options"
    first = of_first(env, env.reset(seed=1, options={})[1])
    assert of_first(env, env.reset(seed=1, options=None)[1]) == first


def test_a_step_before_the_reset_is_the_error_of_gymnasium(make: Make) -> None:
    env = make(render_mode="rgb_array")
    action: Any = [0.0] * 4
    if isinstance(env, ParallelEnv):
        action = {"informed_0": [0.0, 0.0], "informed_1": [0.0, 0.0]}
    calls: list[Callable[[], object]] = [lambda: env.step(action), env.render]
    for call in calls:
        with pytest.raises(ResetNeeded, match="call `reset` first") as caught:
            call()
        # As in a vector environment, which sends it from process to process.
        error = pickle.loads(pickle.dumps(caught.value))
        assert isinstance(error, jostle.IncorrectState)
        assert isinstance(error, ResetNeeded)
        assert str(error) == str(caught.value)


def run(code: str) -> str:
    """Runs a program; returns what it prints."""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


USED = (
    "import functools, gymnasium, os, sys, jostle, jostle.env\n"
    "made = functools.partial(jostle.env.ShepherdEnv, n=6, informed=1)\n"
    "env = made()\n"
    "first, _ = env.reset(seed=3)\n"
)


@pytest.mark.parametrize("closes", ["env.close()\n", ""])
def test_vectors_work_in_a_forkserver_after_an_environment_was_used(closes: str) -> None:
    assert run(
        USED + closes + "vector = gymnasium.vector.AsyncVectorEnv([made] * 2, context='forkserver')"
        "\nobserved, _ = vector.reset(seed=[3, 3])\n"
        "print((observed == first).all())\n"
        "vector.close()\n"
    ).split() == ["True"]


@pytest.mark.parametrize("closes", ["env.close()\n", ""])
def test_a_fork_of_a_process_that_used_an_environment_names_the_context(closes: str) -> None:
    # Without a program, the error is another one if the daemon is started first.
    out = run(
        USED + closes + "os.environ['JOSTLED'] = '/no/such/jostled'\n"
        "vector = gymnasium.vector.AsyncVectorEnv([made] * 2, context='fork')\n"
        "try:\n    vector.reset(seed=[3, 3])\n"
        "except jostle.Unavailable as error:\n    print(error)\n"
        "vector.close(terminate=True)\n"
    )
    assert 'context="forkserver"' in out
    assert "/no/such/jostled" not in out


def test_the_processes_of_supersuit_work_before_the_first_reset() -> None:
    code = (
        "import numpy as np, supersuit, jostle.env\n"
        "env = jostle.env.ParallelEnv(n=6, informed=2)\n"
        "vector = supersuit.pettingzoo_env_to_vec_env_v1(env)\n"
        "vector = supersuit.concat_vec_envs_v1(vector, 2, num_cpus=2, base_class='gymnasium')\n"
        "vector.reset(seed=3)\n"
        "observed, *_ = vector.step(np.zeros((4, 2), np.float32))\n"
        "print(observed.shape)\n"
        "vector.close()\n"
    )
    assert run(code).strip() == "(4, 33)"


def tutorial(env: ParallelEnv, cpus: int) -> Any:
    """PettingZoo's tutorial for Stable-Baselines3, up to the vector environment."""
    env.reset(seed=42)
    vector = supersuit.pettingzoo_env_to_vec_env_v1(env)
    return supersuit.concat_vec_envs_v1(vector, 8, num_cpus=cpus, base_class="gymnasium")


def test_the_tutorial_of_pettingzoo_runs_up_to_the_vector_environment(daemon: Daemon) -> None:
    env = ParallelEnv(n=8, informed=3, max_steps=4, steps_per_action=5, endpoint=daemon.endpoint)
    alone = env.reset(seed=7)[0]
    vector = tutorial(env, 1)
    try:
        assert vector.num_envs == 24
        observed, _ = vector.reset(seed=7)
        assert observed.shape == (24, 33)
        assert (observed[:3] == list(alone.values())).all()
        # Each of the eight has a seed of its own.
        assert len({observed[3 * it].tobytes() for it in range(8)}) == 8
        ends = 0
        for _ in range(9):
            action = np.full((24, 2), 0.5, np.float32)
            observed, rewards, _, truncated, infos = vector.step(action)
            assert rewards.shape == (24,)
            assert np.isfinite(observed).all()
            ends += int(truncated.all())
            assert ("terminal_observation" in infos[0]) is bool(truncated.all())
        assert ends == 2
    finally:
        vector.close()
        env.close()
