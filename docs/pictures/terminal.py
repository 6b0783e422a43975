#!/usr/bin/env python3
"""Makes terminal.svg: `jostle watch` as it looks, from a real run in a terminal of its own.

    cargo build --release --workspace
    python3 -m venv .venv && .venv/bin/pip install pyte
    .venv/bin/python docs/pictures/terminal.py target/release
"""

import contextlib
import fcntl
import os
import pathlib
import pty
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from html import escape

import pyte

COLUMNS, ROWS = 110, 34
CELL_WIDTH, CELL_HEIGHT, MARGIN = 8, 17, 14
FONT = "ui-monospace, 'SF Mono', Menlo, Consolas, 'DejaVu Sans Mono', monospace"
# The terminal's own colours, on a dark ground and on a light one.
COLOURS = {
    "default": ("#d6dbe1", "#24292f"),
    "ground": ("#12161b", "#ffffff"),
    "cyan": ("#4cc3d9", "#0b7285"),
    "magenta": ("#ff79c6", "#c2255c"),
    "brown": ("#f1c453", "#a15c00"),
    "green": ("#63d471", "#1a7f37"),
    "red": ("#ff6b6b", "#cf222e"),
    "brightblack": ("#77818c", "#6e7781"),
}


@contextlib.contextmanager
def daemon(binaries: pathlib.Path, folder: str):
    """A daemon of its own; yields its endpoint."""
    line = [binaries / "jostled", "serve", "--listen", "tcp/127.0.0.1:0", "--http", ""]
    with subprocess.Popen([*line, "--data-dir", folder], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True) as process:
        try:
            for said in process.stdout:
                words = [word.strip("\",") for word in said.replace("=", " ").split()]
                found = [word for word in words if word.startswith("tcp/127.0.0.1:")]
                if found and not found[0].endswith(":0"):
                    yield found[0]
                    return
            raise SystemExit("the daemon did not say where it listens")
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30)


class Watch:
    """`jostle watch` in a terminal."""

    def __init__(self, line: list, size: tuple[int, int] = (COLUMNS, ROWS)):
        columns, rows = size
        self.screen = pyte.Screen(columns, rows)
        self.stream = pyte.ByteStream(self.screen)
        self.pid, self.terminal = pty.fork()
        if self.pid == 0:
            os.environ.update(TERM="xterm-256color")
            os.environ.pop("NO_COLOR", None)
            os.execv(line[0], [str(word) for word in line])
        size = struct.pack("HHHH", rows, columns, 0, 0)
        fcntl.ioctl(self.terminal, termios.TIOCSWINSZ, size)

    def look(self, seconds: float) -> None:
        """Takes in what is drawn meanwhile."""
        end = time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0:
            ready, _, _ = select.select([self.terminal], [], [], rest)
            if ready:
                try:
                    self.stream.feed(os.read(self.terminal, 65536))
                except OSError:
                    return

    def press(self, keys: str) -> None:
        os.write(self.terminal, keys.encode())

    def end(self) -> int:
        """Quits it and returns its exit code."""
        self.press("q")
        self.look(1)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def svg(screen: pyte.Screen) -> str:
    """The screen as text; Braille as dots, since no two fonts agree on it."""
    width = screen.columns * CELL_WIDTH + 2 * MARGIN
    height = screen.lines * CELL_HEIGHT + 2 * MARGIN
    rules = ["text { white-space: pre; font: 13px %s }" % FONT]
    for index in (0, 1):
        of_it = [f".{name} {{ fill: {it[index]}; color: {it[index]} }}" for name, it in COLOURS.items()]
        of_it.append("path { fill: none !important; stroke: currentColor }")
        rules.extend(of_it if index == 0 else ["@media (prefers-color-scheme: light) {", *of_it, "}"])
    body, dots = [], {}
    for row in range(screen.lines):
        line, column = screen.buffer[row], 0
        while column < screen.columns:
            cell = line[column]
            if 0x2800 < ord(cell.data) < 0x2900:
                dots.setdefault(colour(cell), []).extend(braille(cell.data, column, row))
                column += 1
                continue
            end = column
            while end < screen.columns and line[end][1:] == cell[1:] and not (
                0x2800 < ord(line[end].data) < 0x2900
            ):
                end += 1
            body.append(run(line, column, end, row, cell))
            column = end
    for name, places in dots.items():
        path = "".join(f"M{x:g} {y:g}h0" for x, y in places)
        body.append(f'<path class="{name}" d="{path}" stroke-width="2.6" stroke-linecap="round"/>')
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" role="img" aria-label="jostle watch in a terminal">',
        "<style>", *rules, "</style>",
        f'<rect class="ground" width="{width}" height="{height}" rx="8"/>',
        *filter(None, body), "</svg>", "",
    ])


