"""Experiments on the real daemon."""

from __future__ import annotations

import csv
import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import jostle
from conftest import Daemon
from jostle._experiment import to_toml
from jostle._wire import ExperimentResult

SMALL = {
    "name": "small",
    "seed": 3,
    "replicates": 2,
    "duration": 10,
    "grid": [{"n": np.array([3, 8]), "informed": [0, 1]}],
    "measure": {"order_every": 10},
}
ENDLESS = {"name": "endless", "duration": 1e6, "spec": {"n": 20}, "replicates": 4}


def test_a_dictionary_a_text_and_a_file_are_one_experiment(
    client: jostle.Client, tmp_path: Path
) -> None:
    experiment = jostle.experiment(SMALL, client=client, name="one")
    file = tmp_path / "small.toml"
    text = """name = "small"
seed = 3
replicates = 2
duration = 10

[[grid]]
n = [
    3,
    8,
]
informed = [
    0,
    1,
]

[measure]
order_every = 10
"""
    file.write_text(text)
    for same in (text, file, str(file)):
        assert jostle.experiment(same, client=client, name="one").name == experiment.name
    assert [progress.name for progress in client.experiments()] == ["one"]
    experiment.wait(60.0)
    experiment.delete()
    with pytest.raises(jostle.NotFound):
        experiment.progress()


def test_results_are_rows_and_a_frame_with_the_columns_of_the_table(
    daemon: Daemon, client: jostle.Client
) -> None:
    experiment = client.submit(SMALL).wait(60.0)
    progress = experiment.progress()
    assert (progress.phase, progress.finished, progress.share) == ("finished", 8, 1.0)
    rows = experiment.rows()
    frame = experiment.frame()
    table = daemon.log.parent / "data" / "experiments" / "small" / "results.csv"
    with table.open(newline="") as file:
        written = list(csv.DictReader(file))
    assert list(frame.columns) == list(written[0])
    assert [row.run for row in rows] == [row["run"] for row in written]
    assert [float(row["v"]) for row in written] == frame.v.tolist()
    assert frame.v_pd.dtype == np.float64
    assert math.isnan(frame.v_pd[0])
    assert frame.groupby("n").size().tolist() == [4, 4]
    series = experiment.order(rows[2].run)
    assert series.order.shape == series.drift.shape == series.time.shape == (51,)
    assert series.order.mean() == pytest.approx(rows[2].v, abs=0.1)
    undefined = experiment.order(rows[0].run).drift
    assert undefined.shape == (51,)
    assert np.isnan(undefined).all()
    with pytest.raises(jostle.NotFound):
        experiment.order("unknown")
    experiment.delete()


def test_measures_over_time_are_a_frame(client: jostle.Client) -> None:
    measure = {"columns": ["order", "drift"], "series_every": 200, "order_every": 100}
    experiment = client.submit({**SMALL, "name": "measured", "measure": measure}).wait(60.0)
    frame = experiment.series()
    assert list(frame.columns) == ["run", "n", "informed", "step", "time", "order", "drift"]
    # 500 steps: each run has the steps 0, 200 and 400, and the last one.
    assert frame.step.tolist() == [0, 200, 400, 500] * 8
    assert np.allclose(frame.time, frame.step * 0.02)
    assert (frame.n.unique().tolist(), frame.informed.unique().tolist()) == ([3, 8], [0, 1])
    assert frame.drift.isna().tolist() == (frame.informed == 0).tolist()
    order = experiment.order(frame.run[0]).order
    one = experiment.series(frame.run[0])
    assert one.order.tolist()[:3] == order[::2][:3].tolist()
    assert one.order.iloc[3] == order[-1]
    with pytest.raises(jostle.NotFound):
        experiment.series("unknown")
    experiment.delete()


