"""The overhead of `jostle.sweep` on all cores of this machine, in CPU time.

    target/venv/bin/python benches/sweep.py [TASKS] [--dask [--dask-defaults]]

It executes runs of n = 50 for 1,000 time units in tasks that are planned for 30 s, and compares
the CPU time of the overhead (Python, planning, merging) with that of `jostled run`. With --dask a
Dask scheduler and a worker for each core execute the tasks, and their CPU time is overhead, too;
they have the settings that `docs/cluster.md` recommends, or with --dask-defaults Dask's own. It
exits with 1 above 5 %.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import jostle

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 0.05
TASK_SECS = 30.0
# Expected seconds of one run; determines the number of runs for TASKS tasks.
RUN_SECS = 0.9
EXPERIMENT = """
name = "overhead"
duration = 1000
replicates = {}
spec = {{ n = 50 }}
grid = [{{ pi1 = 4, informed = 5 }}]
measure = {{ order_every = 50 }}
"""
# The settings of Dask that `docs/cluster.md` recommends.
DASK_SETTINGS = {
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}
# A wrapper of `jostled` that appends its CPU time to a file.
TIMED = """#!/bin/bash
TIMEFORMAT='%U %S'
{{ time {} "$@" 2>&3; }} 3>&2 2>>{}
"""


def used(who: int) -> float:
    """CPU seconds of this process or of the programs that it started."""
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


@contextmanager
def cluster(folder: Path) -> Iterator[str]:
    """A Dask scheduler in this process and a worker process for each core."""
    from distributed import LocalCluster

    workers = len(os.sched_getaffinity(0))
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=None, local_directory=str(folder)
    ) as local:
        yield f"dask:{local.scheduler_address}"


def main() -> None:
    """Executes the sweep and prints the figures."""
    parser = argparse.ArgumentParser(description="The overhead of jostle.sweep.")
    parser.add_argument("tasks", nargs="?", type=int, default=10, help="number of tasks [10]")
    parser.add_argument("--dask", action="store_true", help="execute the tasks by Dask")
    parser.add_argument("--dask-defaults", action="store_true", help="with Dask's own settings")
    arguments = parser.parse_args()
    if not arguments.dask_defaults:
        # `distributed` reads them when it is imported, and so do its workers.
        os.environ.update(DASK_SETTINGS)
    tasks = arguments.tasks
    release = ROOT / "target" / "release"
    runs = round(tasks * TASK_SECS / RUN_SECS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        times = folder / "times"
        (folder / "jostle").symlink_to(release / "jostle")
        program = folder / "jostled"
        program.write_text(TIMED.format(release / "jostled", times), encoding="utf-8")
        program.chmod(0o755)
        began = time.monotonic()
        with (
            cluster(folder) if arguments.dask else nullcontext() as executor,
            jostle.sweep(
                EXPERIMENT.format(runs),
                executor,
                folder=folder / "results",
                task_secs=TASK_SECS,
                jostled=program,
            ) as sweep,
        ):
            rows = sweep.wait(show=False).rows()
        wall = time.monotonic() - began
        lines = times.read_text(encoding="utf-8").splitlines()
        in_runs = sum(float(it) for line in lines for it in line.split())
    others = used(resource.RUSAGE_SELF) + used(resource.RUSAGE_CHILDREN) - in_runs
    each = in_runs / len(rows)
    print(f"{len(rows)} runs in {len(lines)} tasks: {wall:.0f} s, {each:.2f} s of CPU each")
    share = others / in_runs
    print(f"overhead: {others:.2f} s, {share:.2%} of the runs' CPU time (limit {LIMIT:.0%})")
    sys.exit(share > LIMIT)


if __name__ == "__main__":
    main()
