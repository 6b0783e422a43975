"""Plans the tasks of an experiment and merges their results, with the command `jostle`."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import msgspec

from . import _program
from ._errors import Internal, read_error

_ANY = b"""name = "any"
duration = 1
spec = { n = 1 }
"""


class Task(msgspec.Struct, frozen=True):
    """A line of `jostle experiment plan --emit jsonl`."""

    runs: str
    expected_secs: float
    model_version: int


class Programs:
    """Runs the `jostle` command beside `jostled` on this machine."""

    def __init__(self, jostled: str | os.PathLike[str] | None) -> None:
        self._jostle = _program.beside(_program.find(jostled), "jostle")

    def plan(self, file: Path, secs: float, done: Path) -> list[Task]:
        """Splits the runs of an experiment that are not finished in `done` into tasks of `secs`."""
        arguments = ["experiment", "plan", str(file), "--secs", repr(secs), "--emit", "jsonl"]
        arguments += ["--missing", str(done)]
        return _tasks(self._call(arguments))

    def model_version(self) -> int:
        """The version of the model of these programs."""
        arguments = ["experiment", "plan", "-", "--secs", "1", "--emit", "jsonl"]
        return _tasks(self._call(arguments, _ANY))[0].model_version

    def merge(self, parts: Path, folder: Path) -> None:
        """Merges the parts in a folder."""
        self._call(["results", "merge", str(parts), "-o", str(folder)])

    def _call(self, arguments: list[str], text: bytes = b"") -> bytes:
        command = [self._jostle, "--json", *arguments]
        done = subprocess.run(command, input=text, capture_output=True, check=False)
        if done.returncode == 0:
            return done.stdout
        *_, last = done.stderr.splitlines() or [b""]
        raise read_error(last) or Internal(done.stderr.decode(errors="replace").strip())


def _tasks(lines: bytes) -> list[Task]:
    return [msgspec.json.decode(line, type=Task) for line in lines.splitlines()]
