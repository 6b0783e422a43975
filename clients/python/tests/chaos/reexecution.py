"""Executes the commands and experiments of a run again, on a daemon without faults."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jostle

# Commands executed while the swarm ran are scheduled; this is the limit of a swarm.
_MAX_SCHEDULED = 1000
# No measure of performance: other load may slow these programs down twentyfold.
_TIMEOUT_SECS = 600.0


def reexecute(
    client: jostle.Client, name: str, spec: dict[str, Any], journal: Iterable[jostle.JournalEntry]
) -> str:
    """Executes a swarm's journal on another daemon, and returns the state hash.

    It does not depend on timing: commands applied while the swarm ran are scheduled for their steps
    before it runs, as fast as possible.
    """
    swarm = client.create(name, {**spec, "rate": None})
    entries = sorted(journal, key=lambda entry: entry.seq)
    while entries:
        # Commands before the first run are applied at once, those up to the next reset scheduled.
        paused = next((k for k, it in enumerate(entries) if it.verb == "run"), len(entries))
        for entry in entries[:paused]:
            _send(client, name, entry)
        if paused == len(entries):
            break
        run, rest = entries[paused], entries[paused + 1 :]
        until = next((k for k, it in enumerate(rest) if it.verb == "reset"), len(rest))
        assert until <= _MAX_SCHEDULED, f"{name}: {until} commands in one run"
        for entry in rest[:until]:
            assert entry.step > run.step, f"{name}: {entry} has the step at which the run began"
            _send(client, name, entry, at_step=entry.step)
        entries = rest[until:]
        _send(client, name, run)
        _wait(swarm, rest[until - 1].seq if until else run.seq)
    return swarm.status().state_hash


def _wait(swarm: jostle.Swarm, seq: int) -> None:
    """Waits until the swarm has applied `seq` commands."""
    deadline = time.monotonic() + _TIMEOUT_SECS
    while (status := swarm.status()).seq < seq:
        assert time.monotonic() < deadline, f"at step {status.step}, {status.seq} of {seq} commands"
        time.sleep(0.005)


def _send(
    client: jostle.Client, name: str, entry: jostle.JournalEntry, at_step: int | None = None
) -> None:
    args = {**entry.args, "rate": None} if entry.verb == "run" else entry.args
    session = client._session
    session.command(session.swarm_key(name, f"cmd/{entry.verb}"), args, swarm=name, at_step=at_step)


def run_experiment(jostled: Path, text: str, work: Path, name: str) -> bytes:
    """Executes an experiment without a daemon, and returns its table."""
    file, folder = work / f"{name}.toml", work / f"{name}-without-daemon"
    file.write_text(text)
    command: list[str | Path] = [jostled, "run", file, "-o", folder]
    subprocess.run(command, check=True, capture_output=True, timeout=_TIMEOUT_SECS)
    return (folder / "results.csv").read_bytes()


def results(jostle_: Path, endpoint: str, work: Path, name: str) -> bytes:
    """An experiment's table, as the command line gets it from the daemon."""
    folder = work / f"{name}-of-daemon"
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
