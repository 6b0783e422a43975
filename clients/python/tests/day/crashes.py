"""Judges what crashes have cost: pasts told again, here and elsewhere."""

from __future__ import annotations

import itertools

import jostle

from .lab import Lab

# With a hundred running swarms it is to listen within this.
_LISTENING_SECS = 3.0


def verified(lab: Lab) -> tuple[bool, str]:
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
    return hashes > 0 and not wrong, seen


def elsewhere(lab: Lab) -> tuple[bool, str]:
    """The journal carried out by another daemon, in peace, comes to the same."""
    wrong = [f"{name}: {it[1]}" for name, it in lab.notes.again.items() if it[0] != it[1]]
    seen = f"{len(lab.notes.again)} swarms, {len(wrong)} otherwise {wrong[:3]}"
    return bool(lab.notes.again) and not wrong, seen


def twins(lab: Lab) -> tuple[bool, str]:
    """Two of the same spec and commands were the same whenever seen, in whichever epoch."""
    bodies: dict[int, int] = {}
    apart = sum(len(seen.apart) for seen in lab.seen)
    for seen in lab.seen:
        for step, sum_ in seen.twins.items():
            apart += bodies.setdefault(step, sum_) != sum_
    ends = {lab.notes.again[name][0] for name in ("twin-1", "twin-2")}
    said = f"{len(bodies)} steps seen of two, {apart} apart, {len(ends)} hash at their end"
    return bool(bodies) and not apart and len(ends) == 1, said


def epochs(lab: Lab) -> tuple[bool, str]:
    """Each return is in an epoch beyond all before."""
    wrong = []
    count = 0
    for name, past in lab.chronicle.pasts.items():
        lives = sorted(past.epochs)
        for before, after in itertools.pairwise(lives):
            count += 1
            if past.epochs[after] <= past.epochs[before]:
                wrong.append(name)
    return count > 0 and not wrong, f"{count} returns, {len(wrong)} in no later epoch {wrong[:3]}"


def listens(lab: Lab) -> tuple[bool, str]:
    """From its start until it listens."""
    took = [life.listening - life.began for life in lab.node.lives]
    said = ", ".join(f"{it:.2f} s" for it in took)
    return max(took) < _LISTENING_SECS, f"{len(took)} starts: {said}"


def experiments(lab: Lab) -> tuple[bool, str]:
    """Tables of the daemon that was killed, and of a run without any daemon."""
    wrong = [name for name, (here, peace) in lab.notes.experiments.items() if here != peace]
    sizes = [len(here) for here, _ in lab.notes.experiments.values()]
    seen = f"{len(sizes)} tables of {sizes} bytes, {len(wrong)} otherwise {wrong}"
    return min(sizes, default=0) > 0 and not wrong, seen


def log(lab: Lab) -> tuple[bool, str]:
    """What the daemon says of itself."""
    lines = lab.notes.log
    faulted = sorted(lab.chronicle.faulted)
    seen = f"{len(faulted)} faulted {faulted[:3]}, {len(lines)} bad lines {lines[:3]}"
    ended = f"ended with {lab.notes.ended}"
    return not faulted and not lines and lab.notes.ended == 0, f"{seen}, {ended}"
