"""Sweeps: the same tables as one machine's, on executors whose workers are killed."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import dask
import distributed
import pytest

import jostle
from cluster import Cluster, clusters, command_of
from conftest import JOSTLED, MAX_WAIT_SECS, ROOT, eventually
from jostle._delivery import Target

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("jostled_named")]

SMALL = """
name = "small"
seed = 3
replicates = 3
duration = 30
[[grid]]
n = [5, 20]
pi1 = [1, 4]
informed = [0, 2]
[measure]
order_every = 10
touch = true
"""
RUNS = 24
TABLES = ("results.csv", "results.parquet", "order.parquet", "touch.csv")
# Some 20 tasks.
TASK_SECS = 0.02


def tables(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in TABLES}


def alone(toml: str, folder: Path) -> dict[str, bytes]:
    """The tables that `jostled run` writes on this machine."""
    file = folder / "alone.toml"
    file.write_text(toml, encoding="utf-8")
    command: list[str | Path] = [JOSTLED, "run", file, "-o", folder / "alone"]
    subprocess.run(command, check=True, capture_output=True, timeout=MAX_WAIT_SECS)
    return tables(folder / "alone")


def test_a_sweep_on_all_cores_writes_the_tables_of_one_program(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    with jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS) as sweep:
        rows = list(sweep)
        assert sweep.share == 1.0
        assert sweep.faults() == {}
    assert len(rows) == RUNS
    assert tables(folder) == alone(SMALL, tmp_path)
    assert not (tmp_path / "results.parts").exists()
    # Rows arrive in any order; the table has the order of the plan.
    assert sorted(rows, key=lambda it: it.run) == sorted(sweep.rows(), key=lambda it: it.run)
    table = sweep.frame()
    assert list(table["run"]) == [row.run for row in sweep.rows()]
    assert list(table.columns)[:3] == ["run", "seed", "n"]
    # The second call executes nothing.
    before = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert jostle.sweep(SMALL, folder=folder).wait().rows() == sweep.rows()
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == before


def test_points_are_a_part_of_a_sweep(tmp_path: Path) -> None:
    toml = 'name = "points"\nduration = 20\npoints = "samples.csv"\nspec = { n = 10 }\n'
    (tmp_path / "points.toml").write_text(toml)
    samples = tmp_path / "samples.csv"
    samples.write_text("pi1,informed\n1,0\n2.5,1\n4,2\n")
    folder = tmp_path / "results"
    with jostle.sweep(tmp_path / "points.toml", folder=folder, task_secs=1e-4) as sweep:
        next(iter(sweep))
    # The received parts are those of this CSV.
    samples.write_text("pi1,informed\n1,0\n2.5,1\n")
    with pytest.raises(jostle.IncorrectState, match="contains parts of another experiment"):
        jostle.sweep(tmp_path / "points.toml", folder=folder)
    samples.write_text("pi1,informed\n1,0\n2.5,1\n4,2\n")
    rows = jostle.sweep(tmp_path / "points.toml", folder=folder).wait().rows()
    assert [(row.pi1, row.informed) for row in rows] == [(1, 0), (2.5, 1), (4, 2)]
    assert jostle.sweep(tmp_path / "points.toml", folder=folder).rows() == rows
    samples.write_text("pi1,informed\n1,0\n")
    with pytest.raises(jostle.IncorrectState, match="contains another experiment"):
        jostle.sweep(tmp_path / "points.toml", folder=folder)
    with pytest.raises(jostle.InvalidArgument, match="leave out points"):
        jostle.Objective(toml, "v", folder=tmp_path / "search")


def test_an_interrupted_sweep_continues_on_another_executor(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    with jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS) as sweep:
        for _ in sweep:
            break
    assert not folder.exists()
    assert list((tmp_path / "results.parts").glob("runs-*"))
    with pytest.raises(jostle.IncorrectState, match="the sweep was cancelled"):
        sweep.wait()
    part = next((tmp_path / "results.parts").glob("runs-*")) / "runs.jsonl"
    contents = part.read_bytes()
    part.write_bytes(contents[:-5])
    with pytest.raises(
        jostle.IncorrectState, match=r"is damaged: .* remove it to execute its runs"
    ):
        jostle.sweep(SMALL, folder=folder)
    part.write_bytes(contents)
    # An empty folder behind a link is written, too.
    (tmp_path / "behind").mkdir()
    folder.symlink_to("behind")
    (tmp_path / "results.parts").rename(tmp_path / "behind.parts")
    with ProcessPoolExecutor(2) as executor:
        again = jostle.sweep(SMALL, executor, folder=folder, task_secs=1.0)
        assert 0 < len(again.rows()) < RUNS
        assert len(again.wait().rows()) == RUNS
    assert tables(folder) == alone(SMALL, tmp_path)


def wrapper(folder: Path, script: str) -> Path:
    """A `jostled` that runs `script`, beside the real command line."""
    folder.mkdir()
    (folder / "jostle").symlink_to(JOSTLED.with_name("jostle"))
    program = folder / "jostled"
    program.write_text(f"#!/bin/sh\nset -e\n{textwrap.dedent(script)}", encoding="utf-8")
    program.chmod(0o755)
    return program


def test_a_task_that_fails_names_its_runs_and_the_others_finish(tmp_path: Path) -> None:
    broken = wrapper(
        tmp_path / "broken",
        f"""
        case " $* " in
          *" 5 "* | *" 5,"* | *",5"*) echo "jostled: run 5 panicked" >&2; exit 3 ;;
        esac
        exec {JOSTLED} "$@"
        """,
    )
    folder = tmp_path / "results"
    sweep = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, jostled=broken)
    with pytest.raises(jostle.Faulted, match=r"1 tasks failed: runs [\d,-]*5[\d,-]* on .*panicked"):
        sweep.wait()
    assert not folder.exists()
    # All other runs are stored: only those of the task are missing.
    again = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS)
    assert RUNS - 5 <= len(again.rows()) < RUNS
    again.wait()
    assert tables(folder) == alone(SMALL, tmp_path)


def test_a_worker_of_another_version_is_an_error(tmp_path: Path) -> None:
    other = wrapper(
        tmp_path / "other",
        f"""
        {JOSTLED} "$@"
        for last; do :; done
        sed -i '1s/"model_version":[0-9]*/"model_version":999/' "$last/runs.jsonl"
        """,
    )
    folder = tmp_path / "results"
    sweep = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, jostled=other)
    with pytest.raises(jostle.Conflict, match="a worker has version 999 of the model and this"):
        sweep.wait()
    assert not folder.exists()
    assert not list((tmp_path / "results.parts").glob("runs-*"))
    jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS).wait()


def test_parts_under_other_definitions_are_an_error_before_they_are_merged(tmp_path: Path) -> None:
    older = wrapper(
        tmp_path / "older",
        f"""
        {JOSTLED} "$@" || exit
        for last; do :; done
        [ ! -e "$last/runs.jsonl" ] || sed -i '1s/,"definitions":2//' "$last/runs.jsonl"
        """,
    )
    folder = tmp_path / "results"
    sweep = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, jostled=older)
    next(iter(sweep))
    sweep.cancel()
    parts = sorted((tmp_path / "results.parts").glob("runs-*"))
    assert parts
    with pytest.raises(
        jostle.Conflict, match="a worker has the definitions 2 of measures and other parts 1: "
    ):
        jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS).wait()
    assert sorted((tmp_path / "results.parts").glob("runs-*")) == parts
    jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, jostled=older).wait()
    assert len((folder / "results.csv").read_text(encoding="utf-8").splitlines()) == 1 + RUNS


class WithoutRuns(ThreadPoolExecutor):
    """An executor whose results lack `runs.jsonl`, as those of another version might."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Submits `work`, and reduces its result."""

        def run() -> object:
            result = work(*arguments, **options)
            (folder,) = (it.folder for it in arguments if isinstance(it, Target))
            Path(folder, result.name, "runs.jsonl").unlink()
            return result

        return super().submit(run)


