"""Puts the programs `jostled` and `jostle` into the wheel, and the workspace into the sdist.

A wheel is made in one of three ways:

- With the folder of built programs in `JOSTLE_BINARIES`, it has them, stripped. Its tag is
  `py3-none-` and `JOSTLE_PLATFORM`, or `platform_tag()`. `JOSTLE_LICENCES` names the file
  with the licences of the libraries that they contain, which `packaging/licences` writes,
  `JOSTLE_SHARE` the folder with the wasm module, which `packaging/wasm` writes.
- In an unpacked sdist, they are built first: `cargo build --release --locked`.
- In a checkout it is the package alone, `py3-none-any`. So is an editable installation.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PROGRAMS = ("jostled", "jostle")
# What `cargo build` of the programs reads, below the root of the repository.
WORKSPACE = (
    *("Cargo.toml", "Cargo.lock", ".cargo/config.toml", "LICENSE-MIT", "LICENSE-APACHE"),
    *("src", "proto", "crates", "benches", "clients/cli", "clients/rust", "clients/web/dist"),
    *("tests/Cargo.toml", "tests/lib.rs", "third_party"),
)


class Programs(BuildHookInterface[Any]):
    """The hook of hatchling."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Adds files to a build. `version` is `standard` or `editable`."""
        if self.target_name == "sdist":
            build_data["force_include"].update(self._workspace())
            return
        folder = None if version == "editable" else self._binaries()
        if folder is None:
            return
        self._stripped = tempfile.TemporaryDirectory()
        scripts = {stripped(folder / name, self._stripped.name): name for name in PROGRAMS}
        build_data["shared_scripts"].update(scripts)
        if licences := os.environ.get("JOSTLE_LICENCES"):
            build_data["shared_data"][licences] = "share/doc/jostle/third-party.txt"
        if share := os.environ.get("JOSTLE_SHARE"):
            # Empty without a compiler for wasm.
            files = sorted(Path(share).glob("*"))
            build_data["shared_data"].update({str(it): f"share/jostle/{it.name}" for it in files})
        build_data["tag"] = f"py3-none-{os.environ.get('JOSTLE_PLATFORM') or platform_tag()}"
        build_data["pure_python"] = False

    def _binaries(self) -> Path | None:
        """The folder of the programs, built if this is an sdist."""
        if named := os.environ.get("JOSTLE_BINARIES"):
            return Path(named)
        workspace = Path(self.root, "workspace")
        if not (workspace / "Cargo.toml").exists():
            return None
        if shutil.which("cargo") is None:
            raise SystemExit(
                "jostle: cargo not found. The sdist builds jostled and jostle: install Rust from "
                "https://rustup.rs, or build the package alone with `packaging/wheel` in a checkout"
            )
        target = Path(self.root, "target")
        # As `strip` does below, also where there is none.
        environ = {**os.environ, "CARGO_PROFILE_RELEASE_STRIP": "symbols"}
        command = ["cargo", "build", "--release", "--locked", "--target-dir", str(target)]
        for name in PROGRAMS:
            command += ["--bin", name]
        # Below the workspace cargo finds `.cargo/config.toml`, which zenoh is compiled with.
        subprocess.run(command, cwd=workspace, env=environ, check=True)
        return target / "release"

    def _workspace(self) -> dict[str, str]:
        """The files that the programs are built from, and their places in the sdist."""
        root = Path(self.root, "workspace")
        if not (root / "Cargo.toml").exists():
            root = Path(self.root, "../..").resolve()
        names = tracked(root)
        return {str(root / name): f"workspace/{name}" for name in names or files(root)}


def platform_tag() -> str:
    """The tag of systems that run what this machine's linker makes.

    With glibc that is `manylinux_X_Y_ARCH` of this machine's glibc X.Y, so that pip rejects the
    wheel on a system whose glibc is older.
    """
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    try:
        _, version = (os.confstr("CS_GNU_LIBC_VERSION") or "").split()
    except (AttributeError, OSError, ValueError):
        return platform
    return platform.replace("linux", f"manylinux_{version.replace('.', '_')}", 1)


def tracked(root: Path) -> list[str]:
    """The names of the files of the workspace that git tracks; none if it does not."""
    command = ["git", "ls-files", "-z", "--", *WORKSPACE]
    try:
        listed = subprocess.run(command, cwd=root, check=False, capture_output=True, text=True)
    except OSError:
        return []
    names = [name for name in listed.stdout.split("\0") if name]
    return names if "Cargo.toml" in names else []


def files(root: Path) -> list[str]:
    """The names of all files of the workspace, without git."""
    found = []
    for name in WORKSPACE:
        path = root / name
        paths = [it for it in path.rglob("*") if it.is_file()] if path.is_dir() else [path]
        found += [str(it.relative_to(root)) for it in paths]
    return sorted(found)


def stripped(program: Path, folder: str) -> str:
    """Copies a program without its symbols, and returns the path of the copy."""
    if not program.is_file():
        raise SystemExit(f"jostle: there is no program {program.name}: {program}")
    copy = Path(folder, program.name)
    shutil.copy(program, copy)
    subprocess.run(["strip", copy], check=True)
    return str(copy)
