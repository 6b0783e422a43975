"""Judges what answers mean: held against the journals as they are told at the end."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterator

import jostle

from .finding import Finding
from .lab import Lab
from .ledger import Asked

# A swarm that is deleted has no journal any more.
_COMES_AND_GOES = "brood-"
# A number just above a multiple of this is the first one after a restart.
_BLOCK = 1 << 20
# How long after there is room commands may still be refused.
_ROOM_SECS = 5.0


def _told(lab: Lab) -> Iterator[tuple[Asked, list[jostle.JournalEntry]]]:
    """Every command to a swarm that is there, and the entries of its name in the journal."""
    named: dict[tuple[str, str, str], list[jostle.JournalEntry]] = {}
    for name, past in lab.chronicle.pasts.items():
        for entry in past.journal.values():
            if entry.client and entry.request_id:
                named.setdefault((name, entry.client, entry.request_id), []).append(entry)
    for asked in lab.ledger.all():
        if asked.swarm is not None and not asked.swarm.startswith(_COMES_AND_GOES):
            key = (asked.swarm, asked.client, asked.request_id)
            yield asked, named.get(key, [])


def _is_ahead(asked: Asked) -> bool:
    result = asked.reply.get("result") or {}
    return "applies_at_step" in result or "applies_at_step" in asked.reply


def durable(lab: Lab) -> Finding:
    """Each is in the journal, once, under the number it was answered."""
    count = 0
    wrong = []
    for asked, entries in _told(lab):
        if not asked.is_durable or asked.verb == "fork" or _is_ahead(asked):
            continue
        count += 1
        if [entry.seq for entry in entries] != [asked.reply["seq"]]:
            wrong.append(f"{asked.swarm} {asked.verb} {asked.request_id}")
    seen = f"{count} answered, {len(wrong)} not once there {wrong[:3]}"
    return Finding(not wrong, seen, count)


def steps(lab: Lab) -> Finding:
    """Each `step` begins where one before ended, and not before what was said to be safe."""
    ends = {0}
    safe = back = count = 0
    wrong = []
    for asked in lab.ledger.all():
        if asked.swarm != "still" or asked.verb != "step" or asked.answer is None:
            continue
        reply = asked.reply
        base = reply["step"] - reply["result"]["steps"]
        count += 1
        if base < safe or base not in ends:
            wrong.append(f"{asked.request_id} from {base}, safe was {safe}")
        back += base < max(ends)
        ends.add(reply["step"])
        safe = max(safe, reply["result"]["durable_step"])
    seen = f"{count} steps, safe up to {safe}, {back} taken back whole {wrong[:3]}"
    return Finding(not wrong, seen, count)


def ahead(lab: Lab) -> Finding:
    """Each is in the journal at its step, or was dropped by a reset."""
    resets: dict[str, list[float]] = {}
    for asked in lab.ledger.all():
        if asked.verb == "reset" and asked.swarm is not None and asked.answer is not None:
            resets.setdefault(asked.swarm, []).append(asked.answered)
    count = dropped = waiting = 0
    wrong = []
    for asked, entries in _told(lab):
        if asked.answer is None or not _is_ahead(asked) or asked.client == "twins":
            continue
        count += 1
        assert asked.swarm is not None
        past = lab.chronicle.pasts[asked.swarm]
        last = max(past.journal.values(), key=lambda entry: entry.seq)
        if [entry.step for entry in entries] == [asked.at_step]:
            continue
        if not entries and any(at > asked.answered for at in resets.get(asked.swarm, [])):
            dropped += 1
        elif not entries and asked.at_step is not None and asked.at_step >= last.step:
            waiting += 1
        else:
            wrong.append(f"{asked.swarm} {asked.verb} for {asked.at_step}")
    seen = f"{count} acknowledged, {dropped} dropped by a reset, {waiting} still to come"
    return Finding(not wrong, f"{seen}, {len(wrong)} wrong {wrong[:3]}", count)


def births(lab: Lab) -> Finding:
    """Who was created is there, and who was deleted is not."""
    there = set(lab.notes.verified)
    breeder = lab.people.breeder
    lost = (breeder.alive | set(lab.plan.specs)) - there
    back = breeder.gone & there
    seen = f"{len(there)} there, {len(breeder.gone)} deleted; lost {lost or 0}, back {back or 0}"
    return Finding(not lost and not back, seen, len(breeder.gone))


def _refused(lab: Lab, is_full: bool) -> tuple[int, list[str]]:
    count = 0
    wrong = []
    for asked, entries in _told(lab):
        if asked.answer is None and asked.refusals:
            if (asked.refusals[-1] == "storage_full") != is_full:
                continue
            count += 1
            if entries:
                wrong.append(f"{asked.swarm} {asked.verb} {asked.request_id}")
    return count, wrong


def errors(lab: Lab) -> Finding:
    """None that was refused is in the journal."""
    count, wrong = _refused(lab, is_full=False)
    return Finding(not wrong, f"{count} refused, {len(wrong)} carried out {wrong[:3]}", count)


def full(lab: Lab) -> Finding:
    """None refused for want of room is in the journal; the rest went on."""
    count, wrong = _refused(lab, is_full=True)
    it = lab.notes.full
    room = it.taken - it.freed
    seen = (
        f"{count} refused, {len(wrong)} carried out {wrong[:3]}; of {it.refusals} to a paused one "
        f"{it.changed} changed it; another ran {it.ran} steps; a `step` reached, and safe: "
        f"{it.stepped}; deleted another: {it.deleted}; normal after {room:.2f} s "
        f"{it.others[:3] or ''}"
    )
    holds = not (wrong or it.changed or it.others) and it.ran > 0
    holds = holds and room < _ROOM_SECS and bool(it.stepped) and it.deleted
    return Finding(holds, seen.strip(), min(count, it.refusals))


def silence(lab: Lab) -> Finding:
    """Whoever heard nothing has had an answer in the end."""
    silent = [asked for asked in lab.ledger.all() if asked.silences]
    without = [asked for asked in silent if asked.answer is None and not asked.refusals]
    seen = f"{len(silent)} met with silence and were asked again, {len(without)} in vain"
    return Finding(not without, seen, len(silent))


def again(lab: Lab) -> Finding:
    """Each that was sent again had the answer it had the first time."""
    sent = [asked for asked in lab.ledger.all() if asked.again]
    wrong = [f"{it.swarm} {it.verb} {it.request_id}" for it in sent if not all(it.again)]
    times = sum(len(asked.again) for asked in sent)
    return Finding(not wrong, f"{times} sendings, {len(wrong)} otherwise {wrong[:3]}", times)


def tried_again(lab: Lab) -> Finding:
    """What was refused for want of room and asked for again was carried out once."""
    count = 0
    wrong = []
    for asked, entries in _told(lab):
        if asked.answer is not None and asked.refusals and not _is_ahead(asked):
            count += 1
            if len(entries) != 1 and asked.verb != "fork":
                wrong.append(f"{asked.swarm} {asked.verb} {asked.request_id}")
    seen = f"{count} refused and carried out later, {len(wrong)} not once {wrong[:3]}"
    return Finding(not wrong, seen, count)


def nameless(lab: Lab) -> Finding:
    """Each is in the journal once if it was answered, never if refused, else at most once."""
    told = lab.people.careless.nameless
    past = lab.chronicle.pasts[lab.people.careless.swarm]
    found = Counter(
        json.dumps(entry.args["direction"])
        for entry in past.journal.values()
        if entry.verb == "inform"
    )
    wrong = []
    for direction in told.sent:
        count = found[json.dumps(direction)]
        least, most = int(direction in told.answered), int(direction not in told.refused)
        if not least <= count <= most:
            wrong.append(f"{direction}: {count}")
    seen = f"{len(told.sent)} sent, {len(told.answered)} answered, {sum(found.values())} there"
    return Finding(not wrong, f"{seen}, {len(wrong)} wrong {wrong[:3]}", len(told.answered))


def events(lab: Lab) -> Finding:
    """Within a life each number follows the one before, but for one jump to the next block.

    What was told between the last look and a kill is missed, and the numbers say so.
    """
    count = 0
    jumps = set()
    wrong = []
    for name, past in lab.chronicle.pasts.items():
        for (last_life, before), (life, number) in itertools.pairwise(past.events):
            count += 1
            if number == before + 1 or (life > last_life and number > before):
                continue
            if life > 1 and (number - 1) % _BLOCK == 0 and (name, life) not in jumps:
                jumps.add((name, life))
                continue
            wrong.append(f"{name}: {before}, then {number} in life {life}")
    seen = f"{count} events, {len(wrong)} missing without a kill {wrong[:3]}"
    return Finding(not wrong, seen, count)


def numbers(lab: Lab) -> Finding:
    """No number was told of two different events."""
    twice = [(name, number) for name, past in lab.chronicle.pasts.items() for number in past.twice]
    count = sum(len(past.told) for past in lab.chronicle.pasts.values())
    seen = f"{count} events, {len(twice)} numbers given twice {twice[:3]}"
    return Finding(not twice, seen, count)


def journal(lab: Lab) -> Finding:
    """What was told before a restart is told after it."""
    gone = [(name, seq) for name, past in lab.chronicle.pasts.items() for seq in past.forgotten]
    count = sum(past.compared for past in lab.chronicle.pasts.values())
    seen = f"{count} entries reported again, {len(gone)} left out after a restart {gone[:3]}"
    return Finding(not gone, seen, count)


def order(lab: Lab) -> Finding:
    """Whoever asked one after the other has ascending numbers."""
    last: dict[tuple[str, str], int] = {}
    count = 0
    wrong = []
    for asked, _ in _told(lab):
        if asked.swarm is None or not asked.is_durable or asked.verb == "fork" or _is_ahead(asked):
            continue
        key, seq = (asked.swarm, asked.client), asked.reply["seq"]
        count += 1
        if seq <= last.get(key, 0):
            wrong.append(f"{asked.swarm} {asked.verb} {seq} after {last[key]}")
        last[key] = seq
    return Finding(not wrong, f"{count} in order, {len(wrong)} not {wrong[:3]}", count)
