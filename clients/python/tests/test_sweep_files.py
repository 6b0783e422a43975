"""Sweeps return the files of runs, with any executor, and although workers are killed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import distributed
import pytest

import jostle
from cluster import Cluster, clusters
from conftest import JOSTLED, MAX_WAIT_SECS, eventually
from jostle import _delivery
from jostle._tasks import Tasks

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("jostled_named")]

SMALL = """
name = "recorded"
seed = 7
replicates = 2
duration = 10
[[grid]]
n = [4, 6]
[measure]
record_every = 10
order_every = 10
"""
# The series and the order of each run have more than 64 KiB.
SERIES = """
name = "series"
seed = 9
replicates = 2
duration = 120
[[grid]]
n = [2, 3]
[measure]
order_every = 1
series_every = 1
columns = ["order", "drift", "milling"]
"""
# Each run has a file of some 9 MB, in three pieces.
LARGE = """
name = "recorded"
seed = 8
replicates = 2
duration = 16
[measure]
record_every = 1
[spec]
n = 500
"""
RUNS = 4
LARGE_RUNS = 2
NAMES = [f"trajectories/run-{number:06}.parquet" for number in range(1, RUNS + 1)]
# A task for each run.
TASK_SECS = 1e-6


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a folder of results, with the list of runs in the order of their names."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "lock"]
    found = {str(path.relative_to(folder)): path.read_bytes() for path in files}
    found["runs.jsonl"] = b"".join(sorted(found["runs.jsonl"].splitlines(keepends=True)))
    return found


def alone(toml: str, folder: Path) -> dict[str, bytes]:
    """The files that `jostled run` writes on this machine."""
    file = folder / "alone.toml"
    file.write_text(toml, encoding="utf-8")
    command: list[str | Path] = [JOSTLED, "run", file, "-o", folder / "alone"]
    subprocess.run(command, check=True, capture_output=True, timeout=4 * MAX_WAIT_SECS)
    return contents(folder / "alone")


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    files = alone(LARGE, tmp_path_factory.mktemp("large"))
    assert all(len(files[name]) > 2 * _delivery.PIECE for name in NAMES[:LARGE_RUNS])
    return files


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that the workers do not see: this path is another folder in each process."""
    monkeypatch.chdir(tmp_path)
    return Path("/proc/self/cwd/results")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with clusters(tmp_path_factory.mktemp("clusters")) as start:
        yield start("cluster")


def elsewhere(folder: Path) -> ProcessPoolExecutor:
    """An executor whose worker does not see the folder `here`."""
    return ProcessPoolExecutor(1, initializer=os.chdir, initargs=(folder,))


@pytest.mark.parametrize("toml", [SMALL, SERIES], ids=["trajectories", "series"])
def test_a_sweep_on_all_cores_returns_the_files_of_one_program(toml: str, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    sweep = jostle.sweep(toml, folder=folder, task_secs=TASK_SECS)
    assert len(sweep.wait().rows()) == RUNS
    files = contents(folder)
    assert files == alone(toml, tmp_path)
    assert toml is SERIES or set(NAMES) < set(files)
    assert not (tmp_path / "results.parts").exists()


@pytest.mark.parametrize("toml", [SMALL, SERIES], ids=["trajectories", "series"])
def test_a_worker_that_does_not_see_the_folder_returns_the_files(
    toml: str, tmp_path: Path, here: Path
) -> None:
    with elsewhere(tmp_path.parent) as executor:
        jostle.sweep(toml, executor, folder=here, task_secs=TASK_SECS).wait()
    assert contents(here) == alone(toml, tmp_path)


def test_files_larger_than_a_result_need_a_shared_folder_or_dask(
    tmp_path: Path, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The worker is forked.
    monkeypatch.setattr(_delivery, "MAX_RETURNED", 3000)
    with elsewhere(tmp_path.parent) as executor:
        sweep = jostle.sweep(SMALL, executor, folder=here, task_secs=TASK_SECS)
        expected = r"4 tasks failed: runs . on .*: the files have \d+ bytes, and a task returns at "
        expected += r"most 3000: use a `folder` on a disk that the workers share, .* of Dask"
        with pytest.raises(jostle.Faulted, match=expected):
            sweep.wait()
    # Any size passes if the folder is shared.
    with ProcessPoolExecutor(1) as executor:
        jostle.sweep(SMALL, executor, folder=tmp_path / "shared", task_secs=TASK_SECS).wait()
    assert contents(tmp_path / "shared") == alone(SMALL, tmp_path)


def test_a_full_disk_of_the_caller_is_storage_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_source: Path, target: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))

    # The worker is forked.
    monkeypatch.setattr(_delivery, "_move", fail)
    with ProcessPoolExecutor(1) as executor:
        sweep = jostle.sweep(SMALL, executor, folder=tmp_path / "results", task_secs=TASK_SECS)
        with pytest.raises(jostle.StorageFull, match=r"failed to write a part to .* free disk"):
            sweep.wait()
    assert not list(tmp_path.glob("results.parts/.runs-*"))


def shorten(file: Path) -> None:
    os.truncate(file, file.stat().st_size - 1)


class Shortening(ThreadPoolExecutor):
    """An executor on whose way the last byte of each trajectory is lost."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Submits `work`, and shortens the files of its result."""

        def run() -> object:
            result = work(*arguments, **options)
            (folder,) = (it.folder for it in arguments if isinstance(it, _delivery.Target))
            for file in Path(folder, result.name).glob("trajectories/*"):
                shorten(file)
            return result

        return super().submit(run)


