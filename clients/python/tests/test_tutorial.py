"""The tutorial runs from its first cell to its last."""

from __future__ import annotations

import re
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from conftest import JOSTLED

TUTORIAL = Path(__file__).resolve().parents[1] / "examples" / "tutorial.ipynb"


def read() -> Any:
    v4: Any = nbformat.v4
    text = TUTORIAL.read_text(encoding="utf-8")
    notebook = v4.reads(text)
    # Writing it again changes nothing: it contains no output and no editor metadata.
    assert v4.writes(notebook) + "\n" == text
    return notebook


def test_the_tutorial_is_stored_without_outputs() -> None:
    for number, cell in enumerate(read().cells):
        assert cell.id == f"cell-{number + 1:02}"
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)


def installed_with(package: str, extra: str) -> dict[str, metadata.Distribution]:
    """The names of the distributions that `pip install package[extra]` installs."""
    found: dict[str, metadata.Distribution] = {}
    wanted, seen = [(package, extra)], set()
    while wanted:
        name, extra = wanted.pop()
        if (canonicalize_name(name), extra) in seen:
            continue
        seen.add((canonicalize_name(name), extra))
        distribution = metadata.distribution(name)
        found[canonicalize_name(name)] = distribution
        for line in distribution.requires or []:
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
                wanted += [(requirement.name, it) for it in ["", *requirement.extras]]
    return found


def test_the_notebook_extra_installs_what_the_tutorial_needs() -> None:
    found = installed_with("jostle", "notebook")
    programs = {
        entry.name
        for distribution in found.values()
        for entry in distribution.entry_points
        if entry.group == "console_scripts"
    }
    text = TUTORIAL.read_text(encoding="utf-8")
    (command,) = re.findall(r"    (jupyter \w+) clients/python/examples/tutorial.ipynb", text)
    assert command.replace(" ", "-") in programs
    assert "jupyter-nbconvert" in programs
    # The kernel, what the cells import, and the tables of experiments.
    code = "\n".join(cell.source for cell in read().cells if cell.cell_type == "code")
    imported = set(re.findall(r"^(?:import|from) (\w+)", code, re.M)) | {"pandas", "ipykernel"}
    assert imported <= found.keys(), imported - found.keys()
    assert "pip install './clients/python[notebook]'" in text


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.slow
def test_the_tutorial_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("JOSTLED", str(JOSTLED))
    notebook = read()
    began = time.monotonic()
    NotebookClient(
        notebook, timeout=60, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    assert time.monotonic() - began < 60.0
    kinds = []
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            # Warnings would be in the output as well.
            assert output.get("name") != "stderr", output.text
            kinds += list(output.get("data", {}))
    assert kinds.count("image/png") == 4
    pictures = [
        output.data["text/html"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "<svg" in output.get("data", {}).get("text/html", "")
    ]
    # Pictures at the start, in the view, and of the group moving east.
    assert len(pictures) == 3
    assert "step 2000" in pictures[1]
    assert "10 informed" in pictures[2]
