"""Judges controllers, viewers, and the health that the daemon reported."""

from __future__ import annotations

from collections import Counter

from .context import Context
from .controller_process import Exchange
from .finding import Finding
from .plan import DEADLINE_SECS

# Seconds to add on a loaded machine, and for a reconnection.
_SLACK_SECS = 1.0
_RECONNECT_SECS = 5.0
# How long after a fault the daemon may still report it.
_HEALTHY_SECS = 10.0
_LOOPS = ("loop-1", "loop-2")


def viewers(context: Context) -> Finding:
    """No viewer received an earlier step or epoch after a later one."""
    visits, failed, states, missed, epochs = (
        sum(getattr(seen, name) for seen in context.seen)
        for name in ("visits", "failed", "states", "missed", "epochs")
    )
    back = [one for seen in context.seen for one in seen.back]
    seen = f"{visits} sessions ({failed} failed), {states} states, {missed} missed"
    seen = f"{seen}, {epochs} new epochs, {len(back)} decreased {back[:3]}"
    return Finding(not back, seen, states)


def owners(context: Context) -> Finding:
    """No individual was reported as owned by two controllers."""
    logs = context.observer.logs.values()
    wrong = [one for log in logs for one in log.conflicts]
    reads = sum(log.reads for log in logs)
    return Finding(not wrong, f"{len(wrong)} conflicts in {reads} reads", reads)


def _exchanges(context: Context) -> dict[str, list[Exchange]]:
    return {name: one.exchanges() for name, one in context.controllers.items()}


def _overlaps(exchange: Exchange, begin: float, end: float) -> bool:
    return exchange.sent < end and exchange.answered > begin


def waits(context: Context) -> Finding:
    """The longest advance while the daemon ran, without those of the stopped controller."""
    longest, who = 0.0, ""
    count = 0
    down = [(begin, end + _RECONNECT_SECS) for begin, end in context.node.down()]
    for name, exchanges in _exchanges(context).items():
        excluded = [*down, context.observed.frozen] if name == "dan" else down
        for exchange in exchanges:
            if any(_overlaps(exchange, *it) for it in excluded):
                continue
            count += 1
            if exchange.answered - exchange.sent > longest:
                longest, who = exchange.answered - exchange.sent, name
    seen = f"{count} exchanges, the longest {longest:.2f} s ({who}), deadline {DEADLINE_SECS} s"
    return Finding(longest < DEADLINE_SECS + _SLACK_SECS, seen, count)


def journalled(context: Context) -> Finding:
    """Missed deadlines and lost controllers are in the journal."""
    found = Counter(
        (entry.verb, entry.args.get("controller"))
        for name in _LOOPS
        for entry in context.observer.logs[name].journal.values()
        if entry.verb in ("deadline", "lost")
    )
    seen = ", ".join(f"{verb} {who} {count}" for (verb, who), count in sorted(found.items()))
    holds = ("lost", "bob") in found and any(who == "dan" for _, who in found)
    return Finding(holds, seen, found.total())


def members(context: Context) -> Finding:
    """After each kill each controller continues without joining again."""
    count = continued = 0
    wrong = []
    for name, exchanges in _exchanges(context).items():
        for begin, end in context.node.down():
            after = [it for it in exchanges if it.answered > end]
            before = [it for it in exchanges if it.answered < begin]
            if not after or not before:
                wrong.append(f"{name} has no exchange before or after")
                continue
            count += 1
            first = after[0]
            if not first.error and not first.joined and first.epoch > before[-1].epoch:
                continued += 1
            else:
                wrong.append(f"{name}: {first}")
    seen = f"{continued} of {count} continued in lock-step {wrong[:3]}"
    return Finding(not wrong, seen, count)


def advances(context: Context) -> Finding:
    """No advance is in the journal twice."""
    found = Counter(
        (name, entry.client, entry.request_id)
        for name in _LOOPS
        for entry in context.observer.logs[name].journal.values()
        if entry.verb == "advance"
    )
    twice = [key for key, count in found.items() if count > 1]
    seen = f"{len(found)} in the journal, {len(twice)} twice {twice[:3]}"
    return Finding(not twice, seen, len(found))


def answered(context: Context) -> Finding:
    """Each controller advances until the end."""
    end = context.began + context.plan.seconds
    late = {
        name: end - max((it.answered for it in exchanges if not it.error), default=0.0)
        for name, exchanges in _exchanges(context).items()
    }
    wrong = [name for name, secs in late.items() if secs > _RECONNECT_SECS]
    codes = Counter(it.error for all_ in _exchanges(context).values() for it in all_ if it.error)
    failures = "".join(one.failures() for one in context.controllers.values())[:200]
    errors = ", ".join(f"{code} {count}" for code, count in sorted(codes.items())) or "none"
    seen = f"{len(late) - len(wrong)} of {len(late)} advanced until the end; errors: {errors}"
    return Finding(
        not wrong and not failures, f"{seen} {wrong or ''} {failures}".strip(), len(late)
    )


def health(context: Context) -> Finding:
    """When the daemon was unhealthy, and for how long after each fault."""
    full = context.observed.full
    samples = [it for it in context.observer.health if it[1] is not None]
    while_full = {
        code for at, codes in samples if full.rejected_at < at < full.freed for code in codes or ()
    }
    faults = [run.listening for run in context.node.runs] + [full.freed]
    healthy = [
        min((at for at, codes in samples if at > fault and not codes), default=float("inf")) - fault
        for fault in faults
    ]
    last = samples[-1][1] if samples else None
    reasons = {code for _, codes in samples for code in codes or ()}
    holds = max(healthy) < _HEALTHY_SECS and last == [] and "store_full" in while_full
    seen = f"{len(samples)} samples, unhealthy for {sorted(reasons)}"
    seen = f"{seen}, healthy after {max(healthy):.1f} s at most"
    return Finding(holds, seen, len(samples))
