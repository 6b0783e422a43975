"""The suites that judge mutants: how each is built and run, and how its output is read."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .place import Place


class Outcome(Enum):
    """How a run of one test ended."""

    PASSED = "passed"
    # By an assertion or a panic of the selected test.
    FAILED = "failed"
    # Not run, or ended without either result.
    OTHER = "neither passed nor failed"


def _outcome(output: str, passed: str, failed: str) -> Outcome:
    has_passed = re.search(passed, output, re.MULTILINE) is not None
    has_failed = re.search(failed, output, re.MULTILINE) is not None
    if has_passed == has_failed:
        return Outcome.OTHER
    return Outcome.PASSED if has_passed else Outcome.FAILED


@dataclass(frozen=True)
class Suite:
    """Where the tests of a suite are, and which code they judge."""

    name: str
    # Folders with the files of the tests.
    tests: tuple[str, ...]
    # Folders whose files a mutant of this suite may change.
    judges: tuple[str, ...]
    # Whether a mutant of this suite makes cargo compile the daemon.
    compiles_daemon: bool = False
    # Whether `--draw` may choose its mutants.
    is_drawn: bool = True

    def has_test(self, test: str, sources: dict[str, str]) -> bool:
        """Returns whether a source of this suite has a test of this name."""
        raise NotImplementedError

    def build(self, place: Place) -> str | None:
        """Compiles the tests. Returns the compiler's output if that fails."""
        raise NotImplementedError

    def judge(self, place: Place, test: str) -> tuple[Outcome, str]:
        """Runs one test. Returns how it ended, and its output."""
        raise NotImplementedError


@dataclass(frozen=True)
class Cargo(Suite):
    """Test executables of the workspace."""

    targets: str = ""
    # Packages and their opt-level, such as `jostled=0`, which compiles faster than 3. Results of
    # arithmetic are the same to the bit.
    opt_levels: tuple[str, ...] = ()

    def has_test(self, test: str, sources: dict[str, str]) -> bool:
        """Whether the sources declare the test."""
        *modules, name = test.split("::")
        declared = re.compile(
            # If a macro declares tests in the file, a name among its arguments counts, too.
            rf"\bfn {re.escape(name)}\(|fn \$.*^\w+!\([^)]*\b{re.escape(name)}\b",
            re.DOTALL | re.MULTILINE,
        )
        for path, text in sources.items():
            if path.startswith(self.tests) and declared.search(text):
                known = {*re.findall(r"\bmod (\w+)", text), *re.split(r"[/.]", path)}
                if known.issuperset(modules):
                    return True
        return False

    def build(self, place: Place) -> str | None:
        """Compiles the tests; returns the output if that fails."""
        status, output = place.run(self._command("--no-run"), limited=False)
        return output if status else None

    def judge(self, place: Place, test: str) -> tuple[Outcome, str]:
        """Runs one test; returns its outcome and the output."""
        _, output = place.run(self._command("--", "--exact", test))
        begin = rf"^test {re.escape(test)}(?: - should panic)? \.\.\. "
        outcome = _outcome(output, f"{begin}ok$", f"{begin}FAILED$")
        if outcome is Outcome.FAILED and "panicked at" not in output:
            outcome = Outcome.OTHER
        return outcome, output

    def _command(self, *more: str) -> list[str]:
        levels = [
            f"--config=profile.release.package.{package}.opt-level={level}"
            for package, level in (it.split("=") for it in self.opt_levels)
        ]
        return ["cargo", *levels, "test", "--release", "--locked", *self.targets.split(), *more]


