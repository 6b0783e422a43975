"""The verdict of the last run of each mutant, in the file `tests/mutants/verdicts.toml`."""

from __future__ import annotations

import subprocess
import tomllib
from datetime import UTC, datetime

from .texts import ROOT, VERDICTS, Mutant

# The greatest age of a verdict, in commits to the sources.
MAX_COMMITS = 100
_SOURCES = [
    "src",
    "proto/src",
    "crates",
    "clients/cli/src",
    "clients/rust/src",
    "clients/python/src",
    "clients/web/src",
]
_HEAD = """\
# Written by `tests/mutants/run --record`; not by hand. For each mutant the verdict of its last
# run: `red` if the test that it names passes without it and fails with it. `commit` is the commit
# that was changed, and `changes` the number of mutants in the same build.
"""


def _git(*arguments: str) -> str | None:
    """Returns the output of a git command, or nothing if it fails or there is no repository."""
    done = subprocess.run(
        ["git", *arguments], cwd=ROOT, text=True, capture_output=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else None


def read() -> dict[str, dict[str, str]]:
    """Returns the verdict of each mutant that has one, by its name."""
    if not VERDICTS.exists():
        return {}
    return tomllib.loads(VERDICTS.read_text(encoding="utf-8"))


def commit_to_record() -> str:
    """Returns the commit of the tree, which a run judges.

    Raises:
        ValueError: If there is none.
    """
    commit, changed = _git("rev-parse", "HEAD"), _git("status", "--porcelain", "--", ".")
    if commit is None or changed is None:
        raise ValueError("--record needs a clone of the repository")
    own = VERDICTS.relative_to(ROOT).as_posix()
    if [line for line in changed.splitlines() if line.split(maxsplit=1)[-1] != own]:
        raise ValueError("--record needs a tree without uncommitted changes")
    return commit


def record(mutant: Mutant, verdict: str, commit: str, changes: int, known: list[Mutant]) -> None:
    """Writes the verdict of a mutant that was run as one of `changes`, and drops old ones."""
    names = {it.name for it in known}
    verdicts = {name: it for name, it in read().items() if name in names}
    date = datetime.now(UTC).date().isoformat()
    verdicts[mutant.name] = {
        "verdict": verdict,
        "commit": commit,
        "date": date,
        "changes": str(changes),
    }
    tables = [
        f"[{name}]\n" + "".join(f'{key} = "{value}"\n' for key, value in sorted(it.items()))
        for name, it in sorted(verdicts.items())
    ]
    spare = VERDICTS.with_suffix(".spare")
    spare.write_text("\n".join([_HEAD, *tables]), encoding="utf-8")
    spare.replace(VERDICTS)


def faults(mutants: list[Mutant]) -> tuple[list[str], list[str]]:
    """Returns the faults of the verdicts, and notes about them."""
    if not VERDICTS.exists():
        return [f"no verdicts: run tests/mutants/run --record ({VERDICTS.name} is missing)"], []
    verdicts = read()
    ours = {it.name: verdicts[it.name] for it in mutants if it.name in verdicts}
    found = [
        f"{name}: its last verdict is {it['verdict']!r}"
        for name, it in ours.items()
        if it["verdict"] != "red"
    ]
    said: list[str] = []
    if missing := len(mutants) - len(ours):
        found.append(f"{missing} of {len(mutants)} mutants have no verdict: run them with --record")
    if _git("rev-parse", "--is-shallow-repository") != "false":
        return found, [*said, "no clone with its history: the age of the verdicts is not checked"]
    ages = {commit: _age(commit) for commit in {it["commit"] for it in ours.values()}}
    for commit, age in ages.items():
        if age is None:
            found.append(f"verdicts of a commit that HEAD does not come from: {commit}")
        elif age > MAX_COMMITS:
            found.append(
                f"verdicts {age} commits to the sources old, at most {MAX_COMMITS} are allowed: "
                "run ./check --long, or tests/mutants/run --record"
            )
    said.append(
        f"the oldest verdict lies {max(filter(None, ages.values()), default=0)} commits back"
    )
    return found, said


def _age(commit: str) -> int | None:
    """Returns the commits since, of a commit from which this checkout comes.

    An amended commit stays readable where it was made, and in no other clone.
    """
    if _git("merge-base", "--is-ancestor", commit, "HEAD") is None:
        return None
    count = _git("rev-list", "--count", f"{commit}..HEAD", "--", *_SOURCES)
    return None if count is None else int(count)
