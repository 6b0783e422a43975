"""The end of a run: stops the load, and reads the final state of everything."""

from __future__ import annotations

import itertools
import re
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jostle

from . import reexecution
from .context import Context, wait_until
from .node import Node
from .requests import Requester

_TIMEOUT_SECS = 600.0
_IDLE_SECS = 12.0
# Swarms that are not changed by commands alone, so that executing their journal is not enough.
NOT_REEXECUTED = ("loop-", "short-lived-", "stepped", "paused")
_DEFECT = re.compile(r"panick|thread '.*' has overflowed|corrupt|damaged|ERROR")
# zenoh 1.10 reports as an error that a client was killed while its connection was made.
_KILLED_CLIENT = re.compile(
    r"zenoh_transport\S*: Error syncing transport with peer (\w+): Transport with peer \1 is closed"
)


def stop_load(context: Context) -> None:
    """Stops clients, controllers and viewers, after their pending requests."""
    for client in context.clients.all():
        client.stop_event.set()
    for client in context.clients.all():
        client.join(_TIMEOUT_SECS)
        if client.failure is not None:
            raise client.failure
    assert context.observer.is_alive(), "the observer has ended"
    assert context.meter.is_alive(), "the meter has ended"
    for controller in context.controllers.values():
        controller.finish()
    context.seen = context.viewers.finish()
    context.log("the load has ended")


def read_final_state(context: Context) -> None:
    """Waits for swarms and experiments, resends, verifies, and stops the daemon."""
    client = jostle.connect(context.node.endpoint, client="shutdown", timeout=20.0)
    requester = Requester(client, "shutdown", context.requests)
    with client:
        for name in ("twin-1", "twin-2"):
            client.swarm(name).wait(step=context.plan.twin_end, timeout=_TIMEOUT_SECS)
        for experiment in client.experiments():
            one = client.experiment(experiment.name)
            # The disk was full while it was executed.
            if experiment.phase in ("failed", "paused"):
                context.log(f"{experiment.name} is resumed: {experiment.message}")
                one.resume()
            one.wait(_TIMEOUT_SECS, show=False)
            context.log(f"{experiment.name} is finished")
        swarms = [it.swarm for it in client.swarms() if not it.replay]
        for name in swarms:
            requester.send(name, "pause", {})
        context.observer.finish()
        durable = [request for request in context.requests.all() if request.is_durable]
        for request in durable:
            requester.resend(request)
        context.log(f"resent {len(durable)} commands")
        with ThreadPoolExecutor(2) as pool:
            verified = pool.map(lambda name: _verify(client, name), swarms)
            context.observed.verified = dict(zip(swarms, verified, strict=True))
        context.log(f"verified {len(swarms)} swarms")
        context.observed.recordings = {it.recording: it for it in client.recordings()}
        statuses = {name: client.swarm(name).status() for name in swarms}
        for number in (1, 2):
            name = f"grid-{number}"
            cli = context.node.jostled.with_name("jostle")
            table = reexecution.results(cli, context.node.endpoint, context.work, name)
            context.observed.experiments[name] = table, b""
        wait_until("only this client is connected", 20.0, lambda: client.status().clients <= 1)
        # zenoh releases the threads of handshakes after ten seconds.
        time.sleep(_IDLE_SECS)
    context.meter.finish()
    context.meter.sample()
    context.observed.ended = context.node.stop()
    context.log(f"the daemon has exited with {context.observed.ended}")
    _read_files(context)
    _reexecute(context, statuses)


def _verify(client: jostle.Client, name: str) -> jostle.Verified | str:
    try:
        return client.swarm(name).verify(_TIMEOUT_SECS)
    except jostle.JostleError as error:
        return f"{error.code}: {error}"


def _read_files(context: Context) -> None:
    """Reads the recordings and the log of the daemon."""
    observed = context.observed
    for name in observed.recordings:
        try:
            observed.read[name] = _read_recording(context.node.data / "recordings" / name)
        except (jostle.JostleError, OSError) as error:
            observed.read[name] = str(error)
    lines = context.node.log.read_text(errors="replace").splitlines()
    observed.log_lines = len(lines)
    observed.log = [
        line for line in lines if _DEFECT.search(line) and not _KILLED_CLIENT.search(line)
    ]


def _read_recording(folder: Path) -> dict[str, Any]:
    """The first and last step of each epoch in a recording, and how many frames are missing."""
    recording = jostle.read_recording(folder)
    frames = [(it.epoch, it.step, it.frame) for it in recording]
    every = int(recording.about["every"])
    missing = back = 0
    for before, after in itertools.pairwise(frames):
        back += after[:2] < before[:2]
        if after[0] == before[0]:
            missing += (after[1] - before[1]) // every - 1
    epochs: dict[int, list[int]] = {}
    for epoch, step, _ in frames:
        epochs.setdefault(epoch, [step, step])[1] = step
    return {
        "frames": len(frames),
        "every": every,
        "missing": missing,
        "missed": int(recording.about.get("missed", 0)),
        "back": back,
        "epochs": epochs,
    }


def _reexecute(context: Context, statuses: dict[str, jostle.Status]) -> None:
    """Executes the same commands on another daemon, and the experiments without one."""
    observed = context.observed
    folder = context.work / "reexecution"
    folder.mkdir()
    other = Node(context.node.jostled, folder / "data", folder)
    other.start()
    try:
        with jostle.connect(other.endpoint, client="reexecution", timeout=60.0) as client:
            for name, status in statuses.items():
                if name.startswith(NOT_REEXECUTED):
                    continue
                journal = context.observer.logs[name].journal.values()
                try:
                    result = reexecution.reexecute(client, name, context.plan.specs[name], journal)
                except (jostle.JostleError, AssertionError) as error:
                    result = f"{type(error).__name__}: {error}"
                observed.reexecuted[name] = status.state_hash, result
        other.stop()
    finally:
        other.end()
    context.log(f"executed the journals of {len(observed.reexecuted)} swarms on another daemon")
    for number in (1, 2):
        name = f"grid-{number}"
        text = context.plan.experiment(number)
        expected = reexecution.run_experiment(context.node.jostled, text, context.work, name)
        observed.experiments[name] = observed.experiments[name][0], expected
    context.log("executed both experiments without a daemon")


def end_processes(context: Context) -> None:
    """Kills every process that the test started and that still runs."""
    for controller in context.controllers.values():
        controller.end()
    context.viewers.end()
    context.node.end()
