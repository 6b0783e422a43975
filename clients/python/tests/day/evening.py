"""The end of the day: everybody goes, and everything is asked once more."""

from __future__ import annotations

import itertools
import os
import re
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jostle

from . import elsewhere
from .lab import Lab, eventually
from .ledger import Asker
from .node import Node

_PATIENCE_SECS = 600.0
_IDLE_SECS = 12.0
# Those that nobody steers but by commands: carried out again they come to the same.
NOT_RETOLD = ("loop-", "brood-", "still", "vault")
_MUST_NOT_BE = re.compile(r"panick|thread '.*' has overflowed|corrupt|damaged|ERROR")


def go_home(lab: Lab) -> None:
    """Has everybody finish what they are at, and go."""
    for person in lab.people.all():
        person.over.set()
    for person in lab.people.all():
        person.join(_PATIENCE_SECS)
        if person.trouble is not None:
            raise person.trouble
    assert lab.chronicle.is_alive(), "nobody looked on"
    assert lab.meter.is_alive(), "nobody measured"
    for controller in lab.controllers.values():
        controller.finish()
    lab.seen = lab.crowd.finish()
    times = os.times()
    # Of the daemons those that were killed are among the children that have ended.
    killed = {sample.life: sample.cpu_secs for sample in lab.meter.samples}
    del killed[lab.node.lives[-1].number]
    lab.others_cpu_secs = sum(times[:4]) - sum(killed.values())
    lab.say("everybody has gone home")


def ask_once_more(lab: Lab) -> None:
    """Brings everything to its end, and asks what it has come to."""
    client = jostle.connect(lab.node.endpoint, client="evening", timeout=20.0)
    asker = Asker(client, "evening", lab.ledger)
    with client:
        for name in ("twin-1", "twin-2"):
            client.swarm(name).wait(step=lab.plan.twin_end, timeout=_PATIENCE_SECS)
        for experiment in client.experiments():
            one = client.experiment(experiment.name)
            if experiment.phase == "failed":
                lab.say(f"{experiment.name} has failed and is resumed: {experiment.message}")
                one.resume()
            one.wait(_PATIENCE_SECS, show=False)
            lab.say(f"{experiment.name} is finished")
        swarms = [it.swarm for it in client.swarms() if not it.replay]
        for name in swarms:
            asker.ask(name, "pause", {})
        lab.chronicle.finish()
        durable = [asked for asked in lab.ledger.all() if asked.is_durable]
        for asked in durable:
            asker.ask_again(asked)
        lab.say(f"{len(durable)} commands were sent once more")
        with ThreadPoolExecutor(2) as pool:
            verified = pool.map(lambda name: _verify(client, name), swarms)
            lab.notes.verified = dict(zip(swarms, verified, strict=True))
        lab.say(f"{len(swarms)} pasts were told again by the daemon")
        lab.notes.recordings = {it.recording: it for it in client.recordings()}
        there = {name: client.swarm(name).status() for name in swarms}
        for number in (1, 2):
            name = f"grid-{number}"
            cli = lab.node.jostled.with_name("jostle")
            here = elsewhere.results(cli, lab.node.endpoint, lab.work, name)
            lab.notes.experiments[name] = here, b""
        eventually("nobody is connected any more", 20.0, lambda: client.status().clients <= 1)
        # What connecting took zenoh gives back after ten seconds.
        time.sleep(_IDLE_SECS)
    lab.meter.finish()
    lab.meter.look()
    lab.notes.ended = lab.node.stop()
    lab.say(f"the daemon has ended with code {lab.notes.ended}")
    _read(lab)
    _go_elsewhere(lab, there)


def _verify(client: jostle.Client, name: str) -> jostle.Verified | str:
    try:
        return client.swarm(name).verify(_PATIENCE_SECS)
    except jostle.JostleError as error:
        return f"{error.code}: {error}"


def _read(lab: Lab) -> None:
    """Reads what is left on the disk."""
    for name in lab.notes.recordings:
        try:
            lab.notes.read[name] = _frames(lab.node.data / "recordings" / name)
        except (jostle.JostleError, OSError) as error:
            lab.notes.read[name] = str(error)
    lines = lab.node.log.read_text(errors="replace").splitlines()
    lab.notes.log_lines = len(lines)
    lab.notes.log = [line for line in lines if _MUST_NOT_BE.search(line)]


def _frames(folder: Path) -> dict[str, Any]:
    """What a recording holds: from where to where in each epoch, and what is missing."""
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


def _go_elsewhere(lab: Lab, there: dict[str, jostle.Status]) -> None:
    """Has another daemon carry out the same commands, and the experiments without any."""
    data = lab.work / "elsewhere"
    data.mkdir()
    other = Node(lab.node.jostled, data / "data", data)
    other.start()
    try:
        with jostle.connect(other.endpoint, client="elsewhere", timeout=60.0) as client:
            for name, status in there.items():
                if name.startswith(NOT_RETOLD):
                    continue
                journal = lab.chronicle.pasts[name].journal.values()
                spec = lab.plan.specs[name]
                here = f"not carried out: {name}"
                try:
                    here = elsewhere.retell(client, name, spec, journal)
                except (jostle.JostleError, AssertionError) as error:
                    here = f"{type(error).__name__}: {error}"
                lab.notes.again[name] = status.state_hash, here
        other.stop()
    finally:
        other.end()
    lab.say(f"{len(lab.notes.again)} swarms were carried out again elsewhere")
    for number in (1, 2):
        name = f"grid-{number}"
        text = lab.plan.experiment(number)
        peace = elsewhere.run_experiment(lab.node.jostled, text, lab.work, name)
        lab.notes.experiments[name] = lab.notes.experiments[name][0], peace
    lab.say("both experiments were carried out again elsewhere")


def end_all(lab: Lab) -> None:
    """Has nothing left that the day has started."""
    for controller in lab.controllers.values():
        controller.end()
    lab.crowd.end()
    lab.node.end()
