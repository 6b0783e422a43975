"""The package as it is installed: a wheel that has all it needs, and the types."""

from __future__ import annotations

import email
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from conftest import JOSTLED

FOLDER = Path(__file__).resolve().parents[1]


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
    # What builds it is there already: nothing is fetched.
    pip("wheel", "--no-deps", "--no-build-isolation", "-w", folder, FOLDER)
    (made,) = folder.glob("*.whl")
    return made


def test_the_wheel_has_the_package_its_types_and_nothing_else(wheel: Path) -> None:
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert wheel.name == f"jostle-{project['version']}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        files = {it for it in archive.namelist() if ".dist-info/" not in it}
        (metadata,) = [it for it in archive.namelist() if it.endswith("/METADATA")]
        told = email.message_from_bytes(archive.read(metadata))
    source = FOLDER / "src"
    assert files == {
        str(it.relative_to(source)) for it in source.rglob("*") if it.suffix in (".py", ".typed")
    }
    assert "jostle/py.typed" in files
    extras = {"pandas", "matplotlib", "notebook", "progress", "recording", "env"}
    assert extras <= set(told.get_all("Provides-Extra", []))
    needs = [it for it in told.get_all("Requires-Dist", []) if "extra ==" not in it]
    assert sorted(it.split("~")[0].split(">")[0] for it in needs) == [
        *("cbor2", "eclipse-zenoh", "msgspec", "numpy")
    ]
    body = told.get_payload()
    assert isinstance(body, str)
    assert body.startswith("# jostle for Python")


def test_what_is_installed_works_and_is_typed(wheel: Path, tmp_path: Path) -> None:
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
    # As a user's own program is checked, who has no more than the package.
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
