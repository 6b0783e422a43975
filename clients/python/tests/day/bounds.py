"""Judges what the daemon takes: memory, descriptors, threads."""

from __future__ import annotations

from typing import Any

from .lab import Lab

# What buffers, pools and the allocator may still come to need: as in tests/daemon/soak.rs.
_GROWTH_MB = 8.0
# What is kept by promise: 256 KiB of journal and 256 KiB of events for each swarm, once.
_KEPT_MB_PER_SWARM = 0.5
# Its own: the database, its log and readers, parts of recordings, listeners, event loops.
_OWN_DESCRIPTORS = 64
# Scientists, controllers, those who look on, and one that is just being replaced.
_OTHER_SESSIONS = 20
# Of zenoh, tokio, the store, publishing, replies, gateway, experiments and recordings.
_OWN_THREADS = 48
# Swarms that come and go, a replay, and one more.
_OTHER_SWARMS = 6


def _lives(lab: Lab) -> list[dict[str, Any]]:
    lives = [lab.meter.life(life) for life in lab.node.lives]
    return [life for life in lives if "threads" in life]


def memory(lab: Lab) -> tuple[bool, str]:
    """By how much it grew over the last two thirds of each life."""
    lives = _lives(lab)
    bound = _GROWTH_MB + _KEPT_MB_PER_SWARM * len(lab.plan.specs)
    said = "; ".join(
        f"{it['grown_mb']:+.1f} MB ({it['slope_mb_per_hour']:+.0f} MB/h), "
        f"{it['memory_mb']['first']:.0f} to {it['memory_mb']['last']:.0f} MB"
        for it in lives
    )
    return all(it["grown_mb"] < bound for it in lives), f"{said}; bound {bound:.0f} MB"


def descriptors(lab: Lab) -> tuple[bool, str]:
    """Never more than there are sessions and its own; at the end, when all have gone, its own."""
    lives = _lives(lab)
    most = max(it["descriptors"]["max"] for it in lives)
    last = lives[-1]["descriptors"]["last"]
    bound = lab.plan.viewers + _OTHER_SESSIONS + _OWN_DESCRIPTORS
    seen = f"at most {most:.0f} of {bound}, {last:.0f} of {_OWN_DESCRIPTORS} when all had gone"
    return most <= bound and last <= _OWN_DESCRIPTORS, seen


def threads(lab: Lab) -> tuple[bool, str]:
    """Never more than one for each swarm, and its own."""
    most = max(it["threads"]["max"] for it in _lives(lab))
    bound = len(lab.plan.specs) + _OTHER_SWARMS + _OWN_THREADS
    return most <= bound, f"at most {most:.0f} of {bound}"
