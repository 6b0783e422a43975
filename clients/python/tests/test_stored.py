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