class Pytest(Suite):
    """Tests of the Python package, with the daemon that was built before."""

    def has_test(self, test: str, sources: dict[str, str]) -> bool:
        """Whether the sources declare the test."""
        path, _, name = test.partition("::")
        text = sources.get(f"clients/python/{path}", "")
        return re.search(rf"^(?:async )?def {re.escape(name)}\(", text, re.MULTILINE) is not None

    def build(self, place: Place) -> str | None:
        """Compiles the tests; returns the output if that fails."""
        del place
        return None

    def judge(self, place: Place, test: str) -> tuple[Outcome, str]:
        """Runs one test; returns its outcome and the output."""
        pytest = [place.python, "-m", "pytest", "-q", "-rA", "-p", "no:cacheprovider"]
        # A test with parameters has failed if one case has: the others need not run.
        command = [*pytest, "--exitfirst", test]
        package = place.tree / "clients/python"
        environment = {
            "PYTHONPATH": str(package / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "JOSTLED": os.environ.get("JOSTLED", str(place.built / "jostled")),
        }
        _, output = place.run(command, cwd=package, environment=environment)
        failed = rf"^FAILED {re.escape(test)}(?:\[| |$)"
        if re.search(failed, output, re.MULTILINE):
            return Outcome.FAILED, output
        return _outcome(output, rf"^PASSED {re.escape(test)}(?:\[| |$)", failed), output


class Page(Suite):
    """Tests beside the page's code, in Node."""

    def has_test(self, test: str, sources: dict[str, str]) -> bool:
        """Whether the sources declare the test."""
        path, _, title = test.partition(": ")
        return f'test("{title}"' in sources.get(f"clients/web/{path}", "")

    def build(self, place: Place) -> str | None:
        """Compiles the tests; returns the output if that fails."""
        status, output = place.run(
            ["npm", "run", "--silent", "test:build"], cwd=place.tree / "clients/web", limited=False
        )
        return output if status else None

    def judge(self, place: Place, test: str) -> tuple[Outcome, str]:
        """Runs one test; returns its outcome and the output."""
        path, _, title = test.partition(": ")
        pattern = "^" + re.sub(r"[.*+?^${}()|[\]\\/]", r"\\\g<0>", title) + "$"
        built = f"build/{path.removesuffix('.ts')}.js"
        command = ["node", "--test", "--test-reporter=tap", "--test-name-pattern", pattern, built]
        _, output = place.run(command, cwd=place.tree / "clients/web")
        line = rf"ok \d+ - {re.escape(title)}$"
        return _outcome(output, rf"^\s*{line}", rf"^\s*not {line}"), output


class Engines(Suite):
    """Scenarios that the native program and the wasm module answer: the test is `SET:ENGINE`."""

    _SCENARIOS = "release/examples/scenarios"

    def has_test(self, test: str, sources: dict[str, str]) -> bool:
        """Whether there is such a comparison."""
        del sources
        return re.fullmatch("[ab]:(node|wasmtime|chromium)", test) is not None

    def build(self, place: Place) -> str | None:
        """Compiles the program and the module; returns the output if that fails."""
        package = ["--locked", "-p", "jostle-wasm", "-p", "jostle-cli"]
        native = ["cargo", "build", "--release", *package, "--example", "scenarios"]
        for command in (native, ["packaging/wasm"]):
            status, output = place.run(command, limited=False)
            if status:
                return output
        return None

    def judge(self, place: Place, test: str) -> tuple[Outcome, str]:
        """Compares one set on one engine; returns the outcome and the output."""
        native = ["--native", str(place.target / self._SCENARIOS)]
        _, output = place.run([place.python, "tests/engines/compare", *native, test])
        line = f"^{test.replace(':', ': ')}: "
        return _outcome(output, f"{line}equal", f"{line}DIFFERENT"), output


_DAEMON = ("src/", "proto/src/", "crates/")
_ALL = [
    Cargo("lib", ("src/",), ("src/",), True, targets="-p jostled --lib", opt_levels=("jostled=0",)),
    Cargo(
        "daemon",
        ("tests/daemon",),
        _DAEMON,
        True,
        targets="-p jostled -p jostled-tests --test architecture --test daemon",
        opt_levels=("jostled=0",),
    ),
    Cargo(
        "measured",
        ("tests/measured",),
        _DAEMON,
        True,
        targets="-p jostled -p jostled-tests --test architecture --test measured",
        opt_levels=("jostled=0",),
    ),
    # Without the daemon, which depends on them. The command line is named so that cargo selects the
    # same features as for the whole workspace, whose dependencies are compiled.
    Cargo(
        "physics",
        ("crates/physics/", "crates/measures/src/"),
        ("crates/physics/src/", "crates/measures/src/"),
        targets="-p jostle-physics -p jostle-measures -p jostle-cli --lib --test physics",
        opt_levels=("jostle-physics=1",),
    ),
    Cargo(
        "experiment",
        ("crates/conditions/src/", "crates/convert/src/", "crates/experiment/src/"),
        (
            "crates/conditions/src/",
            "crates/convert/src/",
            "crates/experiment/src/",
            "crates/physics/src/",
        ),
        targets="-p jostle-conditions -p jostle-convert -p jostle-experiment -p jostle-cli --lib",
        opt_levels=(
            "jostle-experiment=0",
            "jostle-physics=1",
            "jostle-proto=0",
            "jostle-results=0",
        ),
    ),
    Cargo(
        "proto",
        ("proto/src/", "proto/contract/"),
        ("proto/src/",),
        targets="-p jostle-proto -p jostle-contract -p jostle-cli --lib --test contract",
        opt_levels=("jostle-proto=0",),
    ),
    Cargo(
        "results",
        ("crates/results/src/",),
        ("crates/results/src/",),
        targets="-p jostle-results -p jostle-cli --lib",
        opt_levels=("jostle-proto=0", "jostle-results=0"),
    ),
    Cargo(
        "client",
        ("clients/rust/src/",),
        ("clients/rust/src/",),
        True,
        targets="-p jostle-client -p jostle-cli --lib",
        opt_levels=("jostled=0",),
    ),
    # The daemon's library is one of its dependencies, and is compiled once.
    Cargo(
        "cli-unit",
        ("clients/cli/src/",),
        ("clients/cli/src/",),
        targets="--bin jostle",
        opt_levels=("jostle-cli=0", "jostled=0"),
    ),
    Cargo(
        "cli",
        ("clients/cli/tests/",),
        ("clients/cli/src/", "clients/rust/src/"),
        targets="--test cli",
        opt_levels=("jostle-cli=0", "jostled=0"),
    ),
    Pytest("python", ("clients/python/tests/",), ("clients/python/src/",)),
    Page("page", ("clients/web/tests/",), ("clients/web/src/",)),
    # To compile the module takes minutes.
    Engines("engines", ("tests/engines/",), ("crates/physics/src/",), is_drawn=False),
]
SUITES: dict[str, Suite] = {suite.name: suite for suite in _ALL}
