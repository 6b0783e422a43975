"""Clients that send commands, each to swarms of its own, until each command has a reply."""

from __future__ import annotations

import json
import random
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import jostle

from .plan import SPECIAL, Plan, change
from .requests import Request, Requester, RequestLog

# How many clients share the swarms without a role of their own.
_MIXED_CLIENTS = 3
_POLL_SECS = 0.005


@dataclass
class UnnamedRequests:
    """Commands without a `request_id`, each with a direction of its own.

    Attributes:
        sent: The directions sent, once each.
        answered: Those with a reply.
        rejected: Those with an error.
    """

    sent: list[float] = field(default_factory=list)
    answered: list[float] = field(default_factory=list)
    rejected: list[float] = field(default_factory=list)


class ClientThread(threading.Thread):
    """A client that sends one command after the other until it is stopped."""

    def __init__(self, name: str, endpoint: str, plan: Plan, requests: RequestLog) -> None:
        super().__init__(name=name, daemon=True)
        self.rng = random.Random(f"{plan.seed} {name}")
        self.plan = plan
        self.stop_event = threading.Event()
        # Whether it sends without pauses, so that requests are pending at a kill.
        self.without_pause = False
        self.failure: BaseException | None = None
        self._client = jostle.connect(endpoint, client=name)
        self.requester = Requester(self._client, name, requests)
        # Longer in a long run: `get/journal` returns the last hundreds of commands only.
        self._pause_secs = max(0.75, plan.seconds / 1800)

    def run(self) -> None:
        """Sends commands until it is stopped."""
        try:
            self.prepare()
            paused, due = 0.0, 0.0
            while not self.stop_event.wait(_POLL_SECS):
                paused += _POLL_SECS
                if self.without_pause or paused > due:
                    self.act()
                    paused, due = 0.0, self.rng.uniform(0.4, 1.6) * self._pause_secs
        except BaseException as error:
            self.failure = error
            raise
        finally:
            self._client.close()

    def prepare(self) -> None:
        """Creates its swarms."""

    def act(self) -> None:
        """Sends the next command."""
        raise NotImplementedError

    def create(self, name: str) -> None:
        """Creates a swarm of the plan."""
        self.requester.send(None, "create", {"name": name, "spec": self.plan.specs[name]})

    def start_running(self, swarm: str, args: dict[str, Any] | None = None) -> None:
        """Runs a swarm, and waits for its first step, so that later commands have a later step."""
        step = self.requester.send(swarm, "run", args or {}, retry_when_full=True).reply.get(
            "step", 0
        )
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            try:
                if self._client.swarm(swarm).status().step > step:
                    return
            except jostle.JostleError:
                time.sleep(0.1)


class MixedClient(ClientThread):
    """Changes running swarms, at once or scheduled, and sometimes resets them."""

    def __init__(
        self, name: str, endpoint: str, plan: Plan, requests: RequestLog, swarms: list[str]
    ) -> None:
        super().__init__(name, endpoint, plan, requests)
        self._swarms = swarms
        self._answered: list[Request] = []

    def prepare(self) -> None:
        """Creates and runs its swarms."""
        for swarm in self._swarms:
            self.create(swarm)
            self.start_running(swarm)

    def act(self) -> None:
        """Sends one command to one of its swarms."""
        swarm = self.rng.choice(self._swarms)
        match self.rng.randrange(24):
            case 0:
                self.requester.send(swarm, "pause", {}, retry_when_full=True)
                self._send(swarm, *change(self.rng))
                self.start_running(swarm)
            case 1 if swarm != "recorded":
                self._send(swarm, "reset", {"seed": self.rng.randrange(2**30)})
                if self._answered and self._answered[-1].verb == "reset":
                    self.start_running(swarm)
            case 2 if self._answered:
                self.requester.resend(self.rng.choice(self._answered))
            case 3 | 4 | 5:
                verb, args = change(self.rng)
                # Verbs that are not rejected when their step is reached: executed or dropped.
                if verb in ("inform", "set"):
                    self._send(swarm, verb, args, ahead=self.rng.randint(20, 600))
            case 6:
                # Out of range: rejected, and nothing may change.
                self._send(swarm, "set", {"pi3": -1.0})
            case _:
                self._send(swarm, *change(self.rng))

    def _send(
        self, swarm: str, verb: str, args: dict[str, Any], *, ahead: int | None = None
    ) -> None:
        at_step = None
        if ahead is not None:
            try:
                at_step = self._client.swarm(swarm).status().step + ahead
            except jostle.JostleError:
                return
        # Half of the commands rejected with `storage_full` are retried until there is space.
        retry = self.rng.random() < 0.5
        request = self.requester.send(swarm, verb, args, at_step=at_step, retry_when_full=retry)
        if request.answer is not None:
            self._answered.append(request)


