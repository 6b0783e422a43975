"""Scientists: each steers swarms of its own, and asks until it is answered."""

from __future__ import annotations

import json
import random
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import jostle

from .ledger import Asked, Asker, Ledger
from .plan import SPECIAL, Plan, change

# How many share the swarms that are nobody's else.
_SCIENTISTS = 3
_MOMENT_SECS = 0.005


@dataclass
class Nameless:
    """Commands without a `request_id`, each with a direction that no other has.

    Attributes:
        sent: The directions sent, once each.
        answered: Those that were answered.
        refused: Those that were refused.
    """

    sent: list[float] = field(default_factory=list)
    answered: list[float] = field(default_factory=list)
    refused: list[float] = field(default_factory=list)


class Person(threading.Thread):
    """Somebody who does one thing after the other until the day is over."""

    def __init__(self, name: str, endpoint: str, plan: Plan, ledger: Ledger) -> None:
        super().__init__(name=name, daemon=True)
        self.dice = random.Random(f"{plan.seed} {name}")
        self.plan = plan
        self.over = threading.Event()
        # Whether it rests no longer than this moment, so that something is under way at a kill.
        self.is_hasty = False
        self.trouble: BaseException | None = None
        self._client = jostle.connect(endpoint, client=name)
        self.asker = Asker(self._client, name, ledger)
        # Less often on a long day: a swarm's journal tells some hundred commands.
        self._rest_secs = max(0.75, plan.seconds / 1800)

    def run(self) -> None:
        """Lives the day."""
        try:
            self.begin()
            rested, due = 0.0, 0.0
            while not self.over.wait(_MOMENT_SECS):
                rested += _MOMENT_SECS
                if self.is_hasty or rested > due:
                    self.act()
                    rested, due = 0.0, self.dice.uniform(0.4, 1.6) * self._rest_secs
        except BaseException as error:
            self.trouble = error
            raise
        finally:
            self._client.close()

    def begin(self) -> None:
        """What it does first."""

    def act(self) -> None:
        """What it does now."""
        raise NotImplementedError

    def create(self, name: str) -> None:
        """Creates a swarm of the plan."""
        self.asker.ask(None, "create", {"name": name, "spec": self.plan.specs[name]})

    def set_off(self, swarm: str, args: dict[str, Any] | None = None) -> None:
        """Has a swarm run, and waits for its first step: what comes then is at a later one."""
        step = self.asker.ask(swarm, "run", args or {}, patient=True).reply.get("step", 0)
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            try:
                if self._client.swarm(swarm).status().step > step:
                    return
            except jostle.JostleError:
                time.sleep(0.1)


class Scientist(Person):
    """Changes swarms that run, at once or at a step to come, and resets them now and then."""

    def __init__(
        self, name: str, endpoint: str, plan: Plan, ledger: Ledger, swarms: list[str]
    ) -> None:
        super().__init__(name, endpoint, plan, ledger)
        self._swarms = swarms
        self._answered: list[Asked] = []

    def begin(self) -> None:
        """Creates its swarms and has them run."""
        for swarm in self._swarms:
            self.create(swarm)
            self.set_off(swarm)

    def act(self) -> None:
        """Does one thing with one of them."""
        swarm = self.dice.choice(self._swarms)
        match self.dice.randrange(24):
            case 0:
                self.asker.ask(swarm, "pause", {}, patient=True)
                self._note(swarm, *change(self.dice))
                self.set_off(swarm)
            case 1 if swarm != "film":
                self._note(swarm, "reset", {"seed": self.dice.randrange(2**30)})
                if self._answered and self._answered[-1].verb == "reset":
                    self.set_off(swarm)
            case 2 if self._answered:
                self.asker.ask_again(self.dice.choice(self._answered))
            case 3 | 4 | 5:
                verb, args = change(self.dice)
                # What cannot be refused when its step comes: it was carried out, or dropped.
                if verb in ("inform", "set"):
                    self._note(swarm, verb, args, ahead=self.dice.randint(20, 600))
            case 6:
                # Out of its bounds: refused, and nothing may have changed.
                self._note(swarm, "set", {"pi3": -1.0})
            case _:
                self._note(swarm, *change(self.dice))

    def _note(
        self, swarm: str, verb: str, args: dict[str, Any], *, ahead: int | None = None
    ) -> None:
        at_step = None
        if ahead is not None:
            try:
                at_step = self._client.swarm(swarm).status().step + ahead
            except jostle.JostleError:
                return
        # Of what a full disk refuses half is asked for until there is room.
        patient = self.dice.random() < 0.5
        asked = self.asker.ask(swarm, verb, args, at_step=at_step, patient=patient)
        if asked.answer is not None:
            self._answered.append(asked)


