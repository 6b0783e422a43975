"""Prints the verdicts, and writes them with all samples as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from .context import Context
from .guarantees import Verdict

_WORDS = {True: "holds", False: "VIOLATED", None: "not judged"}


def write(context: Context, verdicts: list[Verdict], path: Path | None) -> None:
    """Prints each verdict and a summary; writes the JSON document if there is a path."""
    print()
    for verdict in verdicts:
        word = f"see {verdict.test}" if verdict.test else _WORDS[verdict.holds]
        print(f"{word:13}  {verdict.about}: {verdict.guarantee}")
        if verdict.seen:
            print(f"{'':15}{verdict.seen}")
    if path is not None:
        document = {
            "seed": context.plan.seed,
            "seconds": context.plan.seconds,
            "verdicts": [asdict(verdict) for verdict in verdicts],
            "samples": [asdict(sample) for sample in context.meter.samples],
        }
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(f"\n{summary(verdicts)}", flush=True)


def summary(verdicts: list[Verdict]) -> str:
    """The last lines: violated guarantees, and those that this run did not judge, by name."""
    lines = []
    judged = [it for it in verdicts if not it.test]
    open_ = [it for it in judged if it.holds is None]
    if open_:
        lines.append("not judged in this run: " + "; ".join(it.guarantee for it in open_))
    failed = [it.guarantee for it in judged if it.holds is False]
    if failed:
        lines.append(f"{len(failed)} guarantees are violated: " + "; ".join(failed))
    else:
        rest = f", {len(open_)} not judged" if open_ else ""
        lines.append(f"{len(judged) - len(open_)} guarantees hold{rest}")
    return "\n".join(lines)
