"""Runs the chaos test: `python -m chaos --help`."""

from __future__ import annotations

import argparse
import os
import random
import sys
from pathlib import Path

from . import clients, controller_process, guarantees, isolation, plan, report, shutdown
from .context import Context
from .faults import FaultSchedule
from .isolation import Disk
from .meter import Meter
from .node import Node
from .observer import Observer
from .requests import RequestLog
from .viewers import Viewers

_ROOT = Path(__file__).resolve().parents[4]
_IS_LONG = "JOSTLE_LONG" in os.environ


def arguments() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(
        prog="chaos", description="Load and faults on one daemon; judges every guarantee."
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=60.0 if _IS_LONG else 5.0,
        help="from 1; below 5 some guarantees have too few cases and are listed as not judged",
    )
    parser.add_argument("--seed", type=int, default=None, help="printed if it is drawn")
    parser.add_argument("--swarms", type=int, default=20)
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--report", type=Path, help="write verdicts and samples to this JSON file")
    parser.add_argument(
        "--jostled",
        type=Path,
        default=Path(os.environ.get("JOSTLED", _ROOT / "target" / "release" / "jostled")),
        help="the daemon; the command line is beside it",
    )
    read = parser.parse_args()
    if read.minutes < 1.0:
        parser.error(f"--minutes {read.minutes:g} is too short for the faults: use 1 or more")
    return read


def run(options: argparse.Namespace, work: Path) -> bool:
    """Runs the test below `work`. Returns whether no judged guarantee is violated."""
    seed = random.randrange(2**32) if options.seed is None else options.seed
    seconds = 60.0 * options.minutes
    drawn = plan.draw(seed, seconds, options.swarms, options.viewers)
    print(f"a chaos test of {options.minutes:g} minutes, --seed {seed}", flush=True)
    # Experiments leave 64 MiB to the swarms.
    disk = Disk(work / "disk", round(64 + 48 + 8 * options.minutes))
    node = Node(options.jostled.resolve(), disk.path / "data", work)
    context: Context | None = None
    try:
        first = node.start()
        requests = RequestLog()
        controllers = controller_process.create_all(node.endpoint, work)
        context = Context(
            plan=drawn,
            work=work,
            disk=disk,
            node=node,
            requests=requests,
            clients=clients.create_all(node.endpoint, drawn, requests),
            controllers={it.who.name: it for it in controllers},
            viewers=Viewers(node.endpoint, list(drawn.specs), options.viewers, seed, work),
            observer=Observer(node),
            meter=Meter(node),
        )
        context.log(f"the daemon listens after {first.listening - first.began:.2f} s")
        context.meter.sample()
        context.meter.start()
        for swarm in ("loop-1", "loop-2"):
            context.clients.lifecycle.create(swarm)
        for controller in context.controllers.values():
            controller.start()
        for client in context.clients.all():
            client.start()
        context.observer.start()
        FaultSchedule(context).run()
        context.log("the time is over")
        shutdown.stop_load(context)
        shutdown.read_final_state(context)
        verdicts = guarantees.judge(context)
        report.write(context, verdicts, options.report)
        return all(verdict.holds is not False for verdict in verdicts)
    except BaseException:
        tail = node.log.read_text(errors="replace").splitlines()[-20:]
        print("\n".join(["the last lines of the daemon's log:", *tail]), file=sys.stderr)
        print(f"the seed: --seed {seed}", file=sys.stderr)
        raise
    finally:
        node.end()
        if context is not None:
            shutdown.end_processes(context)


def _main() -> int:
    options = arguments()
    entered = isolation.enter()
    if isinstance(entered, int):
        return entered
    return 0 if run(options, entered) else 1


if __name__ == "__main__":
    sys.exit(_main())
