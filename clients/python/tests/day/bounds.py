"""Judges what the daemon takes: memory, descriptors, threads."""

from __future__ import annotations

from typing import Any

from .finding import Finding
from .lab import Lab

# What buffers, pools and the allocator may still come to need: as in tests/daemon/soak.rs.
_GROWTH_MB = 8.0
# What is kept by promise: 256 KiB of journal and 256 KiB of events of each swarm, and of the last
# 100,000 answers 64 MiB at most.
_KEPT_MB_PER_SWARM = 0.5
_KEPT_MB_PER_ANSWER = 64.0 / 100_000
# Its own: the database, its log and readers, parts of recordings, listeners, event loops.
_OWN_DESCRIPTORS = 64
# Scientists, controllers, those who look on, and one that is just being replaced.
_OTHER_SESSIONS = 20
# One for each part of the daemon, as it has them before there is a swarm, and some of its runtimes.
_OWN_THREADS = 28
# zenoh's pool for handshakes when all connect at once, as they do after a kill; it goes when idle.
_HANDSHAKES = 50
# Swarms that come and go, a replay, and one more.
_OTHER_SWARMS = 6


def _lives(lab: Lab) -> list[dict[str, Any]]:
    lives = [lab.meter.life(life) for life in lab.node.lives]
    return [life for life in lives if "threads" in life]


def memory(lab: Lab) -> Finding:
    """By how much it grew over the last two thirds of each life."""
    said = []
    holds = True
    for life in _lives(lab):
        begin, end = life["later"]
        answers = sum(begin < it.answered < end for it in lab.ledger.all())
        for controller in lab.controllers.values():
            answers += sum(begin < it.answered < end for it in controller.exchanges())
        bound = _GROWTH_MB + _KEPT_MB_PER_SWARM * len(lab.plan.specs)
        bound += _KEPT_MB_PER_ANSWER * answers
        holds &= life["grown_mb"] < bound
        said.append(
            f"{life['grown_mb']:+.1f} of {bound:.0f} MB at {life['slope_mb_per_hour']:+.0f} MB/h"
        )
    return Finding(holds, "; ".join(said), len(said))


def descriptors(lab: Lab) -> Finding:
    """Never more than there are sessions and its own; at the end, when all have gone, its own."""
    lives = _lives(lab)
    most = max((it["descriptors"]["max"] for it in lives), default=0)
    last = lives[-1]["descriptors"]["last"] if lives else 0
    bound = lab.plan.viewers + _OTHER_SESSIONS + _OWN_DESCRIPTORS
    seen = f"at most {most:.0f} of {bound}, {last:.0f} of {_OWN_DESCRIPTORS} when all had gone"
    return Finding(most <= bound and last <= _OWN_DESCRIPTORS, seen, len(lives))


def threads(lab: Lab) -> Finding:
    """Never more than one for each swarm, its own, and those of handshakes, which go."""
    lives = _lives(lab)
    most = max((it["threads"]["max"] for it in lives), default=0)
    last = lives[-1]["threads"]["last"] if lives else 0
    left = len(lab.plan.specs) + _OTHER_SWARMS + _OWN_THREADS
    bound = left + _HANDSHAKES
    seen = f"at most {most:.0f} of {bound}, {last:.0f} of {left} when all had gone"
    return Finding(most <= bound and last <= left, seen, len(lives))
