"""Lives a day: `python -m day --help`."""

from __future__ import annotations

import argparse
import os
import random
import sys
from pathlib import Path

from . import apart, controllers, evening, plan, promises, report, scientists
from .apart import Disk
from .chronicle import Chronicle
from .lab import Lab
from .ledger import Ledger
from .meter import Meter
from .node import Node
from .troubles import Troubles
from .viewers import Crowd

_ROOT = Path(__file__).resolve().parents[4]
_IS_LONG = "JOSTLE_LONG" in os.environ


def arguments() -> argparse.Namespace:
    """What the day is to be like."""
    parser = argparse.ArgumentParser(prog="day", description="A day in a lab, with trouble.")
    parser.add_argument("--minutes", type=float, default=60.0 if _IS_LONG else 5.0)
    parser.add_argument("--seed", type=int, default=None, help="the day's; it is printed")
    parser.add_argument("--swarms", type=int, default=20)
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--report", type=Path, help="where to write all that was seen, as JSON")
    parser.add_argument("--write-docs", action="store_true", help="write docs/soak.md")
    parser.add_argument(
        "--jostled",
        type=Path,
        default=Path(os.environ.get("JOSTLED", _ROOT / "target" / "release" / "jostled")),
        help="the daemon; the command line is beside it",
    )
    return parser.parse_args()


def live(told: argparse.Namespace, work: Path) -> bool:
    """Lives the day below `work`, and tells whether every promise holds."""
    seed = random.randrange(2**32) if told.seed is None else told.seed
    seconds = 60.0 * told.minutes
    drawn = plan.draw(seed, seconds, told.swarms, told.viewers)
    print(f"a day of {told.minutes:g} minutes, --seed {seed}", flush=True)
    disk = Disk(work / "disk", round(48 + 8 * told.minutes))
    node = Node(told.jostled.resolve(), disk.path / "data", work)
    lab: Lab | None = None
    try:
        life = node.start()
        ledger = Ledger()
        lab = Lab(
            plan=drawn,
            work=work,
            disk=disk,
            node=node,
            ledger=ledger,
            people=scientists.gather(node.endpoint, drawn, ledger),
            controllers={it.who.name: it for it in controllers.gather(node.endpoint, work)},
            crowd=Crowd(node.endpoint, list(drawn.specs), told.viewers, seed, work),
            chronicle=Chronicle(node),
            meter=Meter(node),
        )
        lab.say(f"the daemon listens after {life.listening - life.began:.2f} s")
        lab.meter.look()
        lab.meter.start()
        for swarm in ("loop-1", "loop-2"):
            lab.people.breeder.create(swarm)
        for controller in lab.controllers.values():
            controller.start()
        for person in lab.people.all():
            person.start()
        lab.chronicle.start()
        Troubles(lab).live()
        lab.say("the day is over")
        evening.go_home(lab)
        evening.ask_once_more(lab)
        verdicts = promises.judge(lab)
        report.tell(lab, verdicts, told.report, _ROOT if told.write_docs else None)
        return all(verdict.holds is not False for verdict in verdicts)
    except BaseException:
        tail = node.log.read_text(errors="replace").splitlines()[-20:]
        print("\n".join(["the daemon said last:", *tail]), file=sys.stderr)
        print(f"the day's seed: --seed {seed}", file=sys.stderr)
        raise
    finally:
        node.end()
        if lab is not None:
            evening.end_all(lab)


def _main() -> int:
    entered = apart.enter()
    if isinstance(entered, int):
        return entered
    return 0 if live(arguments(), entered) else 1


if __name__ == "__main__":
    sys.exit(_main())
