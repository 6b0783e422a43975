"""Plans the tasks of an experiment and merges their results, with the command `jostle`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import msgspec

from . import _program
from ._errors import Conflict, Internal, InvalidArgument, NotFound, StorageFull


class Task(msgspec.Struct, frozen=True):
    """A line of `jostle experiment plan --emit jsonl`."""

    runs: str
    expected_secs: float
    model_version: int


class Programs:
    """Runs the `jostle` command beside `jostled` on this machine."""

    def __init__(self, jostled: str | None) -> None:
        self._jostle = _program.beside(_program.find(jostled), "jostle")

    def plan(self, file: Path, secs: float, done: Path) -> list[Task]:
        """Splits the runs of an experiment that are not finished in `done` into tasks of `secs`."""
        arguments = ["experiment", "plan", str(file), "--secs", repr(secs), "--emit", "jsonl"]
        arguments += ["--missing", str(done)]
        lines = self._call(arguments).splitlines()
        return [msgspec.json.decode(line, type=Task) for line in lines]

    def merge(self, parts: Path, folder: Path) -> None:
        """Merges the parts in a folder."""
        self._call(["results", "merge", str(parts), "-o", str(folder)])

    def _call(self, arguments: list[str]) -> bytes:
        command = [self._jostle, *arguments]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        if done.returncode == 0:
            return done.stdout
        message = done.stderr.decode(errors="replace").strip().removeprefix("jostle: ")
        codes = {2: InvalidArgument, 3: NotFound, 4: Conflict, 8: StorageFull}
        raise codes.get(done.returncode, Internal)(message)
