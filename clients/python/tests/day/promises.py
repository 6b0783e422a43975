"""Every promise of docs/guarantees.md: what the day has seen of it, and whether it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from . import answers, bounds, company, crashes, films
from .lab import Lab

Judge = Callable[[Lab], tuple[bool | None, str]]


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


# What cannot be seen from outside is shown by the test that is named.
_PROMISES: list[tuple[str, str, Judge | str]] = [
    ("answers", "an answered command is taken back by no crash", answers.durable),
    ("answers", "up to `durable_step` no step is; beyond, in whole only", answers.steps),
    ("answers", "with 1,024 steps not yet safe the next waits", "crash::disk::on_a_full_disk"),
    ("answers", "with `at_step`: carried out then, or dropped by a reset", answers.ahead),
    ("answers", "create, fork, delete: what was answered is so", answers.births),
    ("answers", "an error has changed nothing", answers.errors),
    ("answers", "`storage_full` has changed nothing, and ends with it", answers.full),
    ("answers", "after silence: asked again, it is answered", answers.silence),
    ("exactly once", "asked again, the same answer to the byte", answers.again),
    (
        "exactly once",
        "a step cut short is taken to its end",
        "crash::recovery::a_step_that_a_crash",
    ),
    ("exactly once", "refused, it may be tried again under its name", answers.tried_again),
    ("at most once", "without `request_id`: at most once", answers.nameless),
    ("at most once", "numbers of events tell what was missed", answers.events),
    ("at most once", "no number of an event is given twice", answers.numbers),
    ("a crash", "`get/journal` does not begin anew", answers.journal),
    ("a crash", "the past told again has the same hashes", crashes.verified),
    ("a crash", "the same commands elsewhere come to the same hash", crashes.elsewhere),
    ("a crash", "steps taken anew are the same, and two of one kind", crashes.twins),
    ("a crash", "the order of commands is kept", answers.order),
    ("a crash", "`epoch` grows with every start", crashes.epochs),
    ("a crash", "it listens within 3 s", crashes.listens),
    ("a crash", "killed at named points of the code", "crash::killed_anywhere"),
    ("a crash", "no viewer sees a step go back within an epoch", company.viewers),
    ("a crash", "experiments come to the same, to the byte", crashes.experiments),
    ("a bad disk", "a failed sync ends the daemon with code 8", "crash::disk::after_a_failed_sync"),
    ("a bad disk", "a damaged file is never taken for what it was", "crash::damage::"),
    ("recordings", "a crash costs a minute at most, and it goes on by itself", films.crashes),
    ("recordings", "whole parts stay as they are to the byte", films.parts),
    ("recordings", "nothing is missing but what is told as missed", films.gaps),
    ("recordings", "a full disk ends one as failed; what it had stays", films.full),
    ("recordings", "a daemon that is stopped loses nothing", films.stopped),
    ("recordings", "a swarm waits for the disk", "recording::steps::a_swarm_waits_for_a_slow_disk"),
    ("a replay", "it shows what was published, to the bit", films.replay),
    ("a replay", "nothing else changes it", films.replay_refuses),
    ("a replay", "a damaged file is refused whole", "replay::pieces_that_do_not_fit"),
    (
        "controllers",
        "it steps when all have advanced, and not else",
        "controllers::it_steps_when_all",
    ),
    ("controllers", "two never own one individual", company.owners),
    ("controllers", "nobody waits longer than a deadline", company.waits),
    ("controllers", "late and lost ones are in the journal", company.journalled),
    ("controllers", "the order of advancing changes no bit", "controllers::the_order_in_which"),
    ("controllers", "after a restart it is a member still", company.members),
    ("controllers", "an advance counts once", company.advances),
    ("controllers", "whoever waits is answered", company.answered),
    ("load", "each swarm has its share of the cores", "overload::overloaded_cores"),
    ("load", "the wall clock may jump", "overload::when_the_clock"),
    ("load", "a defect in one step faults that swarm alone", "process::a_defect_in_a_step"),
    ("health", "no swarm has faulted, nothing bad is in the log", crashes.log),
    ("health", "red while the disk is full, green after each trouble", company.health),
    ("health", "memory does not grow", bounds.memory),
    ("health", "descriptors are bounded, and go with who had them", bounds.descriptors),
    ("health", "threads are bounded", bounds.threads),
]


def judge(lab: Lab) -> list[Verdict]:
    """Judges every promise."""
    verdicts = []
    for about, promise, judge in _PROMISES:
        if isinstance(judge, str):
            verdicts.append(Verdict(about, promise, f"shown by {judge}", None))
            continue
        holds, seen = judge(lab)
        # Nothing wrong is nothing to name.
        verdicts.append(Verdict(about, promise, seen.replace(" []", ""), holds))
    return verdicts
