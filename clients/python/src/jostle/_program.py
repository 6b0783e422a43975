"""Finds the program `jostled`, which `local` and `sweep` start."""

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
    "install the wheel that `packaging/wheel --programs` builds, or build the program with "
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
                "no `jostled` is on the PATH, and the installed package has no program"
            )
        _warn_of_another_version(found)
        return str(Path(found).absolute())
    found = shutil.which(os.fspath(named))
    if found is not None:
        return str(Path(found).absolute())
    if Path(named).exists():
        raise _unavailable(f"{os.fspath(named)!r} is not a file that this user can execute")
    raise _unavailable(f"there is no {os.fspath(named)!r}")


def beside(jostled: str, name: str) -> str:
    """Returns the path of another program in the folder of `jostled`, or on the `PATH`.

    Raises:
        Unavailable: There is none.
    """
    path = Path(jostled).with_name(name)
    found = str(path) if os.access(path, os.X_OK) else shutil.which(name)
    if found is None:
        raise _unavailable(f"no `{name}` is beside {jostled} or on the PATH")
    return found


def _installed() -> Path | None:
    """The path of the program in the installation of this package; None if it has none."""
    package = Path(__file__).resolve().parent
    try:
        distribution = importlib.metadata.distribution("jostle")
    except importlib.metadata.PackageNotFoundError:
        return None
    # Another installation may precede the package that is imported.
    if Path(str(distribution.locate_file("jostle"))).resolve() != package:
        return None
    for file in distribution.files or []:
        if file.name == "jostled" and file.parent.name == "bin":
            # `pip install --target` moves the program there, and keeps the list of files.
            beside = package.parent / "bin" / "jostled"
            return beside if beside.exists() else Path(str(file.locate())).resolve()
    return None


def _usable(own: Path) -> str:
    if not own.exists():
        raise Unavailable(
            f"the installation of this package lacks its program {str(own)!r}: install it again "
            "with `pip install --force-reinstall FILE.whl`",
            details={"field": "jostled"},
        )
    if not os.access(own, os.X_OK):
        raise _unavailable(f"{str(own)!r} is not a file that this user can execute")
    return str(own)


def _warn_of_another_version(program: str) -> None:
    try:
        ours = importlib.metadata.version("jostle")
        done = subprocess.run(
            [program, "--version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_VERSION_SECS,
            check=False,
        )
    except importlib.metadata.PackageNotFoundError:
        # Imported from a folder of sources.
        return
    except (OSError, subprocess.TimeoutExpired):
        # Starting it fails again, with a message.
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