def test_a_result_without_a_file_is_an_error(tmp_path: Path) -> None:
    with WithoutRuns(1) as executor:
        sweep = jostle.sweep(SMALL, executor, folder=tmp_path / "results", task_secs=TASK_SECS)
        with pytest.raises(
            jostle.Conflict, match=r"the result of runs [\d,-]+ has no runs.jsonl: install the same"
        ):
            sweep.wait()
    assert not list(tmp_path.iterdir())


def test_invalid_arguments_and_folders_change_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    for source, arguments, message in (
        ("name = 3\n", {}, "^the experiment: line 1, column 8: "),
        ({"name": 3}, {}, "^the experiment: line 1, column 8: "),
        (SMALL, {"executor": "spark:here"}, "invalid executor 'spark:here'"),
        (SMALL, {"executor": 3}, "invalid executor 3: it has no method `submit`"),
        (SMALL, {"executor": ThreadPoolExecutor}, "it is a class; use an instance"),
        (SMALL, {"task_secs": 0.0}, "task_secs"),
        (SMALL, {"task_secs": 1e300}, r"task_secs is 1e\+300, but must be at most 1e\+09"),
        (SMALL, {"task_secs": float("nan")}, "task_secs"),
    ):
        with pytest.raises(jostle.InvalidArgument, match=message):
            jostle.sweep(source, folder=folder, **arguments)
        assert not list(tmp_path.iterdir())
    file = tmp_path / "wrong.toml"
    file.write_text("name = 3\n", encoding="utf-8")
    with pytest.raises(
        jostle.InvalidArgument, match=f"^{re.escape(str(file))}: line 1, column 8: "
    ):
        jostle.sweep(file, folder=folder)
    (folder / "experiment.toml").parent.mkdir()
    (folder / "experiment.toml").write_text("name = 'another'", encoding="utf-8")
    with pytest.raises(jostle.IncorrectState, match="contains another experiment"):
        jostle.sweep(SMALL, folder=folder)
    (folder / "experiment.toml").write_text(SMALL, encoding="utf-8")
    (folder / "runs.jsonl").write_bytes(b"")
    with pytest.raises(jostle.IncorrectState, match="finish it with `jostled run"):
        jostle.sweep(SMALL, folder=folder)
    held = jostle.sweep(SMALL, folder=tmp_path / "held", task_secs=TASK_SECS)
    with pytest.raises(jostle.Conflict, match="another process is using"):
        jostle.sweep(SMALL, folder=tmp_path / "held")
    held.cancel()
    for _ in range(2):
        with pytest.raises(jostle.IncorrectState, match="the sweep was cancelled"):
            held.wait()
    assert not (tmp_path / "held.parts").exists()