# What pyte calls the first sixteen of 256 colours.
NAMES = {
    "00cdcd": "cyan", "cd00cd": "magenta", "cdcd00": "brown", "00cd00": "green", "cd0000": "red",
    "7f7f7f": "brightblack",
}


def colour(cell) -> str:
    name = NAMES.get(cell.fg, cell.fg)
    return name if name in COLOURS else "default"


def run(line, column: int, end: int, row: int, cell) -> str:
    """Characters that look alike."""
    text = "".join(line[at].data for at in range(column, end))
    x, y = MARGIN + column * CELL_WIDTH, MARGIN + row * CELL_HEIGHT
    back, name = "", colour(cell)
    if cell.reverse:
        size = f'width="{(end - column) * CELL_WIDTH}" height="{CELL_HEIGHT}"'
        back, name = f'<rect class="{name}" x="{x}" y="{y}" {size}/>', "ground"
    if not text.strip():
        return back
    bold = ' font-weight="bold"' if cell.bold else ""
    start = len(text) - len(text.lstrip())
    text = text.strip()
    x += start * CELL_WIDTH
    return (f'{back}<text class="{name}" x="{x}" y="{y + 13}" '
            f'textLength="{len(text) * CELL_WIDTH}"{bold}>{escape(text)}</text>')


def braille(character: str, column: int, row: int) -> list[tuple[float, float]]:
    """Where the dots of a character are."""
    bits = ord(character) - 0x2800
    places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]
    left, top = MARGIN + column * CELL_WIDTH, MARGIN + row * CELL_HEIGHT
    across, down = CELL_WIDTH / 2, CELL_HEIGHT / 4
    return [
        (left + (x + 0.5) * across, top + (y + 0.5) * down)
        for bit, (x, y) in enumerate(places) if bits >> bit & 1
    ]


def main() -> None:
    binaries = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "target/release").resolve()
    with tempfile.TemporaryDirectory() as folder, daemon(binaries, folder) as endpoint:
        def jostle(line: str) -> None:
            words = [*line.split(), "--client", "ada"]
            subprocess.run([binaries / "jostle", "-e", endpoint, *words], check=True,
                           stdout=subprocess.DEVNULL)

        jostle("create demo --n 50 --seed 12 --rate 25")
        jostle("create pair --n 2 --seed 1 --rate 1")
        jostle("create school --n 120 --seed 3 --rate 5")
        jostle("create shoal --n 20 --seed 4")
        jostle("step shoal 800")
        jostle("run school --rate 5")
        jostle("inform demo --count 10 --direction 0 --at-step 2500")
        jostle("run demo")
        watch = Watch([binaries / "jostle", "-e", endpoint, "watch", "demo"])
        watch.look(13)
        picture = svg(watch.screen)
        if "--text" in sys.argv:
            print("\n".join(watch.screen.display))
        if (code := watch.end()) != 0:
            raise SystemExit(f"it ended with {code}")
    pathlib.Path(__file__).with_name("terminal.svg").write_text(picture)


main()
