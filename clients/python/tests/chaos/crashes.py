"""Judges what is left after crashes: replayed histories, here and on another daemon."""

from __future__ import annotations

import itertools

import jostle

from . import shutdown
from .context import Context
from .finding import Finding

# The daemon has to listen within this time with a hundred running swarms.
_LISTENING_SECS = 3.0


def verified(context: Context) -> Finding:
    """`verify` finds no difference in the history of any swarm."""
    wrong = []
    hashes = 0
    for name, result in context.observed.verified.items():
        if isinstance(result, jostle.Verified) and result.differs_at is None:
            hashes += result.hashes
        else:
            wrong.append(f"{name}: {result}")
    seen = f"{len(context.observed.verified)} swarms, {hashes} hashes"
    return Finding(not wrong, f"{seen}, {len(wrong)} swarms differ {wrong[:3]}", hashes)


def reexecuted(context: Context) -> Finding:
    """The commands of the journal give the same state on another daemon without faults."""
    results = context.observed.reexecuted
    wrong = [f"{name}: {it[1]}" for name, it in results.items() if it[0] != it[1]]
    expected = {it for it in context.plan.specs if not it.startswith(shutdown.NOT_REEXECUTED)}
    wrong += [f"{name}: not executed" for name in sorted(expected - set(results))]
    seen = f"{len(results)} swarms, {len(wrong)} differ {wrong[:3]}"
    return Finding(not wrong, seen, len(results))


def twins(context: Context) -> Finding:
    """Two swarms of the same spec and commands are equal at each step, in every epoch."""
    bodies: dict[str, dict[int, int]] = {"twin-1": {}, "twin-2": {}}
    apart = sum(len(seen.apart) for seen in context.seen)
    for seen in context.seen:
        for swarm, steps in seen.twins.items():
            for step, checksum in steps.items():
                apart += bodies[swarm].setdefault(step, checksum) != checksum
    one, other = bodies.values()
    both = one.keys() & other.keys()
    apart += sum(one[step] != other[step] for step in both)
    results = context.observed.reexecuted
    ends = {results[name][0] for name in bodies if name in results}
    text = f"{len(both)} steps seen of both, {apart} differ, {len(ends)} hash at their end"
    return Finding(not apart and len(ends) == 1, text, len(both))


def epochs(context: Context) -> Finding:
    """Each restart begins an epoch later than all before."""
    wrong = []
    count = 0
    for name, log in context.observer.logs.items():
        for before, after in itertools.pairwise(sorted(log.epochs)):
            count += 1
            if log.epochs[after] <= log.epochs[before]:
                wrong.append(name)
    seen = f"{count} recoveries, {len(wrong)} without a later epoch {wrong[:3]}"
    return Finding(not wrong, seen, count)


def listens(context: Context) -> Finding:
    """The time from each start until the daemon listens."""
    took = [run.listening - run.began for run in context.node.runs]
    text = ", ".join(f"{it:.2f} s" for it in took)
    holds = max(took, default=0.0) < _LISTENING_SECS
    return Finding(holds, f"{len(took)} starts: {text}", len(took))


def experiments(context: Context) -> Finding:
    """The tables of the killed daemon equal those of a run without a daemon."""
    results = context.observed.experiments
    wrong = [name for name, (here, expected) in results.items() if here != expected]
    sizes = [len(here) for here, _ in results.values()]
    seen = f"{len(sizes)} tables of {sizes} bytes, {len(wrong)} differ {wrong}"
    return Finding(not wrong, seen, sum(size > 0 for size in sizes))


def log(context: Context) -> Finding:
    """No swarm has faulted, and the log of the daemon has no line that indicates a defect."""
    lines = context.observed.log
    faulted = sorted(context.observer.faulted)
    seen = f"{len(faulted)} faulted {faulted[:3]}, {len(lines)} bad lines {lines[:3]}"
    seen = f"{seen} of {context.observed.log_lines}, exit code {context.observed.ended}"
    holds = not faulted and not lines and context.observed.ended == 0
    return Finding(holds, seen, context.observed.log_lines)