INTERRUPTED = """
import sys, jostle
for _ in jostle.sweep(open(sys.argv[1]).read(), folder=sys.argv[2], task_secs=1e9):
    pass
"""


def running(folder: Path) -> list[int]:
    """The processes whose command line names a folder."""
    processes = [int(it.name) for it in Path("/proc").iterdir() if it.name.isdigit()]
    return [it for it in processes if str(folder).encode() in command_of(it)]


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGKILL])
def test_the_end_of_the_caller_ends_its_child_processes(tmp_path: Path, by: signal.Signals) -> None:
    file = tmp_path / "endless.toml"
    file.write_text('name = "a"\nduration = 1e6\nspec = { n = 20 }\nreplicates = 2\n')
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    caller = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, file, tmp_path / "results"],
        env={**os.environ, "TMPDIR": str(temporary)},
        stderr=subprocess.DEVNULL,
    )
    eventually("a program", lambda: bool(running(temporary)))
    caller.send_signal(by)
    caller.wait(MAX_WAIT_SECS)
    eventually("its end", lambda: not running(temporary))
    eventually("no temporary folder", lambda: not list(temporary.glob("jostle-part-*")))
    assert not (tmp_path / "results").exists()


# Some twenty seconds on two cores, a task for each run: a killed worker starts again in a second or
# two.
KILLED = """
name = "killed"
seed = 5
replicates = 6
duration = 750
[[grid]]
n = [20, 40]
pi1 = [1, 4]
informed = [0, 2]
[measure]
order_every = 100
"""


@pytest.fixture
def start_cluster(tmp_path: Path) -> Iterator[Callable[[str], Cluster]]:
    with clusters(tmp_path) as start:
        yield start


KILLS = 5
# Results between two kills, of 48.
MIN_RESULTS = 4


