"""Judges whether replies were true: compares them with the journals at the end."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterator

import jostle

from .context import Context
from .finding import Finding
from .requests import Request

# Swarms that are deleted, and have no journal afterwards.
_TEMPORARY = "short-lived-"
# After a restart event numbers continue just above a multiple of this.
_BLOCK = 1 << 20
# How long after space is freed commands may still be rejected.
_SPACE_SECS = 5.0


def _entries(context: Context) -> Iterator[tuple[Request, list[jostle.JournalEntry]]]:
    """Every command to a swarm that still exists, with its entries in the journal."""
    by_id: dict[tuple[str, str, str], list[jostle.JournalEntry]] = {}
    for name, log in context.observer.logs.items():
        for entry in log.journal.values():
            if entry.client and entry.request_id:
                by_id.setdefault((name, entry.client, entry.request_id), []).append(entry)
    for request in context.requests.all():
        if request.swarm is not None and not request.swarm.startswith(_TEMPORARY):
            key = (request.swarm, request.client, request.request_id)
            yield request, by_id.get(key, [])


def _is_scheduled(request: Request) -> bool:
    result = request.reply.get("result") or {}
    return "applies_at_step" in result or "applies_at_step" in request.reply


def durable(context: Context) -> Finding:
    """Each is in the journal once, under the `seq` of its reply."""
    count = 0
    wrong = []
    for request, entries in _entries(context):
        if not request.is_durable or request.verb == "fork" or _is_scheduled(request):
            continue
        count += 1
        if [entry.seq for entry in entries] != [request.reply["seq"]]:
            wrong.append(f"{request.swarm} {request.verb} {request.request_id}")
    seen = f"{count} replies, {len(wrong)} not exactly once in the journal {wrong[:3]}"
    return Finding(not wrong, seen, count)


def steps(context: Context) -> Finding:
    """Each `step` begins where an earlier one ended, and not before a `durable_step`."""
    ends = {0}
    safe = back = count = 0
    wrong = []
    for request in context.requests.all():
        if request.swarm != "stepped" or request.verb != "step" or request.answer is None:
            continue
        reply = request.reply
        base = reply["step"] - reply["result"]["steps"]
        count += 1
        if base < safe or base not in ends:
            wrong.append(f"{request.request_id} from {base}, durable were {safe}")
        back += base < max(ends)
        ends.add(reply["step"])
        safe = max(safe, reply["result"]["durable_step"])
    seen = f"{count} steps, durable up to {safe}, {back} rolled back as a whole {wrong[:3]}"
    return Finding(not wrong, seen, count)


def scheduled(context: Context) -> Finding:
    """Each is in the journal at its step, or a reset dropped it."""
    resets: dict[str, list[float]] = {}
    for request in context.requests.all():
        if request.verb == "reset" and request.swarm is not None and request.answer is not None:
            resets.setdefault(request.swarm, []).append(request.answered)
    count = dropped = waiting = 0
    wrong = []
    for request, entries in _entries(context):
        if request.answer is None or not _is_scheduled(request) or request.client == "twins":
            continue
        count += 1
        assert request.swarm is not None
        log = context.observer.logs[request.swarm]
        last = max(log.journal.values(), key=lambda entry: entry.seq)
        if [entry.step for entry in entries] == [request.at_step]:
            continue
        if not entries and any(at > request.answered for at in resets.get(request.swarm, [])):
            dropped += 1
        elif not entries and request.at_step is not None and request.at_step >= last.step:
            waiting += 1
        else:
            wrong.append(f"{request.swarm} {request.verb} for {request.at_step}")
    seen = f"{count} acknowledged, {dropped} dropped by a reset, {waiting} not due yet"
    return Finding(not wrong, f"{seen}, {len(wrong)} wrong {wrong[:3]}", count)


def existence(context: Context) -> Finding:
    """A created swarm exists, and a deleted one does not."""
    existing = set(context.observed.verified)
    lifecycle = context.clients.lifecycle
    lost = (lifecycle.existing | set(context.plan.specs)) - existing
    back = lifecycle.deleted & existing
    seen = f"{len(existing)} exist, {len(lifecycle.deleted)} deleted"
    seen = f"{seen}; lost {lost or 0}, reappeared {back or 0}"
    return Finding(not lost and not back, seen, len(lifecycle.deleted))


def _rejected(context: Context, is_full: bool) -> tuple[int, list[str]]:
    count = 0
    wrong = []
    for request, entries in _entries(context):
        if request.answer is None and request.errors:
            if (request.errors[-1] == "storage_full") != is_full:
                continue
            count += 1
            if entries:
                wrong.append(f"{request.swarm} {request.verb} {request.request_id}")
    return count, wrong


def errors(context: Context) -> Finding:
    """No rejected command is in the journal."""
    count, wrong = _rejected(context, is_full=False)
    return Finding(not wrong, f"{count} rejected, {len(wrong)} executed {wrong[:3]}", count)


def full(context: Context) -> Finding:
    """No command rejected with `storage_full` is in the journal; everything else goes on."""
    count, wrong = _rejected(context, is_full=True)
    it = context.observed.full
    delay = it.accepted - it.freed
    seen = (
        f"{count} rejected, {len(wrong)} executed {wrong[:3]}; of {it.rejections} to a paused "
        f"swarm {it.changed} changed it; another ran {it.ran} steps; `step` returned step and "
        f"durable_step {it.stepped}; deleted another: {it.deleted}; accepted again after "
        f"{delay:.2f} s {it.others[:3] or ''}"
    )
    holds = not (wrong or it.changed or it.others) and it.ran > 0
    holds = holds and delay < _SPACE_SECS and bool(it.stepped) and it.deleted
    return Finding(holds, seen.strip(), min(count, it.rejections))


def timeouts(context: Context) -> Finding:
    """A request without a reply gets one when it is sent again, by the client or by its user."""
    kills = [ended for ended, _ in context.node.down()]
    everything = context.requests.all()
    interrupted = [it for it in everything if it.timeouts or it.is_pending_at(kills)]
    without = [it for it in interrupted if it.answer is None and not it.errors]
    seen = (
        f"{len(interrupted)} requests timed out or had no reply at a kill, and were sent again, "
        f"{len(without)} got no reply"
    )
    return Finding(not without, seen, len(interrupted))


def resent(context: Context) -> Finding:
    """Each request that was sent again got its first reply."""
    sent = [request for request in context.requests.all() if request.resent]
    wrong = [f"{it.swarm} {it.verb} {it.request_id}" for it in sent if not all(it.resent)]
    times = sum(len(request.resent) for request in sent)
    return Finding(not wrong, f"{times} sent again, {len(wrong)} differ {wrong[:3]}", times)


def retried(context: Context) -> Finding:
    """A command rejected with `storage_full` and retried was executed once."""
    count = 0
    wrong = []
    for request, entries in _entries(context):
        if request.answer is not None and request.errors and not _is_scheduled(request):
            count += 1
            if len(entries) != 1 and request.verb != "fork":
                wrong.append(f"{request.swarm} {request.verb} {request.request_id}")
    seen = f"{count} rejected and executed later, {len(wrong)} not exactly once {wrong[:3]}"
    return Finding(not wrong, seen, count)


def unnamed(context: Context) -> Finding:
    """In the journal: once with a reply, never with an error, otherwise at most once."""
    sent = context.clients.unnamed.requests
    log = context.observer.logs[context.clients.unnamed.swarm]
    found = Counter(
        json.dumps(entry.args["direction"])
        for entry in log.journal.values()
        if entry.verb == "inform"
    )
    wrong = []
    for direction in sent.sent:
        count = found[json.dumps(direction)]
        least, most = int(direction in sent.answered), int(direction not in sent.rejected)
        if not least <= count <= most:
            wrong.append(f"{direction}: {count}")
    seen = f"{len(sent.sent)} sent, {len(sent.answered)} replies, {sum(found.values())} executed"
    return Finding(not wrong, f"{seen}, {len(wrong)} wrong {wrong[:3]}", len(sent.answered))


def events(context: Context) -> Finding:
    """Within a run of the daemon event numbers have no gap, but for one jump to the next block.

    Events between the last read and a kill are missing, which the jump shows.
    """
    count = 0
    jumps = set()
    wrong = []
    for name, log in context.observer.logs.items():
        for (last_run, before), (run, number) in itertools.pairwise(log.events):
            count += 1
            if number == before + 1 or (run > last_run and number > before):
                continue
            if run > 1 and (number - 1) % _BLOCK == 0 and (name, run) not in jumps:
                jumps.add((name, run))
                continue
            wrong.append(f"{name}: {before}, then {number} in run {run}")
    seen = f"{count} events, {len(wrong)} gaps without a kill {wrong[:3]}"
    return Finding(not wrong, seen, count)


def numbers(context: Context) -> Finding:
    """No two different events have the same number."""
    logs = context.observer.logs
    twice = [(name, number) for name, log in logs.items() for number in log.duplicates]
    count = sum(len(log.contents) for log in logs.values())
    seen = f"{count} events, {len(twice)} numbers used twice {twice[:3]}"
    return Finding(not twice, seen, count)


def journal(context: Context) -> Finding:
    """Entries that were read before a restart are in the journal after it."""
    logs = context.observer.logs
    missing = [(name, seq) for name, log in logs.items() for seq in log.missing]
    count = sum(log.compared for log in logs.values())
    seen = f"{count} entries read again after a restart, {len(missing)} missing {missing[:3]}"
    return Finding(not missing, seen, count)


def order(context: Context) -> Finding:
    """Successive commands of a client have ascending `seq`."""
    last: dict[tuple[str, str], int] = {}
    count = 0
    wrong = []
    for request, _ in _entries(context):
        if request.swarm is None or not request.is_durable or request.verb == "fork":
            continue
        if _is_scheduled(request):
            continue
        key, seq = (request.swarm, request.client), request.reply["seq"]
        count += 1
        if seq <= last.get(key, 0):
            wrong.append(f"{request.swarm} {request.verb} {seq} after {last[key]}")
        last[key] = seq
    return Finding(not wrong, f"{count} in order, {len(wrong)} not {wrong[:3]}", count)