def test_the_trajectory_of_a_run_is_a_frame(daemon: Daemon, client: jostle.Client) -> None:
    measure = {"record_every": 200}
    # 5 of the 8 individuals are informed at step 300.
    at = [{"step": 300, "inject": {"count": 5, "direction": 1.5}}]
    fields = {**SMALL, "name": "recorded", "measure": measure, "at": at}
    experiment = client.submit(fields).wait(60.0)
    run = "n=3 informed=1 #1"
    frame = experiment.trajectory(run)
    columns = ["run", "n", "informed_of_run", "step", "time", "id", "x", "y", "alpha", "informed"]
    assert list(frame.columns) == columns
    # 500 steps: 0, 200, 400 and the last one.
    assert frame.groupby("step").size().to_dict() == {0: 3, 200: 3, 400: 8, 500: 8}
    assert np.allclose(frame.time, frame.step * 0.02)
    assert frame.groupby("step").informed.sum().to_dict() == {0: 1, 200: 1, 400: 6, 500: 6}
    last = frame[frame.step == 500]
    assert last.id.tolist() == list(range(8))
    assert (str(frame.id.dtype), str(frame.informed.dtype)) == ("uint32", "bool")
    rows = {row.run: row for row in experiment.rows()}
    assert frame.attrs["seed"] == str(rows[run].seed)
    assert msgspec.json.decode(frame.attrs["spec"])["n"] == 3
    assert msgspec.json.decode(frame.attrs["variables"]) == {"n": 3, "informed": 1}
    folder = daemon.log.parent / "data" / "experiments" / "recorded" / "trajectories"
    assert len(list(folder.iterdir())) == 8
    with pytest.raises(jostle.NotFound):
        experiment.trajectory("unknown")
    experiment.delete()
    assert not folder.exists()
    other = client.submit({**SMALL, "name": "unrecorded"}).wait(60.0)
    with pytest.raises(jostle.InvalidArgument, match="record_every"):
        other.trajectory(run)
    other.delete()


def test_faulted_runs_have_a_reason(client: jostle.Client) -> None:
    # There is no room for the individuals at step 20 in one of the two conditions.
    inject = {"count": "$count", "within": {"x": 0, "y": 0, "radius": 10}}
    experiment = client.submit(
        {
            "name": "faulted",
            "duration": 1,
            "spec": {"n": 4},
            "grid": [{"count": [1, 5000]}],
            "at": [{"step": 20, "inject": inject}],
        }
    ).wait(60.0)
    assert experiment.progress().faulted == 1
    whole, faulted = experiment.rows()
    assert whole.fault is None
    assert faulted.fault is not None
    assert faulted.fault.startswith("step 20: [[at]]")
    frame = experiment.frame()
    assert frame.columns[-1] == "fault"
    assert frame.fault.isna().tolist() == [True, False]
    experiment.delete()


def test_an_experiment_is_paused_resumed_and_cancelled(client: jostle.Client) -> None:
    experiment = client.submit(ENDLESS)
    assert experiment.pause().phase == "paused"
    with pytest.raises(jostle.IncorrectState, match="cancel it first"):
        experiment.delete()
    with pytest.raises(jostle.DeadlineExceeded):
        experiment.wait(0.6)
    assert experiment.resume().phase in ("queued", "running")
    assert experiment.cancel().phase == "cancelled"
    with pytest.raises(jostle.IncorrectState, match="was cancelled, 0 of 4"):
        experiment.wait()
    assert client.submit(ENDLESS).progress().phase in ("queued", "running")
    with pytest.raises(jostle.AlreadyExists):
        client.submit(SMALL, name="endless")
    experiment.cancel()
    experiment.delete()


def test_an_invalid_experiment_is_rejected(client: jostle.Client, tmp_path: Path) -> None:
    with pytest.raises(jostle.InvalidArgument, match="line 2") as caught:
        client.submit("name = 'a'\nduration = -1\nspec = { n = 3 }\n")
    assert caught.value.details["field"] == "submit.toml"
    with pytest.raises(jostle.InvalidArgument, match="has no form in TOML: use numbers"):
        client.submit({"name": object()})
    with pytest.raises(FileNotFoundError):
        client.submit(tmp_path / "nowhere.toml")
    with pytest.raises(jostle.InvalidArgument):
        client.experiment("a/b")


def test_an_experiment_outlives_its_client(daemon: Daemon, client: jostle.Client) -> None:
    source = {**SMALL, "grid": [{"n": [3, 8]}]}
    program = f"""
import jostle
jostle.experiment({source!r}, name="left", endpoint="{daemon.endpoint}")
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
    assert client.experiment("left").wait(60.0).progress().finished == 4
    client.experiment("left").delete()


def test_a_bar_shows_the_progress(
    client: jostle.Client, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment = client.submit(SMALL, name="shown")
    experiment.wait(60.0, show=True)
    assert "8 of 8 runs" in capsys.readouterr().err
    experiment.delete()


def test_points_are_sent_with_the_file(client: jostle.Client, tmp_path: Path) -> None:
    toml = """name = "points"
