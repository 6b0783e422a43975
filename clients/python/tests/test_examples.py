"""The examples run to their end. The blocks of the pages are in `test_docs.py`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import jostle
from conftest import Daemon

FOLDER = Path(__file__).resolve().parents[1]
Create = Callable[..., jostle.Swarm]


def run(script: str, *arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", FOLDER / "examples" / script, *arguments],
        env={**os.environ, **environ},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("script", ["steer.py", "bare_zenoh.py"])
@pytest.mark.parametrize("n", [1, 20])
def test_an_example_steers_and_then_removes_the_direction(
    script: str, n: int, daemon: Daemon, create: Create
) -> None:
    swarm = create(n=n, rate=20.0)
    swarm.run()
    ran = run(script, swarm.name, "--endpoint", daemon.endpoint, "--for", "6")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert len(re.findall(r"^ +\d+\.\d  +\d\.\d\d  +[+-]\d\.\d\d$", ran.stdout, re.M)) >= 8
    assert "90°" in ran.stdout
    assert swarm.status().informed == 0


@pytest.mark.parametrize("script", ["steer.py", "bare_zenoh.py"])
def test_an_example_names_what_is_missing(script: str, daemon: Daemon) -> None:
    ran = run(script, "unknown", "--endpoint", daemon.endpoint, "--for", "6")
    assert ran.returncode != 0
    assert "unknown" in ran.stderr


def test_the_controller_closes_its_loop(daemon: Daemon, client: jostle.Client) -> None:
    ran = run("controller.py", JOSTLE_ENDPOINT=daemon.endpoint)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert len(ran.stdout.splitlines()) == 10
    assert "looped" not in [summary.swarm for summary in client.swarms()]


def test_the_controllers_advice_names_options_that_exist(
    daemon: Daemon, client: jostle.Client
) -> None:
    offered = run("controller.py", "--help").stdout
    taken = client.create("taken", jostle.Spec(n=30, seed=4))
    for arguments, endpoint, advice in [
        ([], "tcp/127.0.0.1:1", "--endpoint"),
        (["taken"], daemon.endpoint, "NAME"),
    ]:
        ran = run("controller.py", *arguments, JOSTLE_ENDPOINT=endpoint)
        assert ran.returncode != 0
        assert advice in ran.stderr
        assert advice.lower() in offered
        # The advice names only options that the example has.
        for flag in re.findall(r"--[a-z-]+|exist_ok", ran.stderr):
            assert flag in offered
    assert "`jostle delete taken`" in ran.stderr
    taken.delete()
    ran = run("controller.py", "other", "--endpoint", daemon.endpoint)
    assert (ran.returncode, ran.stderr) == (0, "")


def test_a_repeated_experiment_is_the_same_to_the_bit(
    daemon: Daemon, client: jostle.Client
) -> None:
    ran = run("repeat.py", JOSTLE_ENDPOINT=daemon.endpoint)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "step 1000: batch" in ran.stdout
    assert "the same to the bit" in ran.stdout
    assert not {"once", "again"} & {summary.swarm for summary in client.swarms()}


def test_steering_a_paused_swarm_ends_with_a_remedy(daemon: Daemon, create: Create) -> None:
    swarm = create(n=2)
    ran = run("bare_zenoh.py", swarm.name, "--endpoint", daemon.endpoint)
    assert ran.returncode != 0
    assert "paused" in ran.stderr
