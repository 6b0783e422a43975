"""A copy of the tree below target/mutants, in which mutants are applied."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .texts import ROOT, project_files

# The limit of one test; a test that a mutant makes wait for ever proves nothing.
TIMEOUT_SECS = 600.0
_FOLDER = ROOT / "target" / "mutants"
_PACKAGES = {
    "proto": "jostle-proto",
    "proto/contract": "jostle-contract",
    "tests": "jostled-tests",
    "clients/cli": "jostle-cli",
    "clients/rust": "jostle-client",
    "crates/atomic-file": "jostle-atomic-file",
    "crates/conditions": "jostle-conditions",
    "crates/convert": "jostle-convert",
    "crates/experiment": "jostle-experiment",
    "crates/measures": "jostle-measures",
    "crates/physics": "jostle-physics",
    "crates/results": "jostle-results",
    "crates/wasm": "jostle-wasm",
}


class Place:
    """The copy, its target directory, and the build results copied from the tree."""

    def __init__(self) -> None:
        self.tree = _FOLDER / "tree"
        self.target = _FOLDER / "target"
        self.built = ROOT / "target" / "release"
        self.python = str(ROOT / "target" / "venv" / "bin" / "python")

    def prepare(self) -> None:
        """Updates the copy, and the build results copied from the tree."""
        self.tree.mkdir(parents=True, exist_ok=True)
        self._lock()
        wanted = set(project_files(ROOT))
        for path in wanted:
            self._copy(path)
        for path in set(project_files(self.tree)) - wanted:
            (self.tree / path).unlink()
        modules = self.tree / "clients/web/node_modules"
        if not modules.is_symlink():
            modules.symlink_to(ROOT / "clients/web/node_modules")

    def _lock(self) -> None:
        """Ends this program if another one uses the copy. Its end releases the lock."""
        self._held = (_FOLDER / "lock").open("w")
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            sys.exit(f"another tests/mutants/run uses {_FOLDER}: wait for its end")

    def _copy(self, path: Path) -> None:
        source, copy = ROOT / path, self.tree / path
        if _is_same(source, copy):
            return
        if not copy.exists() or copy.read_bytes() != source.read_bytes():
            self._forget(path)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, copy)

    def take_over_builds(self) -> None:
        """Copies what cargo has compiled from the tree: only changed packages are compiled."""
        release = self.target / "release"
        for folder in ("deps", "build", ".fingerprint"):
            for name, _, files in os.walk(self.built / folder):
                inner = Path(name).relative_to(self.built)
                (release / inner).mkdir(parents=True, exist_ok=True)
                # Test executables are linked again.
                is_wanted = folder != "deps"
                for file in files:
                    source, copy = Path(name, file), release / inner / file
                    if (is_wanted or "." in file) and not _is_same(source, copy):
                        shutil.copy2(source, copy)
        for program in ("jostled", "jostle"):
            if (self.built / program).exists():
                shutil.copy2(self.built / program, release / program)

    @contextmanager
    def changed(self, files: dict[str, str]) -> Iterator[None]:
        """Writes these texts into the copy, and restores the original ones in any case."""
        before = {path: (self.tree / path).read_bytes() for path in files}
        times = {path: (self.tree / path).stat() for path in files}
        try:
            for path, text in files.items():
                (self.tree / path).write_text(text, encoding="utf-8")
            yield
        finally:
            for path, content in before.items():
                # First, so that cargo does not mistake a build of the mutant for one of the
                # original, which keeps its modification time.
                self._forget(Path(path))
                (self.tree / path).write_bytes(content)
                os.utime(self.tree / path, ns=(times[path].st_atime_ns, times[path].st_mtime_ns))

    def _forget(self, path: Path) -> None:
        """Makes cargo compile the package of this file again."""
        if path.suffix in {".py", ".ts"}:
            return
        folders = [str(folder) for folder in path.parents]
        package = next((_PACKAGES[it] for it in folders if it in _PACKAGES), "jostled")
        own, module = self.target, self.tree / "target/wasm-build"
        for folder in (
            *own.glob(f"*/.fingerprint/{package}-*"),
            *module.glob(f"*/*/.fingerprint/{package}-*"),
        ):
            shutil.rmtree(folder)

    def run(
        self,
        command: list[str],
        cwd: Path | None = None,
        environment: dict[str, str] | None = None,
        *,
        limited: bool = True,
    ) -> tuple[int, str]:
        """Runs a command in the copy. Returns its exit code and its output.

        Raises:
            subprocess.TimeoutExpired: If it is `limited` and runs for too long.
        """
        process = subprocess.Popen(
            command,
            cwd=cwd or self.tree,
            env={
                # The tests would start another daemon than that of the mutant.
                **{name: value for name, value in os.environ.items() if name != "JOSTLED"},
                "CARGO_TARGET_DIR": str(self.target),
                "RUST_BACKTRACE": "0",
                **(environment or {}),
            },
            text=True,
            errors="replace",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=TIMEOUT_SECS if limited else None)
        finally:
            # Also the daemons that the test did not stop.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        return process.returncode, output


def _is_same(source: Path, copy: Path) -> bool:
    try:
        one, other = source.stat(), copy.stat()
    except FileNotFoundError:
        return False
    return (one.st_size, one.st_mtime_ns) == (other.st_size, other.st_mtime_ns)