duration = 2
points = "samples.csv"
[spec]
n = 5
[[at]]
time = 1
inform = { select = { count = "$k" }, direction = 0 }
"""
    (tmp_path / "points.toml").write_text(toml)
    samples = tmp_path / "samples.csv"
    samples.write_text("pi1,k\n2,1\n4,2\n4,3\n")
    experiment = jostle.experiment(tmp_path / "points.toml", client=client).wait(60.0)
    frame = experiment.frame()
    assert frame[["pi1", "k"]].to_numpy().tolist() == [[2, 1], [4, 2], [4, 3]]
    assert client.submit(tmp_path / "points.toml").name == "points"
    samples.write_text("pi1,k\n2,1\n4,2\n")
    with pytest.raises(jostle.AlreadyExists):
        client.submit(tmp_path / "points.toml")
    samples.write_text("pi1,k\n2,1\n4,2\n,3\n")
    with pytest.raises(jostle.InvalidArgument, match=r"samples\.csv, line 4, column 1: ") as caught:
        client.submit(tmp_path / "points.toml", name="other")
    assert caught.value.details == {"field": "submit.points", "line": 4}
    samples.unlink()
    with pytest.raises(FileNotFoundError):
        client.submit(tmp_path / "points.toml")
    experiment.delete()


def test_only_the_copy_of_an_experiment_takes_the_copies_beside_it(
    client: jostle.Client, tmp_path: Path
) -> None:
    (tmp_path / "own.csv").write_text("pi1\n2\n")
    # As in a folder of results.
    (tmp_path / "experiment.points.csv").write_text("pi1\n4\n")
    for file, pi1 in (("study.toml", 2.0), ("experiment.toml", 4.0)):
        text = 'name = "copies"\nduration = 1\nspec = { n = 3 }\npoints = "own.csv"\n'
        (tmp_path / file).write_text(text)
        experiment = client.submit(tmp_path / file).wait(60.0)
        assert [row.pi1 for row in experiment.rows()] == [pi1]
        experiment.delete()


def test_files_outside_the_folder_have_a_warning_and_are_not_quoted(
    client: jostle.Client, tmp_path: Path
) -> None:
    text = 'name = "outside"\nduration = 1\nspec = { n = 5 }\npoints = "../secret.csv"\n'
    secret = tmp_path / "secret.csv"
    secret.write_text("marmot:x:0:0\n1\n")
    folder = tmp_path / "folder"
    folder.mkdir()
    for points in ("../secret.csv", str(secret)):
        (folder / "a.toml").write_text(text.replace("../secret.csv", points))
        warned = pytest.warns(RuntimeWarning, match=r"^points = .* is outside the folder")
        with (
            warned as found,
            pytest.raises(jostle.InvalidArgument, match="copy it there") as caught,
        ):
            client.submit(folder / "a.toml")
        assert found[0].filename == __file__
        assert "marmot" not in str(caught.value)
        assert "line 1, column 1" in str(caught.value)


def test_a_file_without_an_end_is_not_read_whole(client: jostle.Client, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('points = "/dev/zero"\n')
    with pytest.raises(OSError, match="more than 250 MB"):
        client.submit(tmp_path / "a.toml")


def test_axes_without_a_field_of_a_row_are_columns_of_the_frame(
    daemon: Daemon, client: jostle.Client
) -> None:
    fields: dict[str, Any] = {
        "grid": [
            {"n": 3, "noise": [0, 0.25], "relinearise": [0, 1]},
            {"n": 4, "informed_fraction": 0.5, "attraction": [{"kind": "metric", "radius": 2}]},
        ],
    }
    whole = client.submit({"name": "bare", "duration": 0.2, **fields}).wait(60.0).frame()
    named = ["informed_fraction", "relinearise", "attraction", "noise"]
    assert list(whole.columns[-4:]) == named
    assert len(whole.groupby(["pi1", "noise", "relinearise"])) == 4
    assert whole.attraction.tolist() == ["all"] * 4 + ["metric:2"]
    data = daemon.log.parent / "data" / "experiments"
    with (data / "bare" / "results.csv").open(newline="") as file:
        header, *written = csv.reader(file)
    assert header == list(whole.columns)
    numbers = [name for name in named if name != "attraction"]
    for name in numbers:
        column = [row[header.index(name)] for row in written]
        assert [None if it == "" else float(it) for it in column] == [
            None if it != it else it for it in whole[name]
        ]
    read = jostle.read_table(data / "bare" / "results.parquet")
    assert read[named].equals(whole[named])
    endless = client.submit({"name": "bare_without_rows", "duration": 1e6, **fields})
    empty = endless.frame()
    assert (len(empty), list(empty.columns)) == (0, list(whole.columns))
    assert {empty[name].dtype for name in numbers} == {np.dtype(np.float64)}
    endless.cancel()
    endless.delete()


def test_a_table_before_the_first_result_has_all_columns(client: jostle.Client) -> None:
    fields: dict[str, Any] = {
        "seed": 3,
        "replicates": 2,
        "grid": [{"n": 8, "k": [1, 2]}],
        "measure": {"columns": ["drift", "milling"], "series_every": 5},
        "stop": {"when": "order > 0.9999 for 1e5"},
        "at": [{"time": 0, "inform": {"select": {"count": "$k"}, "direction": 0}}],
    }
    short = client.submit({"name": "short", "duration": 0.2, **fields}).wait(60.0)
    endless = client.submit({"name": "without_rows", "duration": 1e6, **fields})
    assert endless.rows() == []
    for whole, empty in [(short.frame(), endless.frame()), (short.series(), endless.series())]:
        assert len(empty) == 0 < len(whole)
        assert list(empty.columns) == list(whole.columns)
        for column in ("drift", "time"):
            assert empty[column].dtype == whole[column].dtype == np.float64
    assert list(short.frame().columns[-4:]) == ["k", "stopped_at", "drift", "milling"]
    assert list(short.series().columns) == ["run", "n", "k", "step", "time", "drift", "milling"]
    endless.cancel()
    endless.delete()


def test_the_commands_of_a_block_keep_the_order_of_a_mapping(client: jostle.Client) -> None:
    inform = {"select": {"count": 3}, "direction": np.float64(0.5)}
    remove = [{"select": {"ids": [0]}}, {"select": {"count": 1}}]
    source: dict[str, Any] = {"name": "ordered", "duration": 2, "spec": {"n": 8}, "seeds": [5]}
    hashes = []
    for number, block in enumerate(
        [
            {"inform": inform, "time": 1, "remove": remove},
            {"time": 1, "remove": remove, "inform": inform},
        ]
    ):
        mapping = {**source, "at": [block, {"time": 1.5, "set": {"noise": 0.0}}], "stop": {}}
        read = tomllib.loads(to_toml(mapping))
        assert [list(it) for it in read["at"]] == [list(block), ["time", "set"]]
        assert read == {
            **mapping,
            "at": [{**block, "inform": {**inform, "direction": 0.5}}, *mapping["at"][1:]],
        }
        experiment = client.submit(mapping, name=f"ordered-{number}").wait(60.0)
        hashes.append(experiment.rows()[0].state_hash)
        experiment.delete()
    text = """name = "ordered"
