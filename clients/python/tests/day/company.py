"""Judges what controllers and viewers met with, and what the daemon said of its health."""

from __future__ import annotations

from collections import Counter

from .controllers import Exchange
from .finding import Finding
from .lab import Lab
from .plan import DEADLINE_SECS

# What a shared machine, and a connection that is made again, may take on top.
_SLACK_SECS = 1.0
_RETURN_SECS = 5.0
# How long after a trouble the daemon may still say so.
_GREEN_SECS = 10.0
_LOOPS = ("loop-1", "loop-2")


def viewers(lab: Lab) -> Finding:
    """What all of them saw."""
    visits, failed, states, missed, epochs = (
        sum(getattr(seen, name) for seen in lab.seen)
        for name in ("visits", "failed", "states", "missed", "epochs")
    )
    back = [one for seen in lab.seen for one in seen.back]
    told = f"{visits} visits ({failed} found nobody), {states} states, {missed} missed"
    told = f"{told}, {epochs} new epochs, {len(back)} back {back[:3]}"
    return Finding(not back, told, states)


def owners(lab: Lab) -> Finding:
    """Nobody was ever told to be steered by two."""
    pasts = lab.chronicle.pasts.values()
    wrong = [one for past in pasts for one in past.owners]
    looks = sum(past.looks for past in pasts)
    return Finding(not wrong, f"of {looks} looks {len(wrong)} times one of another's", looks)


def _exchanges(lab: Lab) -> dict[str, list[Exchange]]:
    return {name: one.exchanges() for name, one in lab.controllers.items()}


def _is_in(exchange: Exchange, begin: float, end: float) -> bool:
    return exchange.sent < end and exchange.answered > begin


def waits(lab: Lab) -> Finding:
    """How long an advance took while there was a daemon, the one that stood still left out."""
    longest, who = 0.0, ""
    count = 0
    down = [(begin, end + _RETURN_SECS) for begin, end in lab.node.down()]
    for name, exchanges in _exchanges(lab).items():
        apart = [*down, lab.notes.frozen] if name == "dan" else down
        for exchange in exchanges:
            if any(_is_in(exchange, *it) for it in apart):
                continue
            count += 1
            if exchange.answered - exchange.sent > longest:
                longest, who = exchange.answered - exchange.sent, name
    seen = f"{count} exchanges, the longest {longest:.2f} s ({who}), deadline {DEADLINE_SECS} s"
    return Finding(longest < DEADLINE_SECS + _SLACK_SECS, seen, count)


def journalled(lab: Lab) -> Finding:
    """Whom the others did not wait for any more is in the journal."""
    found = Counter(
        (entry.verb, entry.args.get("controller"))
        for name in _LOOPS
        for entry in lab.chronicle.pasts[name].journal.values()
        if entry.verb in ("deadline", "lost")
    )
    said = ", ".join(f"{verb} {who} {count}" for (verb, who), count in sorted(found.items()))
    holds = ("lost", "bob") in found and any(who == "dan" for _, who in found)
    return Finding(holds, said, found.total())


def members(lab: Lab) -> Finding:
    """After each kill each goes on where it was, and does not join again."""
    count = went_on = 0
    wrong = []
    for name, exchanges in _exchanges(lab).items():
        for begin, end in lab.node.down():
            after = [it for it in exchanges if it.answered > end]
            before = [it for it in exchanges if it.answered < begin]
            if not after or not before:
                wrong.append(f"{name} is not seen")
                continue
            count += 1
            first = after[0]
            if not first.error and not first.joined and first.epoch > before[-1].epoch:
                went_on += 1
            else:
                wrong.append(f"{name}: {first}")
    seen = f"{went_on} of {count} went on in lock-step by themselves {wrong[:3]}"
    return Finding(not wrong, seen, count)


def advances(lab: Lab) -> Finding:
    """No advance is in the journal twice."""
    found = Counter(
        (name, entry.client, entry.request_id)
        for name in _LOOPS
        for entry in lab.chronicle.pasts[name].journal.values()
        if entry.verb == "advance"
    )
    twice = [key for key, count in found.items() if count > 1]
    seen = f"{len(found)} told, {len(twice)} twice {twice[:3]}"
    return Finding(not twice, seen, len(found))


def answered(lab: Lab) -> Finding:
    """Each advances up to the end."""
    end = lab.began + lab.plan.seconds
    late = {
        name: end - max((it.answered for it in exchanges if not it.error), default=0.0)
        for name, exchanges in _exchanges(lab).items()
    }
    wrong = [name for name, secs in late.items() if secs > _RETURN_SECS]
    errors = Counter(it.error for all_ in _exchanges(lab).values() for it in all_ if it.error)
    said = "".join(one.errors() for one in lab.controllers.values())[:200]
    met = ", ".join(f"{code} {count}" for code, count in sorted(errors.items())) or "nothing"
    seen = f"{len(late) - len(wrong)} of {len(late)} advanced up to the end and met with {met}"
    return Finding(not wrong and not said, f"{seen} {wrong or ''} {said}".strip(), len(late))


def health(lab: Lab) -> Finding:
    """When it was red, and for how long after each trouble."""
    full = lab.notes.full
    said = [it for it in lab.chronicle.health if it[1] is not None]
    while_full = {
        code for at, codes in said if full.refused < at < full.freed for code in codes or ()
    }
    troubles = [life.listening for life in lab.node.lives] + [full.freed]
    green = [
        min((at for at, codes in said if at > trouble and not codes), default=float("inf"))
        - trouble
        for trouble in troubles
    ]
    last = said[-1][1] if said else None
    reds = {code for _, codes in said for code in codes or ()}
    holds = max(green) < _GREEN_SECS and last == [] and "store_full" in while_full
    seen = f"{len(said)} looks, red for {sorted(reds)}, green after {max(green):.1f} s at most"
    return Finding(holds, seen, len(said))