def kill(cluster: Cluster, parts: Path, killed: list[int]) -> None:
    """Kills a random worker whenever some results have arrived, and then the scheduler."""
    draw = random.Random(4)

    def arrived() -> bool:
        return len(list(parts.glob("runs-*"))) >= MIN_RESULTS * (len(killed) + 1)

    while len(killed) < KILLS:
        eventually("more results", arrived)
        if workers := cluster.worker_processes():
            killed.append(draw.choice(workers))
            os.kill(killed[-1], signal.SIGKILL)
    eventually("more results", arrived)
    cluster.scheduler.kill()


def test_a_sweep_on_dask_survives_killed_workers_and_a_killed_scheduler(
    tmp_path: Path, start_cluster: Callable[[str], Cluster]
) -> None:
    folder = tmp_path / "results"
    cluster = start_cluster("first")
    sweep = jostle.sweep(KILLED, f"dask:{cluster.address}", folder=folder, task_secs=0.5)
    killed: list[int] = []
    killer = threading.Thread(target=kill, args=(cluster, tmp_path / "results.parts", killed))
    killer.start()
    with pytest.raises(jostle.Unavailable, match="call `sweep` again with the same folder"):
        sweep.wait()
    killer.join()
    assert len(killed) == KILLS
    finished = len(sweep.rows())
    assert 0 < finished < 48
    second = start_cluster("second")
    again = jostle.sweep(KILLED, f"dask:{second.address}", folder=folder, task_secs=0.5)
    assert len(again.rows()) == finished
    assert len(again.wait().rows()) == 48
    written = {name: (folder / name).read_bytes() for name in TABLES[:3]}
    file = tmp_path / "alone.toml"
    file.write_text(KILLED, encoding="utf-8")
    command: list[str | Path] = [JOSTLED, "run", file, "-o", tmp_path / "alone"]
    subprocess.run(command, check=True, capture_output=True, timeout=4 * MAX_WAIT_SECS)
    assert written == {name: (tmp_path / "alone" / name).read_bytes() for name in TABLES[:3]}


def test_a_cancelled_sweep_on_dask_leaves_an_equal_one_alone(
    tmp_path: Path, start_cluster: Callable[[str], Cluster]
) -> None:
    names = ("cancelled", "other")
    with distributed.Client(start_cluster("both").address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        one, other = (
            jostle.sweep(SMALL, client, folder=tmp_path / name, task_secs=TASK_SECS)
            for name in names
        )
        rows = iter(other)
        first = next(rows)
        for _ in one:
            break
        one.cancel()
        assert len([first, *rows]) == RUNS
    assert tables(tmp_path / "other") == alone(SMALL, tmp_path)
    assert not (tmp_path / "cancelled").exists()


def test_the_page_about_clusters_sweeps_on_dask(
    tmp_path: Path, start_cluster: Callable[[str], Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
    toml = page.split("```toml\n")[1].split("```")[0]
    (code,) = (it.split("```")[0] for it in page.split("```python\n")[1:])
    address = start_cluster("page").address
    code = code.replace("tcp://scheduler:8786", address)
    assert address in code
    (tmp_path / "leaders.toml").write_text(toml, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "cluster.md", "exec"), {})
    assert len((tmp_path / "results" / "results.csv").read_text().splitlines()) == 41


def test_the_variables_of_the_page_are_settings_of_dask() -> None:
    page = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
    lines = page.split("```text\n")[1].split("```")[0].splitlines()
    found = dask.config.collect_env(dict(line.split("=") for line in lines))["distributed"]
    defaults = dask.config.config["distributed"]
    assert defaults["worker"]["profile"]["enabled"] is True
    assert found["worker"]["profile"]["enabled"] is False
    assert defaults["admin"]["tick"]["interval"] == "20ms"
    assert found["admin"]["tick"]["interval"] == "1s"


def test_a_scheduler_that_does_not_answer_is_unavailable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    timeouts = dask.config.config["distributed"]["comm"]["timeouts"]
    monkeypatch.setitem(timeouts, "connect", "1s")
    expected = r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"
    with pytest.raises(jostle.Unavailable, match=expected):
        jostle.sweep(SMALL, "dask:tcp://127.0.0.1:1", folder=tmp_path / "results").wait()
