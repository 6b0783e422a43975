"""Judges what crashes have cost: pasts told again, here and elsewhere."""

from __future__ import annotations

import itertools

import jostle

from . import evening
from .finding import Finding
from .lab import Lab

# With a hundred running swarms it is to listen within this.
_LISTENING_SECS = 3.0


def verified(lab: Lab) -> Finding:
    """Each swarm's kept history comes out the same."""
    wrong = []
    hashes = steps = 0
    for name, said in lab.notes.verified.items():
        if isinstance(said, jostle.Verified) and said.differs_at is None:
            hashes += said.hashes
            steps += max(0, said.to_step - said.from_step)
        else:
            wrong.append(f"{name}: {said}")
    seen = f"{len(lab.notes.verified)} swarms, {hashes} hashes, {len(wrong)} otherwise {wrong[:3]}"
    return Finding(not wrong, seen, hashes)


def elsewhere(lab: Lab) -> Finding:
    """The journal carried out by another daemon, in peace, comes to the same."""
    again = lab.notes.again
    wrong = [f"{name}: {it[1]}" for name, it in again.items() if it[0] != it[1]]
    expected = {name for name in lab.plan.specs if not name.startswith(evening.NOT_RETOLD)}
    wrong += [f"{name}: not carried out" for name in sorted(expected - set(again))]
    return Finding(
        not wrong, f"{len(again)} swarms, {len(wrong)} otherwise {wrong[:3]}", len(again)
    )


def twins(lab: Lab) -> Finding:
    """Two of the same spec and commands were the same whenever seen, in whichever epoch."""
    bodies: dict[str, dict[int, int]] = {"twin-1": {}, "twin-2": {}}
    apart = sum(len(seen.apart) for seen in lab.seen)
    for seen in lab.seen:
        for swarm, steps in seen.twins.items():
            for step, sum_ in steps.items():
                apart += bodies[swarm].setdefault(step, sum_) != sum_
    one, other = bodies.values()
    both = one.keys() & other.keys()
    apart += sum(one[step] != other[step] for step in both)
    ends = {lab.notes.again[name][0] for name in bodies if name in lab.notes.again}
    said = f"{len(both)} steps seen of both, {apart} apart, {len(ends)} hash at their end"
    return Finding(not apart and len(ends) == 1, said, len(both))


def epochs(lab: Lab) -> Finding:
    """Each return is in an epoch beyond all before."""
    wrong = []
    count = 0
    for name, past in lab.chronicle.pasts.items():
        lives = sorted(past.epochs)
        for before, after in itertools.pairwise(lives):
            count += 1
            if past.epochs[after] <= past.epochs[before]:
                wrong.append(name)
    seen = f"{count} returns, {len(wrong)} in no later epoch {wrong[:3]}"
    return Finding(not wrong, seen, count)


def listens(lab: Lab) -> Finding:
    """From its start until it listens."""
    took = [life.listening - life.began for life in lab.node.lives]
    said = ", ".join(f"{it:.2f} s" for it in took)
    holds = max(took, default=0.0) < _LISTENING_SECS
    return Finding(holds, f"{len(took)} starts: {said}", len(took))


def experiments(lab: Lab) -> Finding:
    """Tables of the daemon that was killed, and of a run without any daemon."""
    wrong = [name for name, (here, peace) in lab.notes.experiments.items() if here != peace]
    sizes = [len(here) for here, _ in lab.notes.experiments.values()]
    seen = f"{len(sizes)} tables of {sizes} bytes, {len(wrong)} otherwise {wrong}"
    return Finding(not wrong, seen, sum(size > 0 for size in sizes))


def log(lab: Lab) -> Finding:
    """What the daemon says of itself."""
    lines = lab.notes.log
    faulted = sorted(lab.chronicle.faulted)
    seen = f"{len(faulted)} faulted {faulted[:3]}, {len(lines)} bad lines {lines[:3]}"
    seen = f"{seen} of {lab.notes.log_lines}, ended with {lab.notes.ended}"
    holds = not faulted and not lines and lab.notes.ended == 0
    return Finding(holds, seen, lab.notes.log_lines)
