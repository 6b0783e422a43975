"""Every promise of docs/guarantees.md: what the day has seen of it, and whether it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from . import answers, bounds, company, crashes, films
from .finding import Finding
from .lab import Lab
from .plan import Plan

Judge = Callable[[Lab], Finding]
Least = Callable[[Plan], float]


@dataclass(frozen=True)
class Verdict:
    """A promise, and what came of it.

    Attributes:
        about: The part of docs/guarantees.md that it stands in.
        promise: The promise.
        seen: What was seen.
        holds: Whether it holds; None if it cannot be seen from outside.
    """

    about: str
    promise: str
    seen: str
    holds: bool | None


_HOLDS = {True: "holds", False: "DOES NOT HOLD", None: "not seen here"}


def told(verdict: Verdict) -> str:
    """Whether it holds, in words."""
    return _HOLDS[verdict.holds]


def _times(count: int) -> Least:
    """As often, however long the day is."""
    return lambda plan: count


def _a_minute(count: float) -> Least:
    """As often in each minute of the day."""
    return lambda plan: count * plan.seconds / 60.0


@dataclass(frozen=True)
class Judged:
    """What judges a promise, and how many cases it has to have judged for the promise to hold.

    The minimum is about a third of what an hour brings, and less than what five minutes bring.
    """

    judge: Judge
    least: Least


# What cannot be seen from outside is shown by the test that is named.
_PROMISES: list[tuple[str, str, Judged | str]] = [
    (
        "answers",
        "an answered command is taken back by no crash",
        Judged(answers.durable, _a_minute(30)),
    ),
    (
        "answers",
        "up to `durable_step` no step is; beyond, in whole only",
        Judged(answers.steps, _a_minute(7)),
    ),
    ("answers", "with 1,024 steps not yet safe the next waits", "crash::disk::on_a_full_disk"),
    (
        "answers",
        "with `at_step`: carried out then, or dropped by a reset",
        Judged(answers.ahead, _a_minute(2)),
    ),
    (
        "answers",
        "create, fork, delete: what was answered is so",
        Judged(answers.births, _a_minute(5)),
    ),
    ("answers", "an error has changed nothing", Judged(answers.errors, _a_minute(1))),
    (
        "answers",
        "`storage_full` has changed nothing, and ends with it",
        Judged(answers.full, _times(20)),
    ),
    ("answers", "after silence: asked again, it is answered", Judged(answers.silence, _times(2))),
    (
        "exactly once",
        "asked again, the same answer to the byte",
        Judged(answers.again, _a_minute(50)),
    ),
    (
        "exactly once",
        "a step cut short is taken to its end",
        "crash::recovery::a_step_that_a_crash",
    ),
    (
        "exactly once",
        "refused, it may be tried again under its name",
        Judged(answers.tried_again, _times(1)),
    ),
    ("at most once", "without `request_id`: at most once", Judged(answers.nameless, _a_minute(3))),
    (
        "at most once",
        "numbers of events tell what was missed",
        Judged(answers.events, _a_minute(60)),
    ),
    (
        "at most once",
        "no number of an event is given twice",
        Judged(answers.numbers, _a_minute(60)),
    ),
    ("a crash", "`get/journal` does not begin anew", Judged(answers.journal, _times(100))),
    ("a crash", "the past told again has the same hashes", Judged(crashes.verified, _a_minute(30))),
    (
        "a crash",
        "the same commands elsewhere come to the same hash",
        Judged(crashes.elsewhere, _times(1)),
    ),
    (
        "a crash",
        "steps taken anew are the same, and two of one kind",
        Judged(crashes.twins, _a_minute(60)),
    ),
    ("a crash", "the order of commands is kept", Judged(answers.order, _a_minute(30))),
    ("a crash", "`epoch` grows with every start", Judged(crashes.epochs, _times(16))),
    ("a crash", "it listens within 3 s", Judged(crashes.listens, _times(3))),
    ("a crash", "killed at named points of the code", "crash::killed_anywhere"),
    (
        "a crash",
        "no viewer sees a step go back within an epoch",
        Judged(company.viewers, lambda plan: 50 * plan.viewers * plan.seconds / 60.0),
    ),
    (
        "a crash",
        "experiments come to the same, to the byte",
        Judged(crashes.experiments, _times(2)),
    ),
    ("a bad disk", "a failed sync ends the daemon with code 8", "crash::disk::after_a_failed_sync"),
    ("a bad disk", "a damaged file is never taken for what it was", "crash::damage::"),
    (
        "recordings",
        "a crash costs a minute at most, and it goes on by itself",
        Judged(films.crashes, _times(2)),
    ),
    ("recordings", "whole parts stay as they are to the byte", Judged(films.parts, _times(2))),
    (
        "recordings",
        "nothing is missing but what is told as missed",
        Judged(films.gaps, _a_minute(250)),
    ),
    (
        "recordings",
        "a full disk ends one as failed; what it had stays",
        Judged(films.full, _times(1)),
    ),
    ("recordings", "a daemon that is stopped loses nothing", Judged(films.stopped, _times(50))),
    ("recordings", "a swarm waits for the disk", "recording::steps::a_swarm_waits_for_a_slow_disk"),
    ("a replay", "it shows what was published, to the bit", Judged(films.replay, _times(20))),
    ("a replay", "nothing else changes it", Judged(films.replay_refuses, _times(1))),
    ("a replay", "a damaged file is refused whole", "replay::pieces_that_do_not_fit"),
    (
        "controllers",
        "it steps when all have advanced, and not else",
        "controllers::it_steps_when_all",
    ),
    ("controllers", "two never own one individual", Judged(company.owners, _a_minute(20))),
    ("controllers", "nobody waits longer than a deadline", Judged(company.waits, _a_minute(300))),
    ("controllers", "late and lost ones are in the journal", Judged(company.journalled, _times(2))),
    ("controllers", "the order of advancing changes no bit", "controllers::order::the_order"),
    ("controllers", "after a restart it is a member still", Judged(company.members, _times(8))),
    ("controllers", "an advance counts once", Judged(company.advances, _a_minute(300))),
    ("controllers", "whoever waits is answered", Judged(company.answered, _times(4))),
    ("load", "each swarm has its share of the cores", "overload::overloaded_cores"),
    ("load", "the wall clock may jump", "overload::when_the_clock"),
    ("load", "a defect in one step faults that swarm alone", "process::a_defect_in_a_step"),
    ("health", "no swarm has faulted, nothing bad is in the log", Judged(crashes.log, _times(3))),
    (
        "health",
        "red while the disk is full, green after each trouble",
        Judged(company.health, _a_minute(40)),
    ),
    ("health", "memory grows by less than its bound", Judged(bounds.memory, _times(3))),
    (
        "health",
        "descriptors are bounded, and go with who had them",
        Judged(bounds.descriptors, _times(3)),
    ),
    ("health", "threads are bounded", Judged(bounds.threads, _times(3))),
]


def judge(lab: Lab) -> list[Verdict]:
    """Judges every promise."""
    verdicts = []
    for about, promise, judged in _PROMISES:
        if isinstance(judged, str):
            verdicts.append(Verdict(about, promise, f"shown by {judged}", None))
            continue
        finding = judged.judge(lab)
        # Nothing wrong is nothing to name.
        seen = finding.seen.replace(" []", "")
        holds, least = finding.holds, judged.least(lab.plan)
        if holds and finding.cases < least:
            holds, seen = False, f"{seen}: too few to judge, {finding.cases} of {least:g}"
        verdicts.append(Verdict(about, promise, seen, holds))
    return verdicts
