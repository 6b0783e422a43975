"""Judges the resources that the daemon uses: memory, descriptors, threads."""

from __future__ import annotations

from typing import Any

from .context import Context
from .finding import Finding

# Buffers, pools and the allocator may still grow by this, as in tests/measured/soak.rs.
_GROWTH_MB = 8.0
# Documented caches: 256 KiB of journal and 256 KiB of events of each swarm, and 64 MiB at most for
# the last 100,000 replies.
_CACHE_MB_PER_SWARM = 0.5
_CACHE_MB_PER_REPLY = 64.0 / 100_000
# The daemon's own: the database, its log and readers, parts of recordings, listeners, event loops.
_OWN_DESCRIPTORS = 64
# Sessions of clients, controllers and observers, and one that is being replaced.
_OTHER_SESSIONS = 20
# One for each part of the daemon without any swarm, some of its runtimes, the ten of its lanes, and
# those of waits and, once a controller has joined, of the heartbeat.
_OWN_THREADS = 37
# zenoh's pool for handshakes when all clients connect at once after a kill; it ends when idle.
_HANDSHAKE_THREADS = 50
# Swarms that are created and deleted, a playback, and one more.
_OTHER_SWARMS = 6


def _runs(context: Context) -> list[dict[str, Any]]:
    runs = [context.meter.run_of(run) for run in context.node.runs]
    return [run for run in runs if "threads" in run]


def memory(context: Context) -> Finding:
    """Growth over the last two thirds of each run of the daemon."""
    texts = []
    holds = True
    for run in _runs(context):
        begin, end = run["later"]
        replies = sum(begin < it.answered < end for it in context.requests.all())
        for controller in context.controllers.values():
            replies += sum(begin < it.answered < end for it in controller.exchanges())
        bound = _GROWTH_MB + _CACHE_MB_PER_SWARM * len(context.plan.specs)
        bound += _CACHE_MB_PER_REPLY * replies
        holds &= run["grown_mb"] < bound
        texts.append(
            f"{run['grown_mb']:+.1f} of {bound:.0f} MB at {run['slope_mb_per_hour']:+.0f} MB/h"
        )
    return Finding(holds, "; ".join(texts), len(texts))


def descriptors(context: Context) -> Finding:
    """At most one for each session and the daemon's own; at the end only its own."""
    runs = _runs(context)
    most = max((it["descriptors"]["max"] for it in runs), default=0)
    last = runs[-1]["descriptors"]["last"] if runs else 0
    bound = context.plan.viewers + _OTHER_SESSIONS + _OWN_DESCRIPTORS
    seen = f"at most {most:.0f} of {bound}, {last:.0f} of {_OWN_DESCRIPTORS} without clients"
    return Finding(most <= bound and last <= _OWN_DESCRIPTORS, seen, len(runs))


def threads(context: Context) -> Finding:
    """At most one for each swarm, the daemon's own, and those of handshakes, which end."""
    runs = _runs(context)
    most = max((it["threads"]["max"] for it in runs), default=0)
    last = runs[-1]["threads"]["last"] if runs else 0
    left = len(context.plan.specs) + _OTHER_SWARMS + _OWN_THREADS
    bound = left + _HANDSHAKE_THREADS
    seen = f"at most {most:.0f} of {bound}, {last:.0f} of {left} without clients"
    return Finding(most <= bound and last <= left, seen, len(runs))
