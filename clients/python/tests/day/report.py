"""Tells what was seen: a table, a JSON document, and docs/soak.md."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from . import page
from .lab import Lab
from .promises import Verdict, told


def tell(lab: Lab, verdicts: list[Verdict], report: Path | None, root: Path | None) -> None:
    """Prints the table, and writes what is asked for."""
    print()
    for verdict in verdicts:
        print(f"{told(verdict):13}  {verdict.about}: {verdict.promise}")
        print(f"{'':15}{verdict.seen}")
    figures = measure(lab)
    print()
    for name, figure in figures.items():
        for one in figure if isinstance(figure, list) else [figure]:
            print(f"{name}: {json.dumps(one)}")
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
        text = page.write(lab, verdicts, figures)
        (root / "docs" / "soak.md").write_text(text, encoding="utf-8")
    failed = [verdict for verdict in verdicts if verdict.holds is False]
    print(f"\n{len(failed)} do not hold" if failed else "\neverything holds", flush=True)


def measure(lab: Lab) -> dict[str, Any]:
    """The figures of the day."""
    slowest = sorted(it.slowest for it in lab.meter.samples if it.slowest is not None)
    gets = sorted(lab.chronicle.get_secs)
    return {
        "cores": os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "swarms": len(lab.plan.specs),
        "viewers": lab.plan.viewers,
        "visits": sum(seen.visits for seen in lab.seen),
        "states_seen": sum(seen.states for seen in lab.seen),
        "commands": len(lab.ledger.all()),
        "lateness_secs": lab.meter.late(),
        "real_time_factor": {
            "least": round(slowest[0], 3),
            "median_of_least": round(slowest[len(slowest) // 2], 3),
        },
        "status_secs": {
            "p50": round(gets[len(gets) // 2], 4),
            "p99": round(gets[int(0.99 * len(gets))], 4),
            "max": round(gets[-1], 4),
        },
        "others_cores": round(lab.others_cpu_secs / lab.plan.seconds, 2),
        "lives": [
            {name: it for name, it in lab.meter.life(life).items() if name != "later"}
            for life in lab.node.lives
        ],
    }
