"""The same once more, in peace: what a day's commands and experiments come to elsewhere."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jostle

# What is carried out while it runs waits for its step; a swarm takes no more than this.
_MOST_WAITING = 1000
_PATIENCE_SECS = 120.0


def retell(
    client: jostle.Client, name: str, spec: dict[str, Any], journal: Iterable[jostle.JournalEntry]
) -> str:
    """Carries out a swarm's journal on another daemon, and tells the hash that it comes to.

    Nothing is timed there: what was applied while it ran waits for its step before it runs, and
    it runs as fast as it can.
    """
    swarm = client.create(name, {**spec, "rate": None})
    entries = sorted(journal, key=lambda entry: entry.seq)
    while entries:
        # Up to its first run it stands; from there all waits for its step, up to the next reset.
        stands = next((k for k, it in enumerate(entries) if it.verb == "run"), len(entries))
        for entry in entries[:stands]:
            _tell(client, name, entry)
        if stands == len(entries):
            break
        run, rest = entries[stands], entries[stands + 1 :]
        until = next((k for k, it in enumerate(rest) if it.verb == "reset"), len(rest))
        assert until <= _MOST_WAITING, f"{name}: {until} commands in one run"
        for entry in rest[:until]:
            assert entry.step > run.step, f"{name}: {entry} is of the step at which it began"
            _tell(client, name, entry, at_step=entry.step)
        entries = rest[until:]
        _tell(client, name, run)
        _reach(swarm, rest[until - 1].seq if until else run.seq)
    return swarm.status().state_hash


def _reach(swarm: jostle.Swarm, seq: int) -> None:
    """Waits until it has applied so many commands."""
    deadline = time.monotonic() + _PATIENCE_SECS
    while (status := swarm.status()).seq < seq:
        assert time.monotonic() < deadline, f"it stands at {status.step}, {status.seq} of {seq}"
        time.sleep(0.005)


def _tell(
    client: jostle.Client, name: str, entry: jostle.JournalEntry, at_step: int | None = None
) -> None:
    args = {**entry.args, "rate": None} if entry.verb == "run" else entry.args
    link = client._link
    link.command(link.swarm_key(name, f"cmd/{entry.verb}"), args, swarm=name, at_step=at_step)


def run_experiment(jostled: Path, text: str, work: Path, name: str) -> bytes:
    """Carries out an experiment without a daemon, and tells its table."""
    file, folder = work / f"{name}.toml", work / f"{name}-elsewhere"
    file.write_text(text)
    command: list[str | Path] = [jostled, "run", file, "-o", folder]
    subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE_SECS)
    return (folder / "results.csv").read_bytes()


def results(jostle_: Path, endpoint: str, work: Path, name: str) -> bytes:
    """An experiment's table, as the command line has it of the daemon."""
    folder = work / f"{name}-here"
    command: list[str | Path] = [
        jostle_,
        "-e",
        endpoint,
        "experiment",
        "results",
        name,
        "-o",
        folder,
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=60.0)
    return (folder / "results.csv").read_bytes()
