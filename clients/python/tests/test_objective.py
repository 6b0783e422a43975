"""A search over the parameters of an experiment, with real runs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS

pytestmark = pytest.mark.usefixtures("jostled_named")

EXPERIMENT = """
name = "search"
seed = 2
replicates = 2
duration = 10
[spec]
n = 8
"""


def times(folder: Path) -> dict[Path, int]:
    return {file: file.stat().st_mtime_ns for file in folder.rglob("*")}


def test_values_are_those_of_the_experiment_with_them(tmp_path: Path) -> None:
    objective = jostle.Objective(EXPERIMENT, "v_pd", folder=tmp_path / "search")
    value = objective(pi1=2.0, noise=0.1, informed=3)
    file = tmp_path / "one.toml"
    file.write_text(
        f"{EXPERIMENT}pi1 = 2.0\nnoise = 0.1\n[[grid]]\ninformed = 3\n", encoding="utf-8"
    )
    command: list[str | Path] = [JOSTLED, "run", file, "-o", tmp_path / "one"]
    subprocess.run(command, check=True, capture_output=True, timeout=MAX_WAIT_SECS)
    rows = (tmp_path / "one" / "results.csv").read_text().splitlines()
    column = rows[0].split(",").index("v_pd")
    assert value == pytest.approx(sum(float(row.split(",")[column]) for row in rows[1:]) / 2)
    # The same values are not computed again, in any order and by another object.
    before = times(tmp_path / "search")
    again = jostle.Objective(EXPERIMENT, "v_pd", folder=tmp_path / "search")
    assert again(noise=0.1, informed=3.0, pi1=2) == value
    assert times(tmp_path / "search") == before
    assert again(informed=4, pi1=2.0, noise=0.1) != value
    assert len(list((tmp_path / "search").iterdir())) == 2


def test_a_column_that_the_file_adds_is_an_objective(tmp_path: Path) -> None:
    added = f'{EXPERIMENT}[measure]\ncolumns = ["milling", "clusters.count(0.1)"]\n'
    objective = jostle.Objective(added, "clusters.count(0.1)", folder=tmp_path)
    value = objective(pi1=2.0)
    found = [{it.name: it.value for it in row.extra or ()} for row in objective.rows(pi1=2.0)]
    assert value == sum(it["clusters.count(0.1)"] or 0.0 for it in found) / 2
    assert value >= 1.0
    with pytest.raises(jostle.InvalidArgument, match="add it to `columns`"):
        jostle.Objective(added, "clusters.count(0.2)", folder=tmp_path)


def test_a_value_of_the_spec_keeps_the_seeds(tmp_path: Path) -> None:
    objective = jostle.Objective(EXPERIMENT, "v", folder=tmp_path)
    one, other = objective.rows(pi1=2.0), objective.rows(pi1=3.0)
    assert [row.seed for row in one] == [row.seed for row in other]
    assert [row.pi1 for row in (*one, *other)] == [2.0, 2.0, 3.0, 3.0]


def test_a_value_replaces_an_axis_of_the_file_and_keeps_the_seeds(tmp_path: Path) -> None:
    experiment = f"{EXPERIMENT}[[grid]]\npi1 = [2, 3]\n"
    objective = jostle.Objective(experiment, "v", folder=tmp_path / "search")
    one, other = objective.rows(pi1=2.0), objective.rows(pi1=3.0)
    assert [row.run for row in one] == ["#0", "#1"]
    assert [row.seed for row in one] == [row.seed for row in other]
    with jostle.sweep(experiment, folder=tmp_path / "whole") as sweep:
        of_file = [row for row in sweep.wait().rows() if row.pi1 == 2.0]
    assert [row.run for row in of_file] == ["pi1=2 #0", "pi1=2 #1"]
    assert not {row.seed for row in of_file} & {row.seed for row in one}


def test_invalid_searches_are_errors(tmp_path: Path) -> None:
    with pytest.raises(
        jostle.InvalidArgument,
        match=r"unknown measure 'speed': use one of seed, n,.* or add it to `columns`",
    ):
        jostle.Objective(EXPERIMENT, "speed", folder=tmp_path)
    with pytest.raises(jostle.InvalidArgument, match="invalid experiment: "):
        jostle.Objective("name = \n=", "v", folder=tmp_path)
    objective = jostle.Objective(EXPERIMENT, "v_pd", folder=tmp_path)
    with pytest.raises(
        jostle.InvalidArgument, match=r"^the experiment with n=4, pi1=-1.0: run .#0.: pi1 = -1.0"
    ):
        objective(n=4, pi1=-1.0)
    for value in (None, [1], float("nan"), 10**400):
        with pytest.raises(
            jostle.InvalidArgument, match=r"^pi1 is .* a finite number or text"
        ) as it:
            objective(pi1=value)  # type: ignore[arg-type]
        assert it.value.details == {"field": "pi1"}
    with pytest.raises(jostle.InvalidArgument, match="exclude each other"):
        objective(informed=1, informed_fraction=0.5)
    # The line number of the generated file means nothing to the caller.
    with pytest.raises(
        jostle.InvalidArgument, match=r"^the experiment with colour='red': colour: unknown field"
    ):
        objective(colour="red")
    file = tmp_path / "wrong.toml"
    file.write_text(EXPERIMENT.replace("n = 8", "n = 8\npi1 = 0"), encoding="utf-8")
    with pytest.raises(
        jostle.InvalidArgument, match=rf"^{re.escape(str(file))}: run .#0.: pi1 = 0"
    ):
        jostle.Objective(file, "v", folder=tmp_path)()
    with pytest.raises(
        jostle.Faulted, match=r"no finite .v_pd. in 2 of 2 runs.*v_pd needs informed"
    ):
        objective(pi1=2.0)


@pytest.mark.slow
def test_a_killed_study_continues(tmp_path: Path) -> None:
    script = Path(__file__).parents[1] / "examples" / "threshold.py"
    command: list[str | Path] = [sys.executable, script, tmp_path, "--trials"]
    killed = subprocess.Popen([*command, "16"], stdout=subprocess.PIPE, text=True)
    assert killed.stdout is not None
    with killed.stdout:
        first = killed.stdout.readline()
        killed.kill()
        killed.wait()
    assert " informed: drift " in first
    before = times(tmp_path / "experiments")
    done = subprocess.run(
        [*command, "3"], check=True, capture_output=True, text=True, timeout=4 * MAX_WAIT_SECS
    )
    # The first trial is in the study, and its results are not computed again.
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    assert lines[-1].endswith(str(tmp_path / "threshold.svg"))
    assert "<svg" in (tmp_path / "threshold.svg").read_text()
    kept = {file: time for file, time in before.items() if file.name == "results.csv"}
    assert kept
    after = times(tmp_path / "experiments")
    assert {file: after[file] for file in kept} == kept
