"""Tells what was seen: a table, a JSON document, and docs/soak.md."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .lab import Lab
from .promises import Verdict

_HOLDS = {True: "holds", False: "DOES NOT HOLD", None: "not seen here"}


def tell(lab: Lab, verdicts: list[Verdict], report: Path | None, root: Path | None) -> None:
    """Prints the table, and writes what is asked for."""
    print()
    for verdict in verdicts:
        print(f"{_HOLDS[verdict.holds]:13}  {verdict.about}: {verdict.promise}")
        print(f"{'':15}{verdict.seen}")
    figures = measure(lab)
    print()
    print(json.dumps(figures, indent=1), flush=True)
    if report is not None:
        document = {
            "seed": lab.plan.seed,
            "seconds": lab.plan.seconds,
            "promises": [asdict(verdict) for verdict in verdicts],
            "figures": figures,
            "samples": lab.meter.told(),
        }
        report.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if root is not None:
        (root / "docs" / "soak.md").write_text(_document(lab, verdicts, figures), encoding="utf-8")
    failed = [verdict for verdict in verdicts if verdict.holds is False]
    print(f"\n{len(failed)} promises do not hold" if failed else "\nevery promise holds", flush=True)


def measure(lab: Lab) -> dict[str, Any]:
    """The figures of the day."""
    slowest = [it.slowest for it in lab.meter.samples if it.slowest is not None]
    gets = sorted(lab.chronicle.get_secs)
    asked = lab.ledger.all()
    return {
        "cores": os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "swarms": len(lab.plan.specs),
        "viewers": lab.plan.viewers,
        "visits": sum(seen.visits for seen in lab.seen),
        "states_seen": sum(seen.states for seen in lab.seen),
        "commands": len(asked),
        "lateness_secs": lab.meter.late(),
        "real_time_factor": {
            "least": round(min(slowest, default=0.0), 3),
            "median_of_least": round(sorted(slowest)[len(slowest) // 2], 3) if slowest else None,
        },
        "status_of_all_secs": {
            "p50": round(gets[len(gets) // 2], 4),
            "p99": round(gets[int(0.99 * len(gets))], 4),
            "max": round(gets[-1], 4),
        },
        "others_cores": round(
            sum(os.times()[2:4]) / max(1.0, lab.plan.seconds), 2
        ),
        "lives": [lab.meter.life(life) for life in lab.node.lives],
    }


def _document(lab: Lab, verdicts: list[Verdict], figures: dict[str, Any]) -> str:
    minutes = lab.plan.seconds / 60.0
    late, factor = figures["lateness_secs"], figures["real_time_factor"]
    lines = [
        "# A day in a lab",
        "",
        f"{figures['swarms']} swarms, two experiments, four controllers in lock-step, "
        f"{figures['viewers']} viewers",
        "coming and going, recordings and a replay; the daemon is killed twice, its disk fills, one",
        "controller is killed in the middle of an exchange and one is stopped. At the end every promise of",
        "[guarantees.md](guarantees.md) that can be seen from outside is checked. These are the figures of",
        f"{minutes:g} minutes on {figures['cores']} cores and {figures['memory_gb']} GB, all of it on "
        "them; this made this page:",
        "",
        "```sh",
        "PYTHONPATH=clients/python/tests target/venv/bin/python -m day "
        f"--minutes {minutes:g} --seed {lab.plan.seed} --write-docs",
        "```",
        "",
        "`./check` lives five minutes of it, `./check --long` an hour, each from a seed of its own that is",
        "printed. `--report FILE` has every sample as JSON.",
        "",
        "## What the daemon took",
        "",
        "| life | s | listens after s | memory MB: first, last, most | slope MB/h | grown MB | descriptors: "
        "first, last, least, most | threads: first, last, least, most | cores |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for life in figures["lives"]:
        if "threads" not in life:
            continue
        memory, files, threads = life["memory_mb"], life["descriptors"], life["threads"]
        lines.append(
            f"| {life['life']}, {life['how']} | {life['seconds']:.0f} "
            f"| {life['until_listening_secs']:.2f} "
            f"| {memory['first']:.0f}, {memory['last']:.0f}, {memory['max']:.0f} "
            f"| {life['slope_mb_per_hour']:+.0f} | {life['grown_mb']:+.1f} "
            f"| {_four(files)} | {_four(threads)} | {life['cores']:.2f} |"
        )
    lines += [
        "",
        "The slope is that of least squares over the last two thirds of a life, and what it comes to in that",
        "time must be below 8 MB and half a megabyte a swarm: what buffers and pools may come to need, as in",
        "`tests/daemon/soak.rs`, and what is kept of each swarm's journal and events by promise. Descriptors",
        "are bounded by the sessions there may be at once and 64 of the daemon's own, which is also all that",
        "may be left when everybody has gone; threads by one a swarm and 48.",
        "",
        "## How late it stepped",
        "",
        f"Of {late['steps']} steps half began within {_ms(late['p50'])} of when they were due, 99 of 100 within",
        f"{_ms(late['p99'])}, all within {_ms(late['max'])}: bounds of the histogram in `/metrics`. The slowest "
        "swarm's real-time",
        f"factor, looked at each second, was {factor['median_of_least']} in the median and "
        f"{factor['least']} at the least. The status of all",
        f"swarms at once took {_ms(figures['status_of_all_secs']['p50'])} in the median and "
        f"{_ms(figures['status_of_all_secs']['max'])} at most. Everybody else together",
        f"computed on {figures['others_cores']} cores.",
        "",
        "## What was promised",
        "",
        "| about | promise | seen | |",
        "|---|---|---|---|",
    ]
    for verdict in verdicts:
        seen = verdict.seen.replace("|", "/")
        lines.append(f"| {verdict.about} | {verdict.promise} | {seen} | {_HOLDS[verdict.holds]} |")
    return "\n".join(lines) + "\n"


def _four(it: dict[str, float]) -> str:
    return f"{it['first']:.0f}, {it['last']:.0f}, {it['min']:.0f}, {it['max']:.0f}"


def _ms(seconds: float) -> str:
    return f"{1000.0 * seconds:g} ms"