class StepClient(ClientThread):
    """Advances a paused swarm by `step`."""

    swarm = "stepped"

    def prepare(self) -> None:
        """Creates the swarm."""
        self.create(self.swarm)

    def act(self) -> None:
        """Sends some steps, or a change between them."""
        if self.rng.random() < 0.7:
            self.requester.send(self.swarm, "step", {"steps": self.rng.randint(1, 40)})
        else:
            self.requester.send(self.swarm, *change(self.rng))


class TwinClient(ClientThread):
    """Schedules the same commands for the same steps of two equal swarms."""

    def prepare(self) -> None:
        """Creates both, schedules all commands, and runs them."""
        for swarm in ("twin-1", "twin-2"):
            self.create(swarm)
            for step, verb, args in self.plan.twin_commands:
                self.requester.send(swarm, verb, args, at_step=step)
            self.start_running(swarm, {"until_step": self.plan.twin_end})

    def act(self) -> None:
        """Does nothing: all commands are scheduled."""


class LifecycleClient(ClientThread):
    """Creates, forks and deletes swarms."""

    def __init__(self, name: str, endpoint: str, plan: Plan, requests: RequestLog) -> None:
        super().__init__(name, endpoint, plan, requests)
        self.existing: set[str] = set()
        self.deleted: set[str] = set()
        # Held while nothing may be deleted: on a full disk a deletion frees space for commands.
        self.deletions = threading.Lock()
        self._count = 0

    def prepare(self) -> None:
        """Creates the swarm that is forked."""
        self.create("forked")
        self.start_running("forked")

    def act(self) -> None:
        """Creates, forks or deletes a swarm."""
        if len(self.existing) < 3 and self.rng.random() < 0.7:
            self._count += 1
            name = f"short-lived-{self._count}"
            if self.rng.random() < 0.5:
                args = {"name": name, "spec": {"n": self.rng.randint(5, 30)}}
                request = self.requester.send(None, "create", args)
            else:
                request = self.requester.send("forked", "fork", {"name": name})
            if request.answer is not None:
                self.existing.add(name)
        elif self.existing and self.deletions.acquire(blocking=False):
            try:
                name = self.rng.choice(sorted(self.existing))
                if self.requester.send(name, "delete", {}).answer is not None:
                    self.existing.remove(name)
                    self.deleted.add(name)
            finally:
                self.deletions.release()


class UnnamedClient(ClientThread):
    """Sends commands without a `request_id`, once each."""

    swarm = "unnamed"

    def __init__(self, name: str, endpoint: str, plan: Plan, requests: RequestLog) -> None:
        super().__init__(name, endpoint, plan, requests)
        # Fewer, since all of its commands are for one swarm.
        self._pause_secs *= 3.0
        self.requests = UnnamedRequests()

    def prepare(self) -> None:
        """Creates and runs the swarm."""
        self.create(self.swarm)
        self.start_running(self.swarm)

    def act(self) -> None:
        """Sends one such command."""
        session = self._client._session
        direction = self.rng.uniform(-3.0, 3.0)
        args = {"select": {"count": 1}, "direction": direction}
        payload = json.dumps({"client": self.name, "args": args}).encode()
        self.requests.sent.append(direction)
        try:
            key = session.swarm_key(self.swarm, "cmd/inform")
            if list(session.query_all(key, 2.0, payload)):
                self.requests.answered.append(direction)
        except jostle.Unavailable:
            pass
        except jostle.JostleError:
            self.requests.rejected.append(direction)


@dataclass
class Clients:
    """All clients."""

    mixed: list[MixedClient]
    stepper: StepClient
    twins: TwinClient
    lifecycle: LifecycleClient
    unnamed: UnnamedClient

    def all(self) -> list[ClientThread]:
        """All clients as threads."""
        return [*self.mixed, self.stepper, self.twins, self.lifecycle, self.unnamed]


def create_all(endpoint: str, plan: Plan, requests: RequestLog) -> Clients:
    """All clients, not started."""
    swarms = ["recorded", *(name for name in plan.specs if name not in SPECIAL)]
    return Clients(
        [
            MixedClient(f"client-{k + 1}", endpoint, plan, requests, swarms[k::_MIXED_CLIENTS])
            for k in range(_MIXED_CLIENTS)
        ],
        StepClient("stepper", endpoint, plan, requests),
        TwinClient("twins", endpoint, plan, requests),
        LifecycleClient("lifecycle", endpoint, plan, requests),
        UnnamedClient("unnamed", endpoint, plan, requests),
    )
