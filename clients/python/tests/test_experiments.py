"""Experiments on the real daemon."""

from __future__ import annotations

import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jostle
from conftest import Daemon

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
    assert experiment.order(rows[0].run).drift.shape == (0,)
    with pytest.raises(jostle.NotFound):
        experiment.order("unknown")
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
