"""Reads the mutants from the TOML files in the folder `tests/mutants`."""

from __future__ import annotations

import functools
import os
import re
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .suites import SUITES

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "tests/mutants"
VERDICTS = FOLDER / "verdicts.toml"
_SUFFIXES = {".rs", ".py", ".ts"}
# Folders with built or downloaded files.
_SKIPPED = {"target", "node_modules", "__pycache__", ".git", ".venv", ".pytest_cache"}
_SKIPPED_PATHS = {"clients/web/build"}


@dataclass(frozen=True)
class Edit:
    """One replacement, of a text that occurs once in all sources."""

    find: str
    replace: str

    def pattern(self) -> re.Pattern[str]:
        """The text to find; white space matches any white space, so code may be re-indented."""
        return re.compile(r"\s+".join(re.escape(word) for word in self.find.split()))


@dataclass(frozen=True)
class Mutant:
    """A small wrong program, and the test that must fail on it."""

    name: str
    why: str
    suite: str
    test: str
    edits: tuple[Edit, ...]

    def apply(self, sources: dict[str, str]) -> dict[str, str]:
        """Returns the changed text of each file that the edits change.

        Raises:
            ValueError: If a text to find does not occur exactly once.
        """
        changed: dict[str, str] = {}
        for edit in self.edits:
            pattern, replace = edit.pattern(), edit.replace
            found = [path for path, text in sources.items() for _ in pattern.finditer(text)]
            if len(found) != 1:
                where = ", ".join(sorted(set(found))) or "no file"
                raise ValueError(f"found {len(found)} times, in {where}: {edit.find!r}")
            text = changed.get(found[0], sources[found[0]])
            # A function, so that a backslash in the replacement stands for itself.
            changed[found[0]], count = pattern.subn(functools.partial(_return, replace), text)
            if count != 1:
                raise ValueError(f"an earlier edit removes this text: {edit.find!r}")
        return changed


def apply_all(mutants: list[Mutant], sources: dict[str, str]) -> dict[str, str]:
    """Returns the changed text of each file that these mutants change together.

    Raises:
        ValueError: If a text to find does not occur exactly once.
    """
    changed: dict[str, str] = {}
    for mutant in mutants:
        changed |= mutant.apply({**sources, **changed})
    return changed


def groups(mutants: list[Mutant], sources: dict[str, str], size: int) -> list[list[Mutant]]:
    """Splits mutants into groups of at most `size` that are compiled together.

    Two mutants of a group have different tests and change different files. One that does not
    compile the daemon is alone.
    """
    found: list[list[Mutant]] = []
    taken: list[set[str]] = []
    for mutant in mutants:
        own = {mutant.test, *mutant.apply(sources)}
        is_alone = not SUITES[mutant.suite].compiles_daemon
        for group, its in zip(found, taken, strict=True):
            if not is_alone and len(group) < size and not its & own:
                group.append(mutant)
                its |= own
                break
        else:
            found.append([mutant])
            # A mutant that has to be alone is a full group.
            taken.append(own if not is_alone else {it.test for it in mutants})
    return found


def _return(replacement: str, _found: re.Match[str]) -> str:
    return replacement


def project_files(root: Path) -> list[Path]:
    """Returns the path of every file below `root` that was not built or downloaded."""
    found = []
    for name, folders, files in os.walk(root):
        folder = Path(name)
        inner = folder.relative_to(root)
        folders[:] = [
            it
            for it in folders
            if it not in _SKIPPED and (inner / it).as_posix() not in _SKIPPED_PATHS
        ]
        found += [inner / it for it in files if not (folder / it).is_symlink()]
    return found


def read_sources() -> dict[str, str]:
    """Returns the text of each Rust, Python and TypeScript file by its path."""
    return {
        path.as_posix(): (ROOT / path).read_text(encoding="utf-8")
        for path in project_files(ROOT)
        if path.suffix in _SUFFIXES and path.parts[0] != FOLDER.name
    }


def load() -> list[Mutant]:
    """Reads every mutant, sorted by suite and name.

    Raises:
        ValueError: If a file has another form, or a name stands twice.
    """
    mutants = []
    for path in sorted(FOLDER.glob("*.toml")):
        if path == VERDICTS:
            continue
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        if set(document) != {"mutant"}:
            raise ValueError(f"{path.name}: expected nothing but [[mutant]]")
        mutants += [_mutant(path.name, it) for it in document["mutant"]]
    twice = [name for name, count in Counter(it.name for it in mutants).items() if count > 1]
    if twice:
        raise ValueError(f"used for two mutants: {', '.join(twice)}")
    return sorted(mutants, key=lambda it: (it.suite, it.name))


def _mutant(file: str, table: dict[str, Any]) -> Mutant:
    place = f"{file}: {table.get('name', 'a mutant without a name')}"
    edits = table.pop("edits", None)
    if edits is None:
        edits = [{key: table.pop(key) for key in ("find", "replace") if key in table}]
    if set(table) != {"name", "why", "suite", "test"}:
        raise ValueError(f"{place}: expected name, why, suite, test, find and replace")
    if any(set(it) != {"find", "replace"} or not it["find"].strip() for it in edits):
        raise ValueError(f"{place}: expected find and replace in each edit")
    if table["suite"] not in SUITES:
        raise ValueError(f"{place}: unknown suite {table['suite']!r}: use {', '.join(SUITES)}")
    if not re.fullmatch(r"[a-z0-9_]+", table["name"]):
        raise ValueError(f"{place}: a name has lowercase letters, digits and '_'")
    return Mutant(**table, edits=tuple(Edit(**it) for it in edits))


def faults(mutants: list[Mutant], sources: dict[str, str]) -> list[str]:
    """Returns what is wrong with the mutants, a line each."""
    found = []
    for mutant in mutants:
        suite = SUITES[mutant.suite]
        if not suite.has_test(mutant.test, sources):
            found.append(f"{mutant.name}: no test {mutant.test!r} in suite {suite.name!r}")
        try:
            changed = mutant.apply(sources)
        except ValueError as error:
            found.append(f"{mutant.name}: {error}")
            continue
        for path, text in changed.items():
            if text == sources[path]:
                found.append(f"{mutant.name}: replaces a text in {path} by itself")
            if not path.startswith(suite.judges):
                found.append(f"{mutant.name}: suite {suite.name!r} is not for {path}")
            if path.endswith(".py"):
                try:
                    compile(text, path, "exec")
                except SyntaxError as error:
                    found.append(f"{mutant.name}: invalid Python: {error}")
    return found