duration = 2
spec = { n = 8 }
seeds = [5]
[[at]]
time = 1
inform = { select = { count = 3 }, direction = 0.5 }
remove = [{ select = { ids = [0] } }, { select = { count = 1 } }]
[[at]]
time = 1.5
set = { noise = 0.0 }
"""
    experiment = client.submit(text, name="ordered-text").wait(60.0)
    assert hashes[0] == experiment.rows()[0].state_hash != hashes[1]
    experiment.delete()


def test_a_snapshot_is_sent_with_the_file(client: jostle.Client, tmp_path: Path) -> None:
    swarm = client.create("grown", jostle.Spec(n=9, seed=4))
    swarm.step(100)
    swarm.snapshot().save(tmp_path / "grown.snapshot")
    source = {
        "name": "grown",
        "duration": 2,
        "start": "grown.snapshot",
        "grid": [{"noise": [0, 1]}],
    }
    file = tmp_path / "grown.toml"
    file.write_text(to_toml(source))
    experiment = client.submit(file).wait(60.0)
    rows = experiment.rows()
    assert [(row.n, row.steps) for row in rows] == [(9, 100), (9, 100)]
    swarm.step(100)
    assert client.submit(file).name == "grown"
    swarm.snapshot().save(tmp_path / "grown.snapshot", force=True)
    with pytest.raises(jostle.AlreadyExists):
        client.submit(file)
    (tmp_path / "grown.snapshot").write_bytes(b"no snapshot")
    with pytest.raises(jostle.InvalidArgument, match=r"line 3, column 9: .*not a snapshot"):
        client.submit(file, name="other")
    with pytest.raises(jostle.InvalidArgument, match="are missing"):
        client._command(
            "experiment", {"submit": {"toml": to_toml(source)}}, ExperimentResult, None, None
        )
    experiment.delete()
    swarm.delete()
