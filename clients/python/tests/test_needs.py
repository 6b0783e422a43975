"""A test that cannot judge anything on this machine fails, unless it may be skipped."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent


def run(
    folder: Path, *line: str, may_skip: str, **variables: str
) -> subprocess.CompletedProcess[str]:
    environment = {
        **os.environ,
        "JOSTLE_MAY_SKIP": may_skip,
        "JOSTLE_SKIPPED": str(folder / "skipped"),
        "PYTHONPATH": os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]),
        **variables,
    }
    command = [sys.executable, "-m", *line]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def recorded(folder: Path) -> str:
    file = folder / "skipped"
    return file.read_text() if file.exists() else ""


@pytest.mark.parametrize(
    ("reason", "may_skip", "code", "record"),
    [
        ("needs mount: run it as root", "", 1, ""),
        ("needs mount: run it as root", "faketime,mounts", 1, ""),
        ("needs mount: run it as root", "faketime, mount", 0, "mount: test_it.py::test_it\n"),
        ("not today", "mount", 1, ""),
    ],
)
def test_a_skipped_test_fails_the_run_unless_it_may_be_skipped(
    tmp_path: Path, reason: str, may_skip: str, code: int, record: str
) -> None:
    (tmp_path / "conftest.py").write_text("from needs import pytest_sessionfinish\n")
    (tmp_path / "test_it.py").write_text(
        f"import pytest\n\n\ndef test_it():\n    pytest.skip({reason!r})\n"
    )
    ended = run(tmp_path, "pytest", "-q", "-c", os.devnull, "--rootdir", ".", may_skip=may_skip)
    assert ended.returncode == code, ended.stdout
    assert recorded(tmp_path) == record
    if code == 1:
        assert "test_it.py::test_it" in ended.stdout
        assert ("this test needs mount: run it as root" in ended.stdout) == ("needs" in reason)


def test_the_chaos_test_fails_without_mount_unless_it_may_be_skipped(
    tmp_path: Path,
) -> None:
    # Without `unshare` on its path the chaos test cannot mount its disk.
    nowhere = {"PATH": str(tmp_path)}
    ended = run(tmp_path, "chaos", may_skip="faketime", **nowhere)
    assert ended.returncode == 1, ended.stdout
    assert "this test needs mount: " in ended.stderr
    assert recorded(tmp_path) == ""
    ended = run(tmp_path, "chaos", may_skip="faketime,mount", **nowhere)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "skipped, needs mount\n"
    assert recorded(tmp_path) == "mount: the chaos test\n"