class Stepper(Person):
    """Takes a paused swarm on by `step`, and knows what was said to be safe."""

    swarm = "still"

    def begin(self) -> None:
        """Creates the swarm."""
        self.create(self.swarm)

    def act(self) -> None:
        """Some steps, or a change between them."""
        if self.dice.random() < 0.7:
            self.asker.ask(self.swarm, "step", {"steps": self.dice.randint(1, 40)})
        else:
            self.asker.ask(self.swarm, *change(self.dice))


class Twins(Person):
    """Has two equal swarms do the same at the same steps."""

    def begin(self) -> None:
        """Creates both, tells them what is to come, and has them run."""
        for swarm in ("twin-1", "twin-2"):
            self.create(swarm)
            for step, verb, args in self.plan.twin_commands:
                self.asker.ask(swarm, verb, args, at_step=step)
            self.set_off(swarm, {"until_step": self.plan.twin_end})

    def act(self) -> None:
        """Nothing: the rest is theirs."""


class Breeder(Person):
    """Creates, forks and deletes swarms, so that names come and go."""

    def __init__(self, name: str, endpoint: str, plan: Plan, ledger: Ledger) -> None:
        super().__init__(name, endpoint, plan, ledger)
        self.alive: set[str] = set()
        self.gone: set[str] = set()
        # Held while nothing may be deleted: on a full disk a deletion makes room for commands.
        self.deletions = threading.Lock()
        self._count = 0

    def begin(self) -> None:
        """Creates what the others share."""
        self.create("table")
        self.set_off("table")

    def act(self) -> None:
        """A birth or a death."""
        if len(self.alive) < 3 and self.dice.random() < 0.7:
            self._count += 1
            name = f"brood-{self._count}"
            if self.dice.random() < 0.5:
                args = {"name": name, "spec": {"n": self.dice.randint(5, 30)}}
                asked = self.asker.ask(None, "create", args)
            else:
                asked = self.asker.ask("table", "fork", {"name": name})
            if asked.answer is not None:
                self.alive.add(name)
        elif self.alive and self.deletions.acquire(blocking=False):
            try:
                name = self.dice.choice(sorted(self.alive))
                if self.asker.ask(name, "delete", {}).answer is not None:
                    self.alive.remove(name)
                    self.gone.add(name)
            finally:
                self.deletions.release()


class Careless(Person):
    """Sends commands without a name, once each, and never again."""

    swarm = "nameless"

    def __init__(self, name: str, endpoint: str, plan: Plan, ledger: Ledger) -> None:
        super().__init__(name, endpoint, plan, ledger)
        # All of its commands are for one swarm.
        self._rest_secs *= 3.0
        self.nameless = Nameless()

    def begin(self) -> None:
        """Creates the swarm and has it run."""
        self.create(self.swarm)
        self.set_off(self.swarm)

    def act(self) -> None:
        """One such command."""
        link = self._client._link
        direction = self.dice.uniform(-3.0, 3.0)
        args = {"select": {"count": 1}, "direction": direction}
        payload = json.dumps({"client": self.name, "args": args}).encode()
        self.nameless.sent.append(direction)
        try:
            key = link.swarm_key(self.swarm, "cmd/inform")
            if list(link.ask_all(key, 2.0, payload)):
                self.nameless.answered.append(direction)
        except jostle.Unavailable:
            pass
        except jostle.JostleError:
            self.nameless.refused.append(direction)


@dataclass
class People:
    """All of them."""

    scientists: list[Scientist]
    stepper: Stepper
    twins: Twins
    breeder: Breeder
    careless: Careless

    def all(self) -> list[Person]:
        """One after the other."""
        return [*self.scientists, self.stepper, self.twins, self.breeder, self.careless]


def gather(endpoint: str, plan: Plan, ledger: Ledger) -> People:
    """Brings them together; each is yet to begin."""
    swarms = ["film", *(name for name in plan.specs if name not in SPECIAL)]
    return People(
        [
            Scientist(f"scientist-{k + 1}", endpoint, plan, ledger, swarms[k::_SCIENTISTS])
            for k in range(_SCIENTISTS)
        ],
        Stepper("stepper", endpoint, plan, ledger),
        Twins("twins", endpoint, plan, ledger),
        Breeder("breeder", endpoint, plan, ledger),
        Careless("careless", endpoint, plan, ledger),
    )
