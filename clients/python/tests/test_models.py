"""Results of an earlier version of the model: no run is added, all are executed again beside them.

No earlier version can be executed here: the header of each list of runs is changed to name one.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import re
import shutil
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

import jostle
from conftest import JOSTLED, ROOT, Daemon, eventually
from jostle import aio
from jostle._delivery import LOCK
from test_sweep import RUNS, SMALL, TASK_SECS, alone, tables, wrapper

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("jostled_named")]

# Of version 1 of the model, at step 60: `tests/stored/make_earlier.py` writes it.
SNAPSHOT = ROOT / "tests" / "stored" / "earlier.snapshot"

_VERSION = re.compile(rb'(?<="model_version":)\d+')


def of_model(folders: Iterable[Path], by: int) -> int:
    """Adds `by` to the version of the model in the lists of runs; returns the version of all."""
    versions = set()
    for folder in folders:
        runs = folder / "runs.jsonl"
        header, rest = runs.read_bytes().split(b"\n", 1)
        (found,) = _VERSION.findall(header)
        versions.add(int(found) + by)
        runs.write_bytes(_VERSION.sub(b"%d" % (int(found) + by), header) + b"\n" + rest)
    (version,) = versions
    return version


def contents(folder: Path) -> dict[str, bytes]:
    """All files in a folder but the lock, which each sweep writes."""
    files = [it for it in folder.rglob("*") if it.is_file() and it.name != LOCK]
    return {str(it.relative_to(folder)): it.read_bytes() for it in files}


def interrupted(folder: Path) -> list[Path]:
    """The parts of a sweep that ended early."""
    with jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS) as sweep:
        rows = iter(sweep)
        while len(parts := sorted(sweep.folder.parent.glob(f"{folder.name}.parts/runs-*"))) < 3:
            next(rows)
    return parts


def expect_conflict(folder: Path, theirs: int, again: Path | None) -> list[jostle.ResultRow]:
    """Checks that a sweep into a folder adds nothing, and changes nothing; returns its rows."""
    before = contents(folder.parent)
    # Neither locks the folder.
    one, other = (jostle.sweep(SMALL, folder=folder, again=again is None) for _ in range(2))
    for execute in (one.wait, lambda: list(other)):
        with pytest.raises(jostle.Conflict, match=f"runs of version {theirs} of the model") as it:
            execute()
        expected = {"field": "folder", "model_version": theirs}
        assert it.value.details == expected | ({} if again is None else {"again": str(again)})
    assert contents(folder.parent) == before
    assert len(one.frame()) == len(one.rows())
    return one.rows()


def test_finished_results_of_an_earlier_version_remain_and_all_runs_are_executed_again(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "results"
    # `again` without results is a sweep as any other.
    first = jostle.sweep(SMALL, folder=folder, again=True).wait()
    assert first.folder == folder
    expected = tables(folder)
    theirs = of_model([folder], -1)
    beside = tmp_path / f"results-model{theirs + 1}"
    assert expect_conflict(folder, theirs, beside) == first.rows()
    before = contents(folder)
    sweep = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, again=True)
    assert sweep.rows() == []
    assert len(sweep.wait().rows()) == RUNS
    assert sweep.folder == beside
    assert tables(beside) == expected
    assert contents(folder) == before
    assert sorted(it.name for it in tmp_path.iterdir()) == ["results", beside.name]
    # The second call executes nothing.
    written = {it: it.stat().st_mtime_ns for it in beside.iterdir()}
    assert len(jostle.sweep(SMALL, folder=folder, again=True).wait().rows()) == RUNS
    assert {it: it.stat().st_mtime_ns for it in beside.iterdir()} == written
    assert len(jostle.sweep(SMALL, folder=beside).rows()) == RUNS
    expect_conflict(folder, theirs, beside)


def test_parts_of_an_earlier_version_remain_and_all_runs_are_executed_again(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    parts = interrupted(folder)
    theirs = of_model(parts, -1)
    beside = tmp_path / f"results-model{theirs + 1}"
    lines = [(part / "runs.jsonl").read_bytes().splitlines()[1:] for part in parts]
    runs = sorted(json.loads(line)["run"] for line in itertools.chain(*lines))
    assert 0 < len(runs) < RUNS
    assert sorted(row.run for row in expect_conflict(folder, theirs, beside)) == runs
    before = contents(tmp_path / "results.parts")
    # A sweep that executes them again goes on, too.
    with jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, again=True) as sweep:
        first = next(iter(sweep))
    again = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, again=True)
    assert again.folder == beside
    assert first in again.rows()
    assert len(again.wait().rows()) == RUNS
    assert tables(beside) == alone(SMALL, tmp_path)
    assert contents(tmp_path / "results.parts") == before
    assert not folder.exists()
    assert not (tmp_path / f"{beside.name}.parts").exists()


def test_parts_of_two_versions_are_not_merged(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    parts = interrupted(folder)
    theirs = of_model(parts[1:2], -1)
    # It also lacks a file; then it would be hidden, and removed by the next sweep.
    (parts[1] / "order.parquet").unlink(missing_ok=True)
    shutil.rmtree(parts[1] / "orders", ignore_errors=True)
    beside = tmp_path / f"results-model{theirs + 1}"
    assert expect_conflict(folder, theirs, beside) == []
    assert len(jostle.sweep(SMALL, folder=folder, again=True).wait().rows()) == RUNS
    assert tables(beside) == alone(SMALL, tmp_path)


def test_an_interrupted_run_of_an_earlier_version_remains(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    jostle.sweep(SMALL, folder=folder).wait()
    theirs = of_model([folder], -1)
    runs = folder / "runs.jsonl"
    lines = runs.read_bytes().splitlines(keepends=True)
    runs.write_bytes(b"".join(lines[:6]) + lines[6][:40])
    assert len(expect_conflict(folder, theirs, tmp_path / f"results-model{theirs + 1}")) == 5


def test_a_sweep_of_a_later_version_has_no_remedy(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    theirs = of_model(interrupted(folder), 1)
    assert expect_conflict(folder, theirs, None)


def test_another_experiment_is_not_executed_again(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    jostle.sweep(SMALL, folder=folder).wait()
    of_model([folder], -1)
    for again in (False, True):
        with pytest.raises(jostle.IncorrectState, match="contains another experiment"):
            jostle.sweep(SMALL.replace("seed = 3", "seed = 4"), folder=folder, again=again)
    assert [it.name for it in tmp_path.iterdir()] == ["results"]


def test_the_part_of_a_worker_with_an_earlier_version_is_rejected(tmp_path: Path) -> None:
    older = wrapper(
        tmp_path / "older",
        f"""
        {JOSTLED} "$@"
        for last; do :; done
        sed -i '1s/"model_version":[0-9]*/"model_version":1/' "$last/runs.jsonl"
        """,
    )
    folder = tmp_path / "results"
    sweep = jostle.sweep(SMALL, folder=folder, task_secs=TASK_SECS, jostled=older, again=True)
    with pytest.raises(jostle.Conflict, match="a worker has version 1 of the model") as it:
        sweep.wait()
    assert it.value.details["model_version"] == 1
    assert not list(tmp_path.glob("results*/*"))


def test_a_search_does_not_compare_values_of_two_versions(tmp_path: Path) -> None:
    experiment = 'name = "search"\nreplicates = 2\nduration = 10\nspec = { n = 8 }\n'
    folder = tmp_path / "search"
    value = jostle.Objective(experiment, "v", folder=folder)(pi1=2.0)
    (results,) = folder.iterdir()
    theirs = of_model([results], -1)
    before = contents(folder)
    beside = tmp_path / f"search-model{theirs + 1}"
    objective = jostle.Objective(experiment, "v", folder=folder)
    # Those that are there, and those that are not.
    for pi1 in (2.0, 3.0):
        with pytest.raises(jostle.Conflict, match=f"runs of version {theirs} of the model") as it:
            objective(pi1=pi1)
        assert it.value.details["model_version"] == theirs
        assert it.value.details["again"] == str(beside)
    assert contents(folder) == before
    for _ in range(2):
        second = jostle.Objective(experiment, "v", folder=folder, again=True)
        assert second(pi1=2.0) == value
        assert repr(second) == f"Objective('v' in {str(beside)!r})"
    assert second(pi1=3.0) != value
    assert contents(folder) == before
    assert len(list(beside.iterdir())) == 2
    # An interrupted one, too.
    shutil.move(results, tmp_path / "moved")
    parts = folder / f"{results.name}.parts"
    parts.mkdir()
    shutil.move(tmp_path / "moved", parts / "runs-1")
    with pytest.raises(jostle.Conflict, match=f"runs of version {theirs} of the model"):
        jostle.Objective(experiment, "v", folder=folder)(pi1=3.0)


# Some ten seconds on two cores, in many runs.
HALF = """
name = "half"
replicates = 40
duration = 500
spec = { n = 20 }
"""
WHOLE = HALF.replace("half", "whole").replace("500", "5")


@pytest.fixture(params=["stopped", "killed"])
def upgraded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Daemon, int]]:
    """A daemon after an upgrade, an unfinished and a finished experiment; their version."""
    daemon = Daemon(tmp_path)
    with jostle.connect(daemon.endpoint) as client:
        client.submit(WHOLE).wait(60.0)
        half = client.submit(HALF)
        eventually("finished runs", lambda: half.progress().finished >= 2)
    if request.param == "killed":
        daemon.kill()
    else:
        daemon.stop()
    experiments = tmp_path / "data" / "experiments"
    theirs = of_model([experiments / "half", experiments / "whole"], -1)
    daemon = Daemon(tmp_path)
    yield daemon, theirs
    daemon.kill()


def test_experiments_of_an_earlier_version_remain_and_are_executed_again(
    upgraded: tuple[Daemon, int],
) -> None:
    daemon, theirs = upgraded
    lists = [daemon.data / "experiments" / name / "runs.jsonl" for name in ("half", "whole")]
    before = [it.read_bytes() for it in lists]
    again = f"half-model{theirs + 1}"
    with jostle.connect(daemon.endpoint) as client:
        half, whole = client.experiment("half"), client.experiment("whole")
        progress = half.progress()
        assert (progress.phase, progress.model_version) == ("failed", theirs)
        assert f"{progress.finished} of 40 runs of model version {theirs}" in half._repr_html_()
        assert 2 <= progress.finished < 40
        assert len(half.rows()) == len(half.frame()) == progress.finished
        for execute in (half.resume, lambda: client.submit(HALF)):
            with pytest.raises(jostle.Conflict, match="`submit` with `again=True` executes") as it:
                execute()
            assert it.value.details["model_version"] == theirs
            assert it.value.details["again"] == again
        with pytest.raises(
            jostle.Faulted, match=f"^experiment 'half' failed.* version {theirs} "
        ) as of_wait:
            half.wait(60.0)
        assert of_wait.value.details == {"phase": "failed", "model_version": theirs}
        # A finished one is returned: nothing is added to it.
        assert client.submit(WHOLE).wait(60.0).progress().model_version == theirs
        assert len(whole.rows()) == 40
        for _ in range(2):
            assert client.submit(HALF, again=True).name == again
        assert client.submit(WHOLE, again=True).name == f"whole-model{theirs + 1}"
        second = jostle.experiment(WHOLE, client=client, again=True).wait(60.0)
        assert second.progress().model_version is None
        assert second.rows() == whole.rows()
        # Without an earlier one it is an experiment as any other.
        other = WHOLE.replace("whole", "other")
        assert client.submit(other, again=True).name == "other"

    async def submit() -> str:
        async with aio.connect(daemon.endpoint) as client:
            return (await client.submit(HALF, again=True)).name

    assert asyncio.run(submit()) == again
    assert [it.read_bytes() for it in lists] == before


def test_a_swarm_says_which_of_its_steps_an_earlier_version_computed(client: jostle.Client) -> None:
    snapshot = jostle.Snapshot.load(SNAPSHOT)
    assert (snapshot.model_version, snapshot.step, snapshot.earlier_models) == (1, 60, ())
    marks = [jostle.EarlierModel(model_version=1, epoch=1, step=60)]
    swarm = client.restore(snapshot, "old")
    swarm.step(5)
    copy = swarm.fork("copy")
    again = swarm.snapshot()
    assert again.model_version > 1
    assert again.earlier_models == tuple(marks)
    assert hash(again) == hash(jostle.Snapshot.from_bytes(again.data))
    restored = client.restore(again, "again")
    for it in (swarm, copy, restored):
        status = it.status()
        assert status.earlier_models == marks
        assert "EarlierModel(model_version=1, epoch=1, step=60)" in repr(status)
        assert "earlier_models" in status._repr_html_()
    swarms = client.swarms()
    assert [it.earlier_models for it in swarms] == [marks] * 3
    assert "earlier_models" in swarms._repr_html_()
    # Its stored history begins with the snapshot.
    assert swarm.verify().to_step == 65
    restored.reset()
    restored.step(5)
    assert restored.status().earlier_models is None
    assert restored.snapshot().earlier_models == ()
    for it in (swarm, copy, restored):
        it.delete()


def test_runs_that_start_from_a_state_of_an_earlier_version_say_so(
    client: jostle.Client, tmp_path: Path
) -> None:
    file = tmp_path / "from.toml"
    file.write_text('name = "from"\nduration = 1\nstart = "earlier.snapshot"\n', encoding="utf-8")
    snapshot = client.restore(SNAPSHOT, "old").snapshot()
    for kind, data in (("earlier", SNAPSHOT.read_bytes()), ("marked", snapshot.data)):
        (tmp_path / "earlier.snapshot").write_bytes(data)
        experiment = client.submit(file, name=kind).wait(60.0)
        progress = experiment.progress()
        assert (progress.model_version, progress.start_model_version) == (None, 1)
        assert "from a state of model version 1" in progress._repr_html_()
        with pytest.warns(RuntimeWarning, match="start from a state of version 1 of the model"):
            sweep = jostle.sweep(file, folder=tmp_path / kind)
        assert sweep.wait().rows() == experiment.rows()
        experiment.delete()
    swarm = client.swarm("old")
    swarm.reset()
    swarm.snapshot().save(tmp_path / "earlier.snapshot", force=True)
    assert client.submit(file).wait(60.0).progress().start_model_version is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jostle.sweep(file, folder=tmp_path / "now").wait()
    client.experiment("from").delete()
    swarm.delete()
