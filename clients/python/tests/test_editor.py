"""The JSON Schema of an experiment's file, as editors read it.

taplo is what editors of TOML use, and jsonschema a reader of schemas that is independent of it.
The unit tests of `crates/experiment` compare the schema with the parser.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from conftest import JOSTLED, MAX_WAIT_SECS, ROOT
from test_docs import BLOCKS

TAPLO = Path(sys.executable).with_name("taplo")
CASES = tomllib.loads(
    (ROOT / "crates/experiment/src/schema/cases.toml").read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def schema(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that a user makes. No daemon is running."""
    ran = subprocess.run(
        [JOSTLED.with_name("jostle"), "schema", "experiment.file"],
        env={**os.environ, "JOSTLE_ENDPOINT": "tcp/127.0.0.1:1"},
        capture_output=True,
        text=True,
        timeout=MAX_WAIT_SECS,
        check=True,
    )
    path = tmp_path_factory.mktemp("editor") / "experiment.schema.json"
    path.write_text(ran.stdout, encoding="utf-8")
    return path


def experiments() -> dict[str, str]:
    """The experiments of the repository: files, and blocks of the pages."""
    # Those in `accepted` are read as stored only.
    stored = ROOT.glob("tests/stored/**/experiment.toml")
    stored = (path for path in stored if "accepted" not in path.parts)
    paths = [*ROOT.glob("paper/*.toml"), *stored]
    texts = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}
    texts |= {
        str(block): block.code
        for blocks in BLOCKS.values()
        for block in blocks
        if block.kind == "toml"
    }
    return {
        name: text
        for name, text in texts.items()
        if {"name", "duration"} <= tomllib.loads(text).keys()
    }


def cases(*kinds: str) -> dict[str, str]:
    """The files of these kinds in the list of the unit tests."""
    return {
        f"{kind} {number}": case["file"]
        for kind in kinds
        for number, case in enumerate(CASES[kind])
    }


def in_json(value: Any) -> Any:
    """A value of TOML, as editors convert it: NaN and infinite numbers are null."""
    match value:
        case dict():
            return {key: in_json(it) for key, it in value.items()}
        case list():
            return [in_json(it) for it in value]
        case float() if not math.isfinite(value):
            return None
        case bool() | int() | float() | str():
            return value
        case _:
            return str(value)


def lint(folder: Path, files: dict[str, str], *options: str, first_line: str = "") -> set[str]:
    """The names of the files that taplo rejects."""
    paths = {folder / f"{number}.toml": name for number, name in enumerate(files)}
    for path, name in paths.items():
        path.write_text(first_line + files[name], encoding="utf-8")
    ran = subprocess.run(
        [TAPLO, "lint", "--no-auto-config", *options, *paths],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=MAX_WAIT_SECS,
        check=False,
    )
    # It may end before it has written its last line of log, which names the file.
    found = re.findall(r"┌─ (.+):\d+:\d+$", ran.stderr, re.MULTILINE)
    assert (ran.returncode == 0) == (not found), ran.stderr
    return {paths[Path(path)] for path in found}


def test_jsonschema_accepts_and_rejects_the_files_of_the_list(schema: Path) -> None:
    document = json.loads(schema.read_text(encoding="utf-8"))
    assert document["$schema"] == "http://json-schema.org/draft-07/schema#"
    jsonschema.Draft7Validator.check_schema(document)
    validator = jsonschema.Draft7Validator(document)
    files = {**cases("accepted", "parser", "rejected"), **experiments()}
    rejected = {
        name for name, text in files.items() if not validator.is_valid(in_json(tomllib.loads(text)))
    }
    assert rejected == cases("rejected").keys()


def test_taplo_accepts_the_experiments_of_the_repository(schema: Path, tmp_path: Path) -> None:
    files = {**cases("accepted", "parser"), **experiments()}
    assert len(experiments()) > 10
    assert lint(tmp_path, files, "--schema", schema.as_uri()) == set()


def test_taplo_rejects_what_it_is_to_reject_by_the_line_that_names_the_schema(
    schema: Path, tmp_path: Path
) -> None:
    (tmp_path / schema.name).write_bytes(schema.read_bytes())
    files = cases("rejected")
    rejected = lint(tmp_path, files, first_line=f"#:schema ./{schema.name}\n")
    assert rejected == files.keys()
