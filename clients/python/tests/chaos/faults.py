"""Injects the faults of the plan, and records, plays back and submits experiments."""

from __future__ import annotations

import contextlib
import hashlib
import signal
import time
from collections.abc import Callable

import numpy as np

import jostle

from .context import Context, RecordingSpan, wait_until
from .requests import Requester

# For this time before a kill clients send requests without pauses.
_BUSY_SECS = 0.3
_PAUSED = "paused"
# Deleted while the disk is full.
_SPARE = "short-lived-spare"
# A line of progress is printed at least this often.
_PROGRESS_SECS = 15.0


class FaultSchedule:
    """Carries out the schedule of the plan."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._client = jostle.connect(context.node.endpoint, client="faults")
        self._requester = Requester(self._client, "faults", context.requests)

    def run(self) -> None:
        """Carries out the schedule from begin to end."""
        plan = self._context.plan
        due: list[tuple[float, Callable[[], None]]] = [
            (0.0, self._begin),
            (plan.kill_controller, self._kill_controller),
            (plan.first_kill - plan.submit_secs, lambda: self._submit(1)),
            (plan.first_kill, self._kill_node),
            (plan.stop_recording, self._play_back),
            (plan.freeze_controller, self._freeze_controller),
            (plan.fill, self._fill_disk),
            (plan.record_again, lambda: self._record("recorded-3", "recorded")),
            (plan.second_kill - plan.submit_secs, lambda: self._submit(2)),
            (plan.second_kill, self._kill_node),
        ]
        for at, action in due:
            self._sleep(at)
            action()
        while time.monotonic() < self._context.began + plan.seconds:
            self._sleep(min(plan.seconds, time.monotonic() - self._context.began + _PROGRESS_SECS))
            self._print_progress()
        self._client.close()

    def _sleep(self, until: float) -> None:
        while (left := self._context.began + until - time.monotonic()) > 0.0:
            time.sleep(min(left, _PROGRESS_SECS))
            if left > _PROGRESS_SECS:
                self._print_progress()

    def _print_progress(self) -> None:
        context = self._context
        requests = context.requests.all()
        answered = sum(1 for one in requests if one.answer is not None)
        last = context.meter.samples[-1]
        slowest = "-" if last.slowest is None else f"{last.slowest:.2f}"
        context.log(
            f"{answered} replies to {len(requests)} commands, {last.memory_kb / 1024:.0f} MB, "
            f"{last.descriptors} descriptors, {last.threads} threads, slowest at {slowest}, "
            f"disk {context.disk.used_megabytes():.0f} of {context.disk.megabytes} MB"
        )

    def _begin(self) -> None:
        self._requester.send(None, "create", {"name": _PAUSED, "spec": {"n": 20}})
        self._requester.send(_PAUSED, "step", {"steps": 100})
        self._requester.send(None, "create", {"name": _SPARE, "spec": {"n": 20}})
        wait_until("swarms to record", 20.0, lambda: self._exist({"recorded", "forked"}))
        self._record("recorded-1", "recorded")
        self._record("forked-1", "forked")

    def _exist(self, swarms: set[str]) -> bool:
        return swarms <= {it.swarm for it in self._client.swarms()}

    def _record(self, recording: str, swarm: str) -> None:
        begin = {"swarm": swarm, "recording": recording}
        step = self._client.swarm(swarm).status().step
        self._context.observed.recorded[recording] = RecordingSpan(swarm, time.monotonic(), step)
        request = self._requester.send(None, "record", {"begin": begin})
        self._context.log(f"{swarm} is recorded: {recording} {request.errors or ''}")

    def _submit(self, number: int) -> None:
        toml = self._context.plan.experiment(number)
        request = self._requester.send(None, "experiment", {"submit": {"toml": toml}})
        self._context.log(f"experiment grid-{number} submitted {request.errors or ''}")

    def _kill_controller(self) -> None:
        context = self._context
        swarm = self._client.swarm("loop-1")

        def only_ada_is_missing() -> bool:
            # Then bob has sent an advance and waits for its reply.
            with contextlib.suppress(jostle.JostleError):
                return [it.controller for it in swarm.status().waiting_for] == ["ada"]
            return False

        wait_until("bob waits", 20.0, only_ada_is_missing)
        context.controllers["bob"].signal(signal.SIGKILL)
        context.log("killed the process of controller bob during an exchange")
        time.sleep(min(3.0, 0.02 * context.plan.seconds))
        context.controllers["bob"].start()
        context.log("restarted controller bob")

    def _freeze_controller(self) -> None:
        context = self._context
        began = time.monotonic()
        context.controllers["dan"].signal(signal.SIGSTOP)
        context.log(f"stopped the process of controller dan for {context.plan.freeze_secs:.1f} s")
        time.sleep(context.plan.freeze_secs)
        context.controllers["dan"].signal(signal.SIGCONT)
        context.observed.frozen = (began, time.monotonic())
        context.log("resumed controller dan")

    def _kill_node(self) -> None:
        context = self._context
        context.meter.sample()
        with contextlib.suppress(jostle.JostleError):
            for it in self._client.experiments():
                context.log(f"{it.name} is {it.phase}, {it.finished} of {it.runs} runs finished")
        for client in context.clients.all():
            client.without_pause = True
        time.sleep(_BUSY_SECS)
        statuses = {name: self._client.swarm(name).status() for name in ("recorded", "forked")}
        context.observed.steps.append({name: (it.epoch, it.step) for name, it in statuses.items()})
        context.node.kill()
        for client in context.clients.all():
            client.without_pause = False
        context.observed.kills.append(time.monotonic())
        context.observed.parts.append(self._complete_parts())
        context.log("killed the daemon")
        run = context.node.start()
        context.log(f"restarted the daemon: it listens after {run.listening - run.began:.2f} s")

    def _complete_parts(self) -> dict[str, str]:
        folder = self._context.node.data / "recordings"
        return {
            str(part.relative_to(folder)): hashlib.sha256(part.read_bytes()).hexdigest()
            for part in sorted(folder.glob("*/part-*"))
            if part.suffix == ".mcap"
        }

    def _play_back(self) -> None:
        context = self._context
        self._requester.send(None, "record", {"stop": {"recording": "recorded-1"}})
        context.observed.recorded["recorded-1"].ended = time.monotonic()
        self._record("recorded-2", "recorded")
        seen = context.observed.playback
        try:
            frames = list(jostle.read_recording(context.node.data / "recordings" / "recorded-1"))
            with self._client.replay(recording="recorded-1", name="playback") as playback:
                replay = playback.status().replay
                seen["frames"] = (0 if replay is None else replay.frames, len(frames))
                seen["compared"] = seen["different"] = 0
                for k in range(0, len(frames), max(1, len(frames) // 40)):
                    playback.seek(fraction=k / max(1, len(frames) - 1))
                    shown = playback.state()
                    same = [it for it in frames if it.step == shown.step]
                    seen["compared"] += 1
                    if not any(np.array_equal(shown.position, it.position) for it in same):
                        seen["different"] += 1
                try:
                    playback.inform(jostle.ids([0]), direction=0.0)
                    seen["inform"] = "executed"
                except jostle.JostleError as error:
                    seen["inform"] = error.code
                playback.run(rate=4.0)
        except jostle.JostleError as error:
            seen["error"] = f"{error.code}: {error}"
        context.log(f"played recorded-1 back: {seen}")

    def _fill_disk(self) -> None:
        with self._context.clients.lifecycle.deletions:
            self._fill_until_free()

    def _fill_until_free(self) -> None:
        context, full = self._context, self._context.observed.full
        context.disk.fill()
        full.filled = time.monotonic()
        context.log("the disk is full")
        inform = {"select": {"count": 1}, "direction": 1.0}
        # Commands are rejected once the reserved space is used up.
        while not full.rejected_at and time.monotonic() < full.filled + 30.0:
            if "storage_full" in self._requester.send(_PAUSED, "inform", inform).errors:
                full.rejected_at = time.monotonic()
        context.log(f"commands are rejected after {full.rejected_at - full.filled:.2f} s")
        recorded = self._client.swarm("recorded")
        first = recorded.status().step
        free = context.began + context.plan.free
        while time.monotonic() < free - 1.0:
            # A part of a recording that is abandoned frees a little space.
            context.disk.fill()
            before = self._state()
            errors = self._requester.send(_PAUSED, "inform", inform).errors
            if errors == ["storage_full"]:
                full.rejections += 1
                full.changed += before != self._state()
            else:
                full.others += errors
            time.sleep(0.25)
        full.ran = recorded.status().step - first
        reply = self._requester.send(_PAUSED, "step", {"steps": 3}).reply
        if reply:
            full.stepped = (reply["step"], reply["result"]["durable_step"])
        full.deleted = self._requester.send(_SPARE, "delete", {}).answer is not None
        if full.deleted:
            context.clients.lifecycle.deleted.add(_SPARE)
        context.disk.free()
        full.freed = time.monotonic()
        context.log(f"freed the disk, after {full.rejections} rejections by swarm {_PAUSED}")
        self._requester.send(_PAUSED, "inform", inform, retry_when_full=True)
        full.accepted = time.monotonic()
        context.log(f"commands are executed again after {full.accepted - full.freed:.2f} s")
        for it in self._client.recordings():
            context.log(f"recording {it.recording} is {it.phase} {it.reason or ''}")
            if it.phase == "failed":
                full.failed.append(it.recording)

    def _state(self) -> tuple[int, int, int, str]:
        status = self._client.swarm(_PAUSED).status()
        return status.epoch, status.step, status.seq, status.state_hash
