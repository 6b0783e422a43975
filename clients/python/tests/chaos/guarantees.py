"""Every guarantee of docs/guarantees.md: the judge of it, or the test that shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from . import controllers, crashes, recordings, replies, resources
from .context import Context
from .finding import Finding
from .plan import Plan

Judge = Callable[[Context], Finding]
Minimum = Callable[[Plan], float]

# A run this long has enough cases of every guarantee: with fewer of them it is broken.
FULL_SECS = 300.0


@dataclass(frozen=True)
class Verdict:
    """A guarantee, and whether it held.

    Attributes:
        about: Its part of docs/guarantees.md.
        guarantee: The guarantee.
        seen: The cases and violations.
        holds: Whether it held; None if the run did not judge it.
        test: The test that shows it, if no run can, else empty.
    """

    about: str
    guarantee: str
    seen: str
    holds: bool | None
    test: str = ""


def _times(count: int) -> Minimum:
    """This many cases, however long the run is."""
    return lambda plan: count


def _per_minute(count: float) -> Minimum:
    """This many cases in each minute of the run."""
    return lambda plan: count * plan.seconds / 60.0


@dataclass(frozen=True)
class Judged:
    """The judge of a guarantee, and the least number of cases that confirms it.

    The number is about a third of the cases of an hour, and less than those of five minutes.
    """

    judge: Judge
    minimum: Minimum


# A guarantee that clients cannot observe has the name of its test in place of a judge.
_GUARANTEES: list[tuple[str, str, Judged | str]] = [
    (
        "replies",
        "no crash takes back a command with a reply",
        Judged(replies.durable, _per_minute(30)),
    ),
    (
        "replies",
        "no crash takes back steps up to `durable_step`; later ones only as a whole",
        Judged(replies.steps, _per_minute(7)),
    ),
    (
        "replies",
        "with 1,024 steps that are not durable the next one waits",
        "crash::disk::on_a_full_disk",
    ),
    (
        "replies",
        "a command with `at_step` is executed at that step, or dropped by a reset",
        Judged(replies.scheduled, _per_minute(2)),
    ),
    (
        "replies",
        "create, fork and delete with a reply are durable",
        Judged(replies.existence, _per_minute(5)),
    ),
    ("replies", "a command with an error changes nothing", Judged(replies.errors, _per_minute(1))),
    (
        "replies",
        "`storage_full` changes nothing, and ends when there is space",
        Judged(replies.full, _times(20)),
    ),
    (
        "replies",
        "a request without a reply gets one when it is sent again",
        Judged(replies.timeouts, _times(2)),
    ),
    (
        "exactly once",
        "a request sent again gets the same reply, byte for byte",
        Judged(replies.resent, _per_minute(50)),
    ),
    (
        "exactly once",
        "recovery completes an interrupted step",
        "crash::recovery::a_step_that_a_crash",
    ),
    (
        "exactly once",
        "a rejected request can be retried under its `request_id`",
        Judged(replies.retried, _times(1)),
    ),
    (
        "at most once",
        "a command without `request_id` is executed at most once",
        Judged(replies.unnamed, _per_minute(3)),
    ),
    (
        "at most once",
        "numbers of events show which ones are missing",
        Judged(replies.events, _per_minute(60)),
    ),
    (
        "at most once",
        "no two events have the same number",
        Judged(replies.numbers, _per_minute(60)),
    ),
    (
        "a crash",
        "`get/journal` has the same entries after a restart",
        Judged(replies.journal, _times(100)),
    ),
    ("a crash", "`verify` finds equal hashes", Judged(crashes.verified, _per_minute(30))),
    (
        "a crash",
        "the same commands on another daemon give the same hash",
        Judged(crashes.reexecuted, _times(1)),
    ),
    (
        "a crash",
        "repeated steps give the same state, and so do two equal swarms",
        Judged(crashes.twins, _per_minute(60)),
    ),
    ("a crash", "commands keep their order", Judged(replies.order, _per_minute(30))),
    ("a crash", "`epoch` increases with every start", Judged(crashes.epochs, _times(16))),
    ("a crash", "the daemon listens within 3 s", Judged(crashes.listens, _times(3))),
    ("a crash", "kills at failpoints of the code", "crash::a_kill_anywhere"),
    (
        "a crash",
        "steps never decrease within an epoch for a viewer",
        Judged(controllers.viewers, lambda plan: 50 * plan.viewers * plan.seconds / 60.0),
    ),
    (
        "a crash",
        "experiments give the same tables, byte for byte",
        Judged(crashes.experiments, _times(2)),
    ),
    ("a bad disk", "a failed sync ends the daemon with code 8", "crash::disk::after_a_failed_sync"),
    ("a bad disk", "the daemon detects every damaged file", "crash::damage::"),
    (
        "recordings",
        "a crash costs a minute at most, and the recording continues",
        Judged(recordings.crashes, _times(2)),
    ),
    ("recordings", "complete parts never change", Judged(recordings.parts, _times(2))),
    (
        "recordings",
        "only frames counted as missed are missing",
        Judged(recordings.gaps, _per_minute(250)),
    ),
    (
        "recordings",
        "on a full disk a recording fails, and its frames stay readable",
        Judged(recordings.full, _times(1)),
    ),
    ("recordings", "stopping the daemon loses no frame", Judged(recordings.stopped, _times(50))),
    ("recordings", "a swarm waits for the disk", "recording::steps::a_swarm_waits_for_a_slow_disk"),
    (
        "a playback",
        "it publishes the recorded states, bit for bit",
        Judged(recordings.playback, _times(20)),
    ),
    (
        "a playback",
        "it rejects all changes, and ends with the daemon",
        Judged(recordings.playback_rejects, _times(1)),
    ),
    ("a playback", "a damaged file is rejected as a whole", "replay::pieces_that_do_not_fit"),
    (
        "controllers",
        "the swarm steps exactly when all controllers have advanced",
        "controllers::a_swarm_steps_when_all",
    ),
    (
        "controllers",
        "no individual has two controllers",
        Judged(controllers.owners, _per_minute(20)),
    ),
    (
        "controllers",
        "no advance waits longer than a deadline",
        Judged(controllers.waits, _per_minute(300)),
    ),
    (
        "controllers",
        "missed deadlines and lost controllers are in the journal",
        Judged(controllers.journalled, _times(2)),
    ),
    (
        "controllers",
        "the order of advances does not change the state",
        "controllers::order::the_order",
    ),
    (
        "controllers",
        "after a restart of the daemon a controller is still a member",
        Judged(controllers.members, _times(8)),
    ),
    ("controllers", "an advance counts once", Judged(controllers.advances, _per_minute(300))),
    ("controllers", "every advance gets a reply", Judged(controllers.answered, _times(4))),
    ("load", "each swarm has its share of the cores", "overload::overloaded_cores"),
    ("load", "a jump of the wall clock has no effect", "overload::when_the_clock"),
    ("load", "a defect in a step faults that swarm only", "process::a_panic_in_a_step"),
    (
        "health",
        "no swarm has faulted, and the log has no sign of a defect",
        Judged(crashes.log, _times(3)),
    ),
    (
        "health",
        "the daemon is unhealthy while the disk is full, and healthy after each fault",
        Judged(controllers.health, _per_minute(40)),
    ),
    ("health", "memory grows by less than its bound", Judged(resources.memory, _times(3))),
    (
        "health",
        "descriptors are bounded, and closed with their sessions",
        Judged(resources.descriptors, _times(3)),
    ),
    ("health", "threads are bounded", Judged(resources.threads, _times(3))),
]


def judge(context: Context) -> list[Verdict]:
    """Judges every guarantee.

    One that holds in too few cases is violated; in a run shorter than `FULL_SECS` it is not judged.
    """
    verdicts = []
    for about, guarantee, judged in _GUARANTEES:
        if isinstance(judged, str):
            verdicts.append(Verdict(about, guarantee, "", None, judged))
            continue
        finding = judged.judge(context)
        # Empty lists of violations are left out.
        seen = finding.seen.replace(" []", "")
        holds, minimum = finding.holds, judged.minimum(context.plan)
        if holds and finding.cases < minimum:
            holds = None if context.plan.seconds < FULL_SECS else False
            seen = f"{seen}: too few cases, {finding.cases} of {minimum:g}"
        verdicts.append(Verdict(about, guarantee, seen, holds))
    return verdicts
