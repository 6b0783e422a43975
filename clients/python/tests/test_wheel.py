"""The installed package: a complete wheel, with types."""

from __future__ import annotations

import email
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import packaging.tags
import pytest

from conftest import JOSTLED

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((FOLDER / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]


def pip(*arguments: str | Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check", *arguments],
        check=True,
        capture_output=True,
        timeout=120,
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    # The build backend is installed: nothing is downloaded.
    pip("wheel", "--no-deps", "--no-build-isolation", "-w", folder, FOLDER)
    (made,) = folder.glob("*.whl")
    return made


def test_the_wheel_has_the_package_its_types_and_nothing_else(wheel: Path) -> None:
    assert wheel.name == f"jostle-{VERSION}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        files = {it for it in archive.namelist() if ".dist-info/" not in it}
        (metadata,) = [it for it in archive.namelist() if it.endswith("/METADATA")]
        headers = email.message_from_bytes(archive.read(metadata))
    source = FOLDER / "src"
    assert files == {
        str(it.relative_to(source)) for it in source.rglob("*") if it.suffix in (".py", ".typed")
    }
    assert "jostle/py.typed" in files
    extras = {"pandas", "matplotlib", "notebook", "recording", "dask", "search", "env"}
    assert extras <= set(headers.get_all("Provides-Extra", []))
    needs = [it for it in headers.get_all("Requires-Dist", []) if "extra ==" not in it]
    assert sorted(it.split("~")[0].split(">")[0] for it in needs) == [
        *("cbor2", "eclipse-zenoh", "msgspec", "numpy", "tomli-w")
    ]
    body = headers.get_payload()
    assert isinstance(body, str)
    assert body.startswith("# jostle for Python")


def test_the_installed_package_works_and_is_typed(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    pip("install", "--no-deps", "--target", site, wheel)
    program = tmp_path / "program.py"
    program.write_text(
        "import asyncio\n"
        "import jostle\n"
        "from jostle import aio\n"
        "async def main() -> float:\n"
        "    async with aio.local() as client:\n"
        "        swarm = await client.create('school', jostle.Spec(n=5))\n"
        "        state = await swarm.step(5, state=True)\n"
        "        return state.time\n"
        "print(jostle.__file__, asyncio.run(main()))\n",
        encoding="utf-8",
    )
    environ = {**os.environ, "JOSTLED": str(JOSTLED), "PYTHONPATH": str(site)}
    ran = subprocess.run(
        [sys.executable, "-W", "error", program],
        env=environ,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout == f"{site / 'jostle' / '__init__.py'} 0.1\n"
    # As the type checker runs on a user's program.
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", tmp_path / "cache", program],
        cwd=tmp_path,
        env={**environ, "MYPYPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel with the programs that the other tests start."""
    folder = tmp_path_factory.mktemp("programs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JOSTLE_BINARIES", str(JOSTLED.parent))
        patch.setenv("JOSTLE_LICENCES", str(FOLDER / "LICENSE-MIT"))
        (share := folder / "share").mkdir()
        (share / "jostle.wasm.gz").write_bytes(b"module")
        patch.setenv("JOSTLE_SHARE", str(share))
        pip("wheel", "--no-deps", "--no-build-isolation", "-w", folder, FOLDER)
    (made,) = folder.glob("*.whl")
    return made


class Environment:
    """A virtual environment that sees the dependencies of these tests, without a `jostled`."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=False)
        self.folder = folder
        self.python = folder / "bin" / "python"
        self.environ = {name: it for name, it in os.environ.items() if name != "JOSTLED"}
        self.environ |= {
            "PATH": str(folder / "empty"),
            "PYTHONPATH": sysconfig.get_path("purelib"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    def pip(self, *arguments: str | Path) -> None:
        """Runs pip for this environment."""
        pip("--python", self.python, *arguments)

    def run(self, source: str, *within: str) -> subprocess.CompletedProcess[str]:
        """Runs a program, `within` another command. This environment's packages come first."""
        site = self.folder / "lib" / f"python3.{sys.version_info.minor}" / "site-packages"
        return subprocess.run(
            [
                *within,
                self.python,
                "-W",
                "error::RuntimeWarning",
                "-c",
                f"import sys\nsys.path.insert(0, {str(site)!r})\n{source}",
            ],
            env=self.environ,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    def files(self) -> set[Path]:
        """Returns every file of this environment."""
        return {it for it in self.folder.rglob("*") if it.is_file()}


STEP = (
    "import jostle\n"
    "with jostle.local() as client:\n"
    "    swarm = client.create('school', jostle.Spec(n=5))\n"
    "    print(swarm.step(5, state=True).time)\n"
)


def test_the_wheel_with_programs_needs_nothing_else_and_leaves_nothing(
    programs: Path, tmp_path: Path
) -> None:
    tags = [f"-py3-none-{it}.whl" for it in packaging.tags.platform_tags()]
    assert programs.name.endswith(tuple(tags))
    environment = Environment(tmp_path / "venv")
    before = environment.files()
    environment.pip("install", "--no-deps", programs)
    ran = environment.run(STEP)
    assert (ran.returncode, ran.stdout) == (0, "0.1\n"), ran.stderr
    for name in ("jostled", "jostle"):
        program = environment.folder / "bin" / name
        done = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
        assert done.stdout.startswith(f"{name} {VERSION}")
        # The debug symbols of these programs, tens of megabytes, are stripped.
        assert program.stat().st_size < JOSTLED.with_name(name).stat().st_size
    licences = environment.folder / "share" / "doc" / "jostle" / "third-party.txt"
    assert licences.read_bytes() == (FOLDER / "LICENSE-MIT").read_bytes()
    module = environment.folder / "share" / "jostle" / "jostle.wasm.gz"
    assert module.read_bytes() == b"module"
    environment.pip("uninstall", "-y", "jostle")
    assert environment.files() == before


def test_an_installation_without_its_program_is_an_error(programs: Path, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "venv")
    environment.pip("install", "--no-deps", programs)
    program = environment.folder / "bin" / "jostled"
    program.chmod(0o644)
    # Not even root can start it.
    ran = environment.run(STEP)
    assert ran.returncode == 1
    assert f"{str(program)!r} is not a file that this user can execute" in ran.stderr
    program.unlink()
    ran = environment.run(STEP)
    assert ran.returncode == 1
    assert f"lacks its program {str(program)!r}: install it again" in ran.stderr


def test_the_installed_program_precedes_one_on_the_path(
    programs: Path, wheel: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "jostled").write_text("#!/bin/sh\necho jostled 9.9.9\n", encoding="utf-8")
    (other / "jostled").chmod(0o755)
    environment = Environment(tmp_path / "venv")
    environment.environ["PATH"] = str(other)
    environment.pip("install", "--no-deps", programs)
    ran = environment.run(STEP)
    assert (ran.returncode, ran.stdout) == (0, "0.1\n"), ran.stderr
    # The package without programs uses the one on the path, and warns about another version.
    environment.pip("install", "--no-deps", "--force-reinstall", wheel)
    ran = environment.run(STEP)
    assert ran.returncode == 1
    warned = f"{other / 'jostled'} on the PATH has version 9.9.9 and this package {VERSION}"
    assert warned in ran.stderr
    # Without a program the remedy names the wheel; everything else works.
    environment.environ["PATH"] = str(tmp_path / "empty")
    ran = environment.run(STEP)
    assert ran.returncode == 1
    assert "install the wheel that `packaging/wheel --programs` builds" in ran.stderr
    assert environment.run("import jostle\njostle.Spec(n=5)").returncode == 0


def test_a_folder_without_a_program_makes_no_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JOSTLE_BINARIES", str(tmp_path))
    with pytest.raises(subprocess.CalledProcessError) as failed:
        pip("wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path / "out", FOLDER)
    assert f"there is no program jostled: {tmp_path / 'jostled'}" in str(failed.value.stderr)


def test_pip_rejects_the_wheel_where_glibc_is_older(
    programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, version = (os.confstr("CS_GNU_LIBC_VERSION") or "").split()
    assert name == "glibc"
    major, minor = version.split(".")
    assert programs.name.endswith(f"-manylinux_{major}_{minor}_{os.uname().machine}.whl")
    newer = f"manylinux_{major}_{int(minor) + 1}_{os.uname().machine}"
    monkeypatch.setenv("JOSTLE_BINARIES", str(JOSTLED.parent))
    monkeypatch.setenv("JOSTLE_PLATFORM", newer)
    pip("wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path, FOLDER)
    (made,) = tmp_path.glob("*.whl")
    with pytest.raises(subprocess.CalledProcessError) as failed:
        pip("install", "--no-deps", "--target", tmp_path / "site", made)
    assert f"{made.name} is not a supported wheel on this platform" in str(failed.value.stderr)


def test_a_program_that_does_not_start_is_an_error_with_the_reason(
    programs: Path, tmp_path: Path
) -> None:
    environment = Environment(tmp_path / "venv")
    environment.pip("install", "--no-deps", programs)
    program = environment.folder / "bin" / "jostled"
    # The loader's message, as for a program that was linked to a newer glibc.
    binary = program.read_bytes()
    newest = max(re.findall(rb"\0GLIBC_2\.(\d\d)(?=\0)", binary), key=int)
    program.write_bytes(binary.replace(b"\0GLIBC_2." + newest + b"\0", b"\0GLIBC_2.99\0"))
    ran = environment.run(STEP)
    assert ran.returncode == 1
    assert "the daemon ended with 1 and did not start; its log ends with:\n" in ran.stderr
    assert re.search(r"version `GLIBC_2\.99' not found", ran.stderr), ran.stderr


def test_a_folder_without_rights_is_an_error(programs: Path, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "venv")
    environment.pip("install", "--no-deps", programs)
    folder = tmp_path / "folder"
    folder.mkdir()
    folder.chmod(0o555)
    source = STEP.replace("local()", f"local({str(folder / 'kept')!r})")
    # With this capability root can write everywhere.
    setpriv = shutil.which("setpriv")
    assert setpriv is not None
    limits = (f"--{name}=-dac_override" for name in ("bounding-set", "inh-caps"))
    ran = environment.run(source, *((setpriv, *limits) if os.geteuid() == 0 else ()))
    assert ran.returncode == 1
    assert f"PermissionError: [Errno 13] Permission denied: {str(folder / 'kept')!r}" in ran.stderr
    assert not list(folder.iterdir())


def test_an_installation_into_a_folder_has_its_program(programs: Path, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "venv")
    site = tmp_path / "site"
    pip("install", "--no-deps", "--target", site, programs)
    ran = environment.run(f"sys.path.insert(0, {str(site)!r})\n{STEP}")
    assert (ran.returncode, ran.stdout) == (0, "0.1\n"), ran.stderr


def test_the_sdist_holds_the_workspace(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
    subprocess.run(build, cwd=FOLDER, check=True, capture_output=True, timeout=120)
    (made,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(made) as archive:
        names = {it.partition("/")[2] for it in archive.getnames()}
    root = FOLDER.parents[1]
    workspace = tomllib.loads((root / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]
    for member in workspace["members"]:
        assert f"workspace/{Path(member, 'Cargo.toml')}" in names, member
    patches = tomllib.loads((root / "Cargo.toml").read_text(encoding="utf-8"))["patch"]["crates-io"]
    for patch in patches.values():
        assert f"workspace/{Path(patch['path'], 'Cargo.toml')}" in names, patch
    for name in ("Cargo.lock", ".cargo/config.toml", "src/main.rs", "clients/web/dist/index.html"):
        assert f"workspace/{name}" in names
    assert {"src/jostle/__init__.py", "hatch_build.py", "pyproject.toml"} <= names
    assert not [it for it in names if it.startswith(("workspace/target", "workspace/docs"))]
