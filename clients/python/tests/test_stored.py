"""This package reads recordings and results stored by earlier builds."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jostle

STORED = Path(__file__).parents[3] / "tests" / "stored"
BUILDS = sorted(path.parent for path in STORED.glob("*/expected.json"))


def test_stored_builds_exist() -> None:
    assert "bf41dde" in [build.name for build in BUILDS]


@pytest.mark.parametrize("build", BUILDS, ids=lambda build: build.name)
def test_recordings_of_an_earlier_build_are_read(build: Path) -> None:
    listed = json.loads((build / "expected.json").read_text())["recordings"]["recordings"]
    frames = {recording["recording"]: recording["frames"] for recording in listed}
    recordings = build / "data" / "recordings"
    film = list(jostle.read_recording(recordings / "film"))
    table = list(jostle.read_recording(recordings / "table"))
    client = list(jostle.read_recording(build / "filmed.mcap"))
    assert (len(film), len(table)) == (frames["film"], frames["table"])
    assert len(client) > 1
    for one, other in zip(film, table, strict=True):
        assert (one.step, one.time) == (other.step, other.time)
        assert (one.x == other.x).all()
        assert (one.y == other.y).all()
        assert one.swarm == other.swarm
        assert np.array_equal(one.informed, other.informed)
        for recorded in (one, other):
            assert np.isnan(recorded.direction[~recorded.informed]).all()
        assert np.array_equal(one.direction, other.direction, equal_nan=True)
    assert film[-1].step == 1000
    rows = jostle.read_recording(recordings / "table").frame()
    assert len(rows) > 0
    assert not rows.informed.any()
    for column in ("direction", "drift"):
        assert rows[column].isna().all()
    # The first build did not write the phase into the table.
    assert rows.phase.isna().all() == (build.name == "bf41dde")


@pytest.mark.parametrize("build", BUILDS, ids=lambda build: build.name)
def test_results_of_an_earlier_build_are_read(build: Path) -> None:
    table = pd.read_parquet(build / "results" / "results.parquet")
    text = pd.read_csv(build / "results" / "results.csv")
    assert len(table) == len(text) == 16
    assert list(table.columns) == list(text.columns)
    assert list(table["run"]) == list(text["run"])


def test_a_variable_named_fault_is_renamed() -> None:
    """Tables of earlier builds, with two columns of that name, are read with both."""
    table = jostle.read_table(STORED / "accepted" / "small" / "results.parquet")
    assert list(table.columns[-2:]) == ["fault_", "fault"]
    assert list(table["fault_"]) == [1, 3]
    assert table["fault"][1].startswith("step 75: ")


def test_the_frames_of_a_folder_are_those_of_all_its_parts() -> None:
    recording = jostle.read_recording(STORED / "1a581a9" / "data" / "recordings" / "film")
    frames = sum(1 for _ in recording)
    assert frames > 1
    assert recording.about["frames"] == str(frames)
