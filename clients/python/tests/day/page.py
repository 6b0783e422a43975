"""Writes docs/soak.md of one day."""

from __future__ import annotations

from typing import Any

from .lab import Lab
from .promises import Verdict, told

_PAGE = """\
# A day in a lab

{swarms} swarms, two experiments, four controllers in lock-step, {viewers} viewers who come and go,
recordings and a replay. The daemon is killed twice, its disk fills, one controller is killed in
the middle of an exchange and another one is stopped. At the end every promise of
[guarantees.md](guarantees.md) that can be seen from outside is checked. These are the figures of
{minutes:g} minutes with everything on {cores} cores and {memory_gb} GB; this page was written by

```sh
PYTHONPATH=clients/python/tests target/venv/bin/python -m day \\
  --minutes {minutes:g} --seed {seed} --write-docs
```

`./check` lives five minutes of it and `./check --long` an hour, from a seed of its own, which is
printed; `--report FILE` writes every sample as JSON.

## What the daemon took

| life | s | listens, s | memory, MB | slope, MB/h | grown, MB | descriptors | threads | cores |
|---|---|---|---|---|---|---|---|---|
{lives}

Of memory, descriptors and threads: the first, the last, the least and the most, looked at each
second. The slope is that of least squares over the last two thirds of a life, and *grown* is what
it comes to in that time. Bounds:

- Memory grows by less than 8 MB, half a megabyte a swarm and 671 bytes an answer: what buffers and
  pools may come to need, as in `tests/daemon/soak.rs`; the 256 KiB each of journal and of events
  that are kept; and of 100,000 answers the 64 MiB that are. Whether memory grows after all this is
  full is judged by `memory::two_thousand_swarms` of [guarantees.md](guarantees.md), not by a day.
- Descriptors: one for each session that there may be at once, and 64 of its own, which is also
  all that may be left when everybody has gone.
- Threads: one for each swarm that there may be at once, and 28 of its own, which is also all that
  may be left when everybody has gone; and the 50 that zenoh may take for handshakes when all
  connect at once, as they do after a kill.

## How late it stepped

| steps due | half within | 99 of 100 within | all within |
|---|---|---|---|
| {steps} | {p50} | {p99} | {most} |

These are bounds of the histogram in `/metrics`, all lives together. The real-time factor of the
slowest swarm, looked at each second, was {median} in the median and {least} at the least. A status
took {get_p50} in the median, {get_p99} in 99 of 100 and {get_max} at most, asked by a program that
does much besides. All but the daemon computed on {others} cores.

## What was promised

| about | promise | seen | |
|---|---|---|---|
{promises}
"""


def write(lab: Lab, verdicts: list[Verdict], figures: dict[str, Any]) -> str:
    """The page."""
    late, factor = figures["lateness_secs"], figures["real_time_factor"]
    gets = figures["status_secs"]
    return _PAGE.format(
        **{name: figures[name] for name in ("swarms", "viewers", "cores", "memory_gb")},
        minutes=lab.plan.seconds / 60.0,
        seed=lab.plan.seed,
        lives="\n".join(_life(life) for life in figures["lives"] if "threads" in life),
        steps=late["steps"],
        p50=_ms(late["p50"]),
        p99=_ms(late["p99"]),
        most=_ms(late["max"]),
        median=factor["median_of_least"],
        least=factor["least"],
        get_p50=_ms(gets["p50"]),
        get_p99=_ms(gets["p99"]),
        get_max=_ms(gets["max"]),
        others=figures["others_cores"],
        promises="\n".join(
            f"| {it.about} | {it.promise} | {it.seen.replace('|', '/')} | {told(it)} |"
            for it in verdicts
        ),
    )


def _life(life: dict[str, Any]) -> str:
    extents = [
        ", ".join(f"{it[name]:.0f}" for name in ("first", "last", "min", "max"))
        for it in (life["memory_mb"], life["descriptors"], life["threads"])
    ]
    return (
        f"| {life['life']}, {life['how']} | {life['seconds']:.0f} "
        f"| {life['until_listening_secs']:.2f} | {extents[0]} | {life['slope_mb_per_hour']:+.1f} "
        f"| {life['grown_mb']:+.1f} | {extents[1]} | {extents[2]} | {life['cores']:.2f} |"
    )


def _ms(seconds: float) -> str:
    return f"{1000.0 * seconds:g} ms"
