"""The shell and Python blocks of the pages: each is run here, or a comment names what runs it.

The blocks run as a reader would run them who reads page after page: in the order of `pages`, in one
folder and beside one daemon, whose addresses replace the default ones. So what a page creates has
names of its own. A TOML block whose first line is `# NAME.toml` is written to that file.
Above a block, a comment may be

- `<!-- run, the last command until Ctrl-C -->`: the last line of the block runs until it has
  printed a line, and is then interrupted;
- `<!-- run by: FILE -->` or `<!-- not run: REASON; FILE … -->`: the block is not run here. The
  files exist, and one of them names the page or contains the commands of the block.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, ROOT, Daemon, eventually

KINDS = ("sh", "bash", "console", "python", "toml")
UNTIL_CTRL_C = "run, the last command until Ctrl-C"
NAMED = re.compile(r"(?:run by|not run): .+")
FILE = re.compile(r"(?:\./)?[\w.-]+(?:/[\w.-]+)+|\./check")
# The experiment of docs/lost.md takes both cores for 20 s. Less than pytest's own limit, which ends
# the whole run.
MAX_BLOCK_SECS = 115.0
# Commands that every system has.
COMMON = {"export", "cd", "cp", "mv", "chown", "echo"}
# What creates a swarm or an experiment under the name that the audit log has: verbs, and, of those
# that do more, what they do.
CREATES = {
    **dict.fromkeys(("create", "restore", "fork", "replay open"), "swarm"),
    "experiment submit": "experiment",
}
LINK = re.compile(r"\]\(([^)\s]+)\)")


def pages() -> list[Path]:
    """All pages, as a reader meets them.

    The README, the pages that the index links in its order, and those that it does not name.
    """
    patterns = (
        *(
            "README.md",
            "CONTRIBUTING.md",
            "SECURITY.md",
            "docs/**/*.md",
            "proto/README.md",
            "fuzz/README.md",
        ),
        "clients/*/README.md",
    )
    found = {page.relative_to(ROOT) for pattern in patterns for page in ROOT.glob(pattern)}
    index = Path("docs/README.md")
    links = LINK.findall((ROOT / index).read_text(encoding="utf-8"))
    linked = [Path(os.path.normpath(index.parent / link.partition("#")[0])) for link in links]
    ordered = [Path("README.md"), index, *linked, *sorted(found)]
    return [page for page in dict.fromkeys(ordered) if page in found]


PAGES = pages()


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    kind: str
    comment: str
    code: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def is_named(self) -> bool:
        """Whether its comment names what runs it."""
        return NAMED.fullmatch(self.comment) is not None

    @property
    def file(self) -> str | None:
        """The file that the block is to be written to."""
        found = re.match(r"# (\S+\.toml)\n", self.code) if self.kind == "toml" else None
        return found[1] if found else None


def blocks_of(page: Path) -> Iterator[Block]:
    """The blocks of a page that this module is about."""
    text = (ROOT / page).read_text(encoding="utf-8")
    pattern = r"^(?:<!-- (?P<comment>(?:(?!-->).)*?) -->\n)?```(?P<kind>\w*)\n(?P<code>.*?)^```$"
    for found in re.finditer(pattern, text, re.M | re.S):
        kind, code = found["kind"], found["code"]
        line = text.count("\n", 0, found.start("kind")) + 1
        if kind in KINDS:
            yield Block(page, line, kind, " ".join((found["comment"] or "").split()), code)


BLOCKS = {page: list(blocks_of(page)) for page in PAGES}
RUN = [
    block
    for blocks in BLOCKS.values()
    for block in blocks
    if block.kind != "toml" and not block.is_named
]
NOT_RUN = [block for blocks in BLOCKS.values() for block in blocks if block.is_named]


class Runner:
    """The folder and the daemon of the pages, and how far their blocks have been run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon = Daemon(folder, http="127.0.0.1:0")
        self.client = jostle.connect(self.daemon.endpoint, client="test-docs")
        # The daemon writes lines of the audit log in order, after it has replied: a note marks how
        # far they are written.
        self.marked = self.client.create("test-docs", jostle.Spec(n=1))
        self.marks = 0
        self.left = {page: list(blocks) for page, blocks in BLOCKS.items()}
        self.created = Counter[tuple[str, str]]()
        self.creators: dict[tuple[str, str], Path] = {}
        self.names: dict[Path, dict[str, Any]] = {page: {"__name__": "page"} for page in self.left}
        programs = f"{JOSTLED.parent}:{Path(sys.executable).parent}"
        self.environment = {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "XDG_STATE_HOME": str(folder / "state"),
            "JOSTLE_ENDPOINT": self.daemon.endpoint,
            "JOSTLED": str(JOSTLED),
        }
        fixtures = ROOT / "proto" / "fixtures"
        (folder / "fixtures").symlink_to(fixtures)

    def run_up_to(self, block: Block) -> None:
        """Runs a block, and before it those of its page that have not been run."""
        left = self.left[block.page]
        while block in left:
            first = left.pop(0)
            if first.file is not None:
                (self.folder / first.file).write_text(first.code, encoding="utf-8")
            elif first in RUN:
                self._run(first)
                self._creates_names_of_its_own(first)

    def _run(self, block: Block) -> None:
        code = block.code.replace("http://127.0.0.1:8080", self.daemon.http)
        code = code.replace("tcp/127.0.0.1:7447", self.daemon.endpoint)
        if block.kind == "python":
            # So that a traceback has the line of the page.
            padded = "\n" * block.line + code
            exec(compile(padded, ROOT / block.page, "exec"), self.names[block.page])
            return
        if block.kind == "console":
            code = "".join(re.findall(r"^\$ (.*\n)", code, re.M))
        last = None
        if block.comment == UNTIL_CTRL_C:
            *lines, last = code.splitlines()
            code = "\n".join(lines)
        ran = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", code],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=MAX_BLOCK_SECS,
            check=False,
        )
        assert ran.returncode == 0, f"{block}:\n{ran.stdout}\n{ran.stderr}"
        if last is not None:
            self._run_until_interrupted(block, last)

    def _run_until_interrupted(self, block: Block, command: str) -> None:
        free = {"JOSTLED_LISTEN": "tcp/127.0.0.1:0", "JOSTLED_HTTP": "127.0.0.1:0"}
        with subprocess.Popen(
            ["bash", "-c", f"exec {command}"],
            env={**os.environ, **free},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            try:
                first = process.stdout.readline()
                process.send_signal(signal.SIGINT)
                _, errors = process.communicate(timeout=MAX_WAIT_SECS)
            finally:
                process.kill()
        assert process.returncode in (0, 130), f"{block}: {errors}"
        assert first.strip(), f"{block} prints nothing: {errors}"

    def _creates_names_of_its_own(self, block: Block) -> None:
        """Fails if a block creates what has the name of something that another page created."""
        self.marked.annotate(str(block))
        self.marks += 1
        eventually("the audit log is written", lambda: self._marks_in_audit() == self.marks)
        created = Counter[tuple[str, str]]()
        for line in self.client.audit(limit=None):
            kind = CREATES.get(line.verb) or CREATES.get(f"{line.verb} {line.action}")
            if kind is not None and line.name is not None:
                created[kind, line.name] += line.count
        new, self.created = created - self.created, created
        others = {it: str(self.creators.setdefault(it, block.page)) for it in new}
        taken = {it: page for it, page in others.items() if page != str(block.page)}
        assert not taken, f"{block} gives names that another page has given: {taken}"

    def _marks_in_audit(self) -> int:
        lines = self.client.audit(client="test-docs", verb="annotate", limit=None)
        return sum(line.count for line in lines)

    def close(self) -> None:
        """Stops the daemon."""
        self.client.close()
        for names in self.names.values():
            for value in names.values():
                if isinstance(value, jostle.Client):
                    value.close()
        assert self.daemon.stop() == 0, self.daemon.log.read_text()


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """Runs the blocks of the pages."""
    runner = Runner(tmp_path_factory.mktemp("pages"))
    yield runner
    runner.close()


@pytest.mark.parametrize("block", RUN, ids=str)
def test_a_block_runs(block: Block, runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    assert block.comment in ("", UNTIL_CTRL_C), f"{block}: what is {block.comment!r}?"
    for name, value in runner.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(runner.folder)
    runner.run_up_to(block)


@pytest.mark.parametrize("block", NOT_RUN, ids=str)
def test_what_runs_a_block_exists_and_has_its_commands(block: Block) -> None:
    files = [ROOT / name for name in FILE.findall(block.comment)]
    assert files, f"{block} names no file: {block.comment}"
    missing = [str(file.relative_to(ROOT)) for file in files if not file.is_file()]
    assert not missing, f"{block} names files that do not exist: {missing}"
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    if block.page.name != "README.md" and block.page.name in text:
        return
    for words in commands(block.code):
        assert not unknown(words, text), (
            f"{block}: {unknown(words, text)} of {words} is in no {files}"
        )


def commands(code: str) -> Iterator[list[str]]:
    """The words of each command of a shell block, without those that every system has."""
    code = re.sub(r"\\\n", " ", code)
    for line in code.splitlines():
        words = shlex.split(line, comments=True)
        while words and (words[0] == "sudo" or re.match(r"[A-Z_]+=", words[0])):
            words.pop(0)
        if words and words[0] not in COMMON:
            yield words


def unknown(words: list[str], text: str) -> str | None:
    """The program or the subcommand of a command, if the text does not have it."""
    program, *rest = words
    if program == "cargo" and rest[0] == "bench":
        target = rest[rest.index("--bench") + 1]
        return None if target in bench_targets() else target
    named = [
        Path(program).name,
        *(word for word in rest[:1] if re.fullmatch(r"[a-z][a-z-]+", word)),
    ]
    return next((word for word in named if word not in text), None)


def bench_targets() -> set[str]:
    """The names of the benches of the workspace."""
    manifests = [ROOT / "Cargo.toml", ROOT / "benches" / "physics" / "Cargo.toml"]
    tables = [tomllib.loads(it.read_text(encoding="utf-8")) for it in manifests]
    return {bench["name"] for table in tables for bench in table["bench"]}


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_commands_are_in_blocks_and_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.M | re.S)
    indented = r"^ {4,}(?:\$ |sudo |cargo |jostled? |npm |packaging/|\./check|[A-Z_]+=\S+ ).*"
    assert not re.findall(indented, text, re.M)
    for target in LINK.findall(text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (ROOT / page).parent / path if path else ROOT / page
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), f"{page}: {target}"


def anchors(text: str) -> set[str]:
    """The anchors of the headings of a page, as GitHub names them."""
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


def test_the_blocks_are_found() -> None:
    assert {"README.md", "docs/guide.md", "clients/python/README.md"} <= {str(it) for it in PAGES}
    assert len(RUN) >= 40
    assert len(NOT_RUN) <= 60
    assert len({block.page for block in RUN}) >= 8
