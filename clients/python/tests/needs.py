"""What tests need on the machine besides Python.

A test without it fails and names the remedy. `JOSTLE_MAY_SKIP` lists, separated by commas, what
may be missing; what was skipped is recorded in the file that `JOSTLE_SKIPPED` names.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest


def may_skip(name: str, test: str) -> bool:
    """Whether a test may be skipped for lack of `name`; records the skip."""
    if name not in (it.strip() for it in os.environ.get("JOSTLE_MAY_SKIP", "").split(",")):
        return False
    if path := os.environ.get("JOSTLE_SKIPPED"):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(f"{name}: {test}\n")
    return True


def refusal(name: str, remedy: str) -> str:
    """The message of a test that may not be skipped."""
    return f"this test needs {name}: {remedy}; or set JOSTLE_MAY_SKIP={name} to skip it"


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fails the run if a test was skipped for another reason than `needs NAME: REMEDY`.

    A skip for that reason is permitted if `JOSTLE_MAY_SKIP` contains NAME.
    """
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    assert reporter is not None, "pytest has a terminal reporter"
    for report in reporter.stats.get("skipped", []):
        reason = report.longrepr[2]
        needs = re.fullmatch(r"Skipped: needs (\w+): (.+)", reason)
        if needs is None:
            reporter.write_line(f"{report.nodeid} may not be skipped: {reason}", red=True)
        elif may_skip(needs[1], report.nodeid):
            continue
        else:
            reporter.write_line(f"{report.nodeid}: {refusal(needs[1], needs[2])}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
