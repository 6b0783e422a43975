"""Judges recordings and the replay of one."""

from __future__ import annotations

import hashlib

from .finding import Finding
from .lab import Lab
from .plan import STEPS_PER_SECOND

# What a crash may cost of a recording, and how much longer the machine may take over it.
_MINUTE_SECS = 60.0
_SLACK_SECS = 5.0


def crashes(lab: Lab) -> Finding:
    """Of each that went on over a kill, at most a minute before it is missing, and it went on."""
    lost = []
    wrong = []
    for name, asked in lab.notes.recorded.items():
        read = lab.notes.read.get(name)
        if not isinstance(read, dict):
            return Finding(False, f"{name} cannot be read: {read}", 0)
        if lab.notes.recordings[name].phase == "failed":
            asked.ended = min(asked.ended, lab.notes.full.filled)
        for at, swarms in zip(lab.notes.kills, lab.notes.steps, strict=True):
            if not asked.began < at < asked.ended:
                continue
            epoch, step = swarms[asked.swarm]
            before = [end for number, (_, end) in read["epochs"].items() if number <= epoch]
            lost.append((step - max(before, default=asked.step)) / STEPS_PER_SECOND)
            if all(number <= epoch for number in read["epochs"]):
                wrong.append(name)
    longest = max(lost, default=0.0)
    seen = f"{len(lost)} over a kill, {longest:.1f} s lost at most, {len(wrong)} ended {wrong}"
    return Finding(not wrong and longest < _MINUTE_SECS + _SLACK_SECS, seen, len(lost))


def parts(lab: Lab) -> Finding:
    """The files that were whole at a kill are the same at the end."""
    folder = lab.node.data / "recordings"
    wrong = []
    count = 0
    for before in lab.notes.parts:
        for name, sum_ in before.items():
            count += 1
            part = folder / name
            if not part.exists() or hashlib.sha256(part.read_bytes()).hexdigest() != sum_:
                wrong.append(name)
    seen = f"{count} parts whole at a kill, {len(wrong)} changed {wrong[:3]}"
    return Finding(not wrong, seen, count)


def gaps(lab: Lab) -> Finding:
    """Within an epoch every k-th step is recorded, except those counted as missed."""
    wrong = []
    frames = missed = 0
    for name, read in lab.notes.read.items():
        if not isinstance(read, dict):
            return Finding(False, f"{name} cannot be read: {read}", 0)
        frames += read["frames"]
        missed += read["missed"]
        if read["missing"] > read["missed"] or read["back"]:
            wrong.append(f"{name}: {read}")
    seen = f"{frames} frames in {len(lab.notes.read)} recordings, {missed} missed as told"
    return Finding(not wrong, f"{seen}, {len(wrong)} otherwise {wrong[:2]}", frames)


def full(lab: Lab) -> Finding:
    """What could not be written when the disk was full has failed, and what it had can be read."""
    failed = [it for it in lab.notes.recordings.values() if it.phase == "failed"]
    if not failed and not lab.notes.full.failed:
        return Finding(None, "none came to write just then", 0)
    undone = set(lab.notes.full.failed) - {it.recording for it in failed}
    unread = [it.recording for it in failed if not isinstance(lab.notes.read[it.recording], dict)]
    said = ", ".join(f"{it.recording} after {it.frames} frames" for it in failed)
    fits = all("the disk is full" in (it.reason or "") for it in failed)
    seen = f"failed: {said}; {len(undone)} did not stay so; {len(unread)} cannot be read {unread}"
    return Finding(fits and not undone and not unread, seen, len(failed))


def stopped(lab: Lab) -> Finding:
    """The last k-th step before an orderly end is the last one recorded."""
    read = lab.notes.read.get("film-3")
    if not isinstance(read, dict):
        return Finding(False, f"film-3: {read}", 0)
    _, (_, recorded) = max(read["epochs"].items())
    last = max(lab.chronicle.pasts["film"].journal.values(), key=lambda entry: entry.seq)
    seen = f"film stood at {last.step}, recorded up to {recorded}"
    return Finding(recorded == last.step - last.step % read["every"], seen, read["frames"])


def replay(lab: Lab) -> Finding:
    """States that were shown, held against those in the file."""
    seen = lab.notes.replay
    if "frames" not in seen or "trouble" in seen:
        return Finding(False, str(seen.get("trouble", "nothing was shown")), 0)
    shown, there = seen["frames"]
    said = f"{shown} frames of {there}, {seen['compared']} compared, {seen['different']} different"
    return Finding(shown == there and seen["different"] == 0, said, seen["compared"])


def replay_refuses(lab: Lab) -> Finding:
    """What would change it is refused, and it is gone with the daemon; the recording is not."""
    said = lab.notes.replay.get("inform")
    is_gone = "tape" not in lab.notes.verified
    is_kept = "film-1" in lab.notes.recordings
    seen = f"inform: {said}, gone after the kill: {is_gone}, its recording kept: {is_kept}"
    holds = said == "incorrect_state" and is_gone and is_kept
    return Finding(holds, seen, int(said is not None))
