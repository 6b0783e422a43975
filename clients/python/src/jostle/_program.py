"""Finds the program `jostled` that `local()` starts."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import warnings
from pathlib import Path

from ._errors import Unavailable

_VERSION_SECS = 10.0
_REMEDY = (
    "install the wheel that has it, `pip install jostle` on Linux x86-64, or build it with "
    "`cargo build --release` in jostle's folder, which makes target/release/jostled, and name it "
    "as `jostled=` or in JOSTLED, or put it on the PATH"
)


def find(named: str | os.PathLike[str] | None) -> str:
    """Returns the path of the program: the first of these that is given or exists.

    The argument; the environment's `JOSTLED`; the program of the installed wheel; `jostled` on the
    `PATH`. One on the `PATH` whose version differs from the package's causes a warning.

    Raises:
        Unavailable: There is none, or the file is no program.
    """
    if named is None:
        named = os.environ.get("JOSTLED") or None
    if named is None:
        own = _installed()
        if own is not None:
            return _usable(own)
        found = shutil.which("jostled")
        if found is None:
            raise _unavailable(
                "no `jostled` is on the PATH, and this package was installed without"
            )
        _warn_of_another_version(found)
        return str(Path(found).absolute())
    found = shutil.which(os.fspath(named))
    if found is not None:
        return str(Path(found).absolute())
    if Path(named).exists():
        raise _unavailable(f"{os.fspath(named)!r} is no program that this user can start")
    raise _unavailable(f"there is no {os.fspath(named)!r}")


def _installed() -> Path | None:
    """The place of the program in the installation of this package; None if it has none."""
    try:
        files = importlib.metadata.files("jostle") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        if file.name == "jostled" and file.parent.name in ("bin", "Scripts"):
            return Path(os.fspath(file.locate())).resolve()
    return None


def _usable(own: Path) -> str:
    if not own.exists():
        raise Unavailable(
            f"the installation of this package lacks its program {str(own)!r}: install it again "
            "with `pip install --force-reinstall jostle`",
            details={"field": "jostled"},
        )
    if not os.access(own, os.X_OK):
        raise _unavailable(f"{str(own)!r} is no program that this user can start")
    return str(own)


def _warn_of_another_version(program: str) -> None:
    ours = importlib.metadata.version("jostle")
    try:
        done = subprocess.run(
            [program, "--version"],
            capture_output=True,
            text=True,
            timeout=_VERSION_SECS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        # It fails again when it is started, and says why.
        return
    theirs = done.stdout.removeprefix("jostled").strip()
    if theirs != ours:
        warnings.warn(
            f"{program} on the PATH has version {theirs or 'unknown'} and this package {ours}: "
            "it is started nevertheless; name another as `jostled=` or in JOSTLED",
            RuntimeWarning,
            stacklevel=4,
        )


def _unavailable(where: str) -> Unavailable:
    return Unavailable(f"{where}: {_REMEDY}", details={"field": "jostled"})