def test_a_part_is_received_when_its_files_are_as_long_as_its_list_says(tmp_path: Path) -> None:
    with Shortening(1) as executor:
        sweep = jostle.sweep(SMALL, executor, folder=tmp_path / "results", task_secs=TASK_SECS)
        expected = (
            r"4 tasks failed: .*runs 1: trajectories/run-000001.parquet has \d+ bytes instead of"
        )
        with pytest.raises(jostle.Faulted, match=expected):
            sweep.wait()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", [Path.unlink, shorten])
def test_a_received_part_that_lacks_files_is_executed_again(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    folder = tmp_path / "results"
    with jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS) as sweep:
        next(iter(sweep))
    parts = list((tmp_path / "results.parts").glob("runs-*"))
    assert parts
    for part in parts:
        (trajectory,) = part.glob("trajectories/*")
        damage(trajectory)
    # Being received when a sweep was killed.
    draft = tmp_path / "results.parts" / ".runs-0123"
    draft.mkdir()
    (draft / "runs.jsonl").write_bytes(b"{}")
    again = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS)
    assert again.rows() == []
    assert not draft.exists()
    again.wait()
    assert contents(folder) == alone(SMALL, tmp_path)


def kept(cluster: Cluster) -> list[Path]:
    """The folders of parts on the workers."""
    return list(cluster.folder.glob("dask-scratch-space/*/jostle-part-*"))


def test_dask_workers_send_large_files_in_pieces(
    here: Path,
    cluster: Cluster,
    large: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lengths: list[int] = []
    read = Tasks.read

    def counted(tasks: Tasks, future: Any, worker: str, path: str, offset: int) -> bytes:
        piece = read(tasks, future, worker, path, offset)
        lengths.append(len(piece))
        return piece

    monkeypatch.setattr(Tasks, "read", counted)
    sweep = jostle.sweep(LARGE, f"dask:{cluster.address}", folder=here, task_secs=TASK_SECS)
    assert len(sweep.wait().rows()) == LARGE_RUNS
    assert max(lengths) == _delivery.PIECE
    assert sum(lengths) > sum(len(large[name]) for name in NAMES[:LARGE_RUNS])
    assert contents(here) == large
    eventually("no file is left on a worker", lambda: not kept(cluster))


def test_a_part_whose_worker_is_killed_while_it_is_received_is_executed_again(
    here: Path,
    cluster: Cluster,
    large: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    killed: list[str] = []
    read = Tasks.read

    def killing(tasks: Tasks, future: Any, worker: str, path: str, offset: int) -> bytes:
        # Within the file of the first run, and before that of the second one.
        if offset == (_delivery.PIECE, 0)[len(killed) % 2] and len(killed) < 2:
            with distributed.Client(cluster.address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
                (process,) = client.run(os.getpid, workers=[worker]).values()
            os.kill(process, signal.SIGKILL)
            killed.append(path)
        return read(tasks, future, worker, path, offset)

    monkeypatch.setattr(Tasks, "read", killing)
    sweep = jostle.sweep(LARGE, f"dask:{cluster.address}", folder=here, task_secs=TASK_SECS)
    assert len(list(sweep)) == LARGE_RUNS
    assert len(killed) == 2
    assert contents(here) == large
    eventually("no file is left on a worker", lambda: not kept(cluster))


def test_a_part_that_is_lost_five_times_fails(
    here: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost: list[str] = []

    def read(_tasks: Tasks, _future: Any, worker: str, path: str, _offset: int) -> bytes:
        lost.append(path)
        raise _delivery.Lost(f"{path} on {worker}: the worker is gone")

    monkeypatch.setattr(Tasks, "read", read)
    one = LARGE.replace("replicates = 2", "").replace("duration = 16", "duration = 7")
    sweep = jostle.sweep(one, f"dask:{cluster.address}", folder=here, task_secs=TASK_SECS)
    expected = r"1 tasks failed: runs 1: lost 5 times, last /.* the worker is gone\. Call `sweep`"
    with pytest.raises(jostle.Faulted, match=expected):
        sweep.wait()
    # Each from an execution of its own.
    assert len(set(lost)) == 5


KILLED = """
import os, signal, sys, jostle
from jostle import _delivery
from jostle._tasks import Tasks

read, files = Tasks.read, []

def killing(tasks, future, worker, path, offset):
    if offset == _delivery.PIECE:
        files.append(path)
        if len(files) == 2:
            os.kill(os.getpid(), signal.SIGKILL)
    return read(tasks, future, worker, path, offset)

Tasks.read = killing
_, file, address, folder = sys.argv
jostle.sweep(file, f"dask:{address}", folder=folder, task_secs=1e-6).wait()
"""


def test_a_sweep_that_is_killed_while_it_receives_a_part_resumes(
    tmp_path: Path,
    here: Path,
    cluster: Cluster,
    large: dict[str, bytes],
) -> None:
    file = tmp_path / "large.toml"
    file.write_text(LARGE, encoding="utf-8")
    command: list[str | Path] = [sys.executable, "-c", KILLED, file, cluster.address, here]
    killed = subprocess.run(command, check=False, timeout=4 * MAX_WAIT_SECS, cwd=tmp_path)
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob("results.parts/.runs-*/trajectories/*"))) == 1
    # Dask tells the workers that the client is gone.
    eventually("no file is left on a worker", lambda: not kept(cluster))
    again = jostle.sweep(file, f"dask:{cluster.address}", folder=here, task_secs=TASK_SECS)
    assert len(again.rows()) == 1
    again.wait()
    assert contents(here) == large
