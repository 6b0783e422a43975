"""Judges recordings and a playback."""

from __future__ import annotations

import hashlib

from .context import Context
from .finding import Finding
from .plan import STEPS_PER_SECOND

# A crash may cost this much of a recording, and a busy machine more.
_MINUTE_SECS = 60.0
_SLACK_SECS = 5.0


def crashes(context: Context) -> Finding:
    """Each recording continues after a kill, and lacks at most a minute before it."""
    observed = context.observed
    lost = []
    wrong = []
    for name, span in observed.recorded.items():
        read = observed.read.get(name)
        if not isinstance(read, dict):
            return Finding(False, f"{name} cannot be read: {read}", 0)
        if observed.recordings[name].phase == "failed":
            span.ended = min(span.ended, observed.full.filled)
        for at, swarms in zip(observed.kills, observed.steps, strict=True):
            if not span.began < at < span.ended:
                continue
            epoch, step = swarms[span.swarm]
            before = [end for number, (_, end) in read["epochs"].items() if number <= epoch]
            lost.append((step - max(before, default=span.step)) / STEPS_PER_SECOND)
            if all(number <= epoch for number in read["epochs"]):
                wrong.append(name)
    longest = max(lost, default=0.0)
    seen = f"{len(lost)} recorded across a kill, {longest:.1f} s lost at most"
    seen = f"{seen}, {len(wrong)} did not continue {wrong}"
    return Finding(not wrong and longest < _MINUTE_SECS + _SLACK_SECS, seen, len(lost))


def parts(context: Context) -> Finding:
    """Files that were complete at a kill are unchanged at the end."""
    folder = context.node.data / "recordings"
    wrong = []
    count = 0
    for before in context.observed.parts:
        for name, sha256 in before.items():
            count += 1
            part = folder / name
            if not part.exists() or hashlib.sha256(part.read_bytes()).hexdigest() != sha256:
                wrong.append(name)
    seen = f"{count} parts complete at a kill, {len(wrong)} changed {wrong[:3]}"
    return Finding(not wrong, seen, count)


def gaps(context: Context) -> Finding:
    """Within an epoch every k-th step is recorded, except those counted as missed."""
    wrong = []
    frames = missed = 0
    for name, read in context.observed.read.items():
        if not isinstance(read, dict):
            return Finding(False, f"{name} cannot be read: {read}", 0)
        frames += read["frames"]
        missed += read["missed"]
        if read["missing"] > read["missed"] or read["back"]:
            wrong.append(f"{name}: {read}")
    seen = f"{frames} frames in {len(context.observed.read)} recordings, {missed} counted as missed"
    return Finding(not wrong, f"{seen}, {len(wrong)} wrong {wrong[:2]}", frames)


def full(context: Context) -> Finding:
    """A recording that could not be written on the full disk failed and is readable."""
    observed = context.observed
    failed = [it for it in observed.recordings.values() if it.phase == "failed"]
    if not failed and not observed.full.failed:
        return Finding(None, "no recording was written while the disk was full", 0)
    undone = set(observed.full.failed) - {it.recording for it in failed}
    unread = [it.recording for it in failed if not isinstance(observed.read[it.recording], dict)]
    names = ", ".join(f"{it.recording} after {it.frames} frames" for it in failed)
    has_reason = all("the disk is full" in (it.reason or "") for it in failed)
    seen = f"failed: {names}; {len(undone)} did not stay failed; {len(unread)} unreadable {unread}"
    return Finding(has_reason and not undone and not unread, seen, len(failed))


def stopped(context: Context) -> Finding:
    """The last k-th step before the daemon was stopped is recorded."""
    read = context.observed.read.get("recorded-3")
    if not isinstance(read, dict):
        return Finding(False, f"recorded-3: {read}", 0)
    _, (_, recorded) = max(read["epochs"].items())
    log = context.observer.logs["recorded"]
    last = max(log.journal.values(), key=lambda entry: entry.seq)
    seen = f"the swarm stopped at step {last.step}, recorded up to {recorded}"
    return Finding(recorded == last.step - last.step % read["every"], seen, read["frames"])


def playback(context: Context) -> Finding:
    """The states of the playback equal those in the file."""
    seen = context.observed.playback
    if "frames" not in seen or "error" in seen:
        return Finding(False, str(seen.get("error", "there was no playback")), 0)
    shown, read = seen["frames"]
    text = f"{shown} frames of {read}, {seen['compared']} compared, {seen['different']} differ"
    return Finding(shown == read and seen["different"] == 0, text, seen["compared"])


def playback_rejects(context: Context) -> Finding:
    """A playback rejects changes and ends with the daemon; its recording does not."""
    code = context.observed.playback.get("inform")
    is_gone = "playback" not in context.observed.verified
    is_kept = "recorded-1" in context.observed.recordings
    seen = f"inform: {code}, ended at the kill: {is_gone}, its recording exists: {is_kept}"
    holds = code == "incorrect_state" and is_gone and is_kept
    return Finding(holds, seen, int(code is not None))
