"""What goes wrong in the course of the day, and what is done beside."""

from __future__ import annotations

import contextlib
import hashlib
import signal
import time
from collections.abc import Callable

import numpy as np

import jostle

from .lab import Lab, Recorded, eventually
from .ledger import Asker

# So long before a kill an experiment begins.
_AHEAD_SECS = 8.0
# For how long before a kill everybody asks without a rest.
_HASTE_SECS = 0.3
_PAUSED = "vault"
# Deleted while the disk is full.
_SPARE = "brood-spare"


class Troubles:
    """The day's schedule, carried out by one who also records and replays."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._client = jostle.connect(lab.node.endpoint, client="director")
        self._asker = Asker(self._client, "director", lab.ledger)

    def live(self) -> None:
        """Lives the day from its begin to its end."""
        plan = self._lab.plan
        due: list[tuple[float, Callable[[], None]]] = [
            (0.0, self._begin),
            (plan.kill_controller, self._kill_controller),
            (plan.first_kill - _AHEAD_SECS, lambda: self._submit(1)),
            (plan.first_kill, self._kill_node),
            (plan.stop_film, self._replay),
            (plan.freeze_controller, self._freeze_controller),
            (plan.fill, self._fill_disk),
            (plan.film_again, lambda: self._record("film-3", "film")),
            (plan.second_kill - _AHEAD_SECS, lambda: self._submit(2)),
            (plan.second_kill, self._kill_node),
        ]
        for at, happens in due:
            self._rest(at)
            happens()
        while time.monotonic() < self._lab.began + plan.seconds:
            self._rest(min(plan.seconds, time.monotonic() - self._lab.began + 15.0))
            self._tell()
        self._client.close()

    def _rest(self, until: float) -> None:
        while (left := self._lab.began + until - time.monotonic()) > 0.0:
            time.sleep(min(left, 15.0))
            if left > 15.0:
                self._tell()

    def _tell(self) -> None:
        lab = self._lab
        asked = lab.ledger.all()
        answered = sum(1 for one in asked if one.answer is not None)
        last = lab.meter.samples[-1]
        slowest = "-" if last.slowest is None else f"{last.slowest:.2f}"
        lab.say(
            f"{answered} of {len(asked)} commands answered, {last.memory_kb / 1024:.0f} MB, "
            f"{last.descriptors} descriptors, {last.threads} threads, slowest at {slowest}, "
            f"disk {lab.disk.used_megabytes():.0f} of {lab.disk.megabytes} MB"
        )

    def _begin(self) -> None:
        self._asker.ask(None, "create", {"name": _PAUSED, "spec": {"n": 20}})
        self._asker.ask(_PAUSED, "step", {"steps": 100})
        self._asker.ask(None, "create", {"name": _SPARE, "spec": {"n": 20}})
        eventually("their swarms are there", 20.0, lambda: self._are_there({"film", "table"}))
        self._record("film-1", "film")
        self._record("table-1", "table")

    def _are_there(self, swarms: set[str]) -> bool:
        return swarms <= {it.swarm for it in self._client.swarms()}

    def _record(self, recording: str, swarm: str) -> None:
        begin = {"swarm": swarm, "recording": recording}
        step = self._client.swarm(swarm).status().step
        self._lab.notes.recorded[recording] = Recorded(swarm, time.monotonic(), step)
        asked = self._asker.ask(None, "record", {"begin": begin})
        self._lab.say(f"{swarm} is recorded as {recording} {asked.refusals or ''}")

    def _submit(self, number: int) -> None:
        toml = self._lab.plan.experiment(number)
        asked = self._asker.ask(None, "experiment", {"submit": {"toml": toml}})
        self._lab.say(f"experiment grid-{number} is submitted {asked.refusals or ''}")

    def _kill_controller(self) -> None:
        lab = self._lab
        swarm = self._client.swarm("loop-1")

        def only_ada_is_missing() -> bool:
            # So bob has advanced and waits for his answer.
            with contextlib.suppress(jostle.JostleError):
                return [it.controller for it in swarm.status().waiting_for] == ["ada"]
            return False

        eventually("bob waits", 20.0, only_ada_is_missing)
        lab.controllers["bob"].signal(signal.SIGKILL)
        lab.notes.controller_killed = time.monotonic()
        lab.say("bob's process is killed in the middle of an exchange")
        time.sleep(min(3.0, 0.02 * lab.plan.seconds))
        lab.controllers["bob"].start()
        lab.say("bob comes back")

    def _freeze_controller(self) -> None:
        lab = self._lab
        began = time.monotonic()
        lab.controllers["dan"].signal(signal.SIGSTOP)
        lab.say(f"dan's process stands still for {lab.plan.freeze_secs:.1f} s")
        time.sleep(lab.plan.freeze_secs)
        lab.controllers["dan"].signal(signal.SIGCONT)
        lab.notes.frozen = (began, time.monotonic())
        lab.say("dan's process goes on")

    def _kill_node(self) -> None:
        lab = self._lab
        lab.meter.look()
        with contextlib.suppress(jostle.JostleError):
            for it in self._client.experiments():
                lab.say(f"{it.name} is {it.phase}, {it.finished} of {it.runs} runs finished")
        for person in lab.people.all():
            person.is_hasty = True
        time.sleep(_HASTE_SECS)
        statuses = {name: self._client.swarm(name).status() for name in ("film", "table")}
        lab.notes.steps.append({name: (it.epoch, it.step) for name, it in statuses.items()})
        lab.node.kill()
        for person in lab.people.all():
            person.is_hasty = False
        lab.notes.kills.append(time.monotonic())
        lab.notes.parts.append(self._whole_parts())
        lab.say("the daemon is killed")
        life = lab.node.start()
        lab.say(f"the daemon is back after {life.listening - life.began:.2f} s")

    def _whole_parts(self) -> dict[str, str]:
        folder = self._lab.node.data / "recordings"
        return {
            str(part.relative_to(folder)): hashlib.sha256(part.read_bytes()).hexdigest()
            for part in sorted(folder.glob("*/part-*"))
            if part.suffix == ".mcap"
        }

    def _replay(self) -> None:
        lab = self._lab
        self._asker.ask(None, "record", {"stop": {"recording": "film-1"}})
        lab.notes.recorded["film-1"].ended = time.monotonic()
        self._record("film-2", "film")
        seen = lab.notes.replay
        try:
            frames = list(jostle.read_recording(lab.node.data / "recordings" / "film-1"))
            with self._client.replay(recording="film-1", name="tape") as tape:
                replay = tape.status().replay
                seen["frames"] = (0 if replay is None else replay.frames, len(frames))
                seen["compared"] = seen["different"] = 0
                for k in range(0, len(frames), max(1, len(frames) // 40)):
                    tape.seek(fraction=k / max(1, len(frames) - 1))
                    shown = tape.state()
                    same = [it for it in frames if it.step == shown.step]
                    seen["compared"] += 1
                    if not any(np.array_equal(shown.position, it.position) for it in same):
                        seen["different"] += 1
                try:
                    tape.inform(jostle.ids([0]), direction=0.0)
                    seen["inform"] = "carried out"
                except jostle.JostleError as error:
                    seen["inform"] = error.code
                tape.run(rate=4.0)
        except jostle.JostleError as error:
            seen["trouble"] = f"{error.code}: {error}"
        lab.say(f"film-1 is replayed as tape: {seen}")

    def _fill_disk(self) -> None:
        with self._lab.people.breeder.deletions:
            self._fill_until_free()

    def _fill_until_free(self) -> None:
        lab, full = self._lab, self._lab.notes.full
        lab.disk.fill()
        full.filled = time.monotonic()
        lab.say("the disk is full")
        inform = {"select": {"count": 1}, "direction": 1.0}
        # What was set aside is used up first.
        while not full.refused and time.monotonic() < full.filled + 30.0:
            if "storage_full" in self._asker.ask(_PAUSED, "inform", inform).refusals:
                full.refused = time.monotonic()
        lab.say(f"commands are refused after {full.refused - full.filled:.2f} s")
        film = self._client.swarm("film")
        first = film.status().step
        free = lab.began + lab.plan.free
        while time.monotonic() < free - 1.0:
            # A part of a recording that is given up gives back a little.
            lab.disk.fill()
            before = self._state()
            refusals = self._asker.ask(_PAUSED, "inform", inform).refusals
            if refusals == ["storage_full"]:
                full.refusals += 1
                full.changed += before != self._state()
            else:
                full.others += refusals
            time.sleep(0.25)
        full.ran = film.status().step - first
        reply = self._asker.ask(_PAUSED, "step", {"steps": 3}).reply
        if reply:
            full.stepped = (reply["step"], reply["result"]["durable_step"])
        full.deleted = self._asker.ask(_SPARE, "delete", {}).answer is not None
        if full.deleted:
            lab.people.breeder.gone.add(_SPARE)
        lab.disk.free()
        full.freed = time.monotonic()
        lab.say(f"there is room again, after {full.refusals} refusals to {_PAUSED} alone")
        self._asker.ask(_PAUSED, "inform", inform, patient=True)
        full.taken = time.monotonic()
        lab.say(f"commands are carried out again after {full.taken - full.freed:.2f} s")
        for it in self._client.recordings():
            lab.say(f"recording {it.recording} is {it.phase} {it.reason or ''}")
            if it.phase == "failed":
                full.failed.append(it.recording)

    def _state(self) -> tuple[int, int, int, str]:
        status = self._client.swarm(_PAUSED).status()
        return status.epoch, status.step, status.seq, status.state_hash
