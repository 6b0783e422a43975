"""The figure of docs/measures.md is what a daemon computes, and what the definitions say."""

from __future__ import annotations

import math
import re
import runpy

import jostle
from conftest import ROOT

PICTURES = ROOT / "docs" / "pictures"

MINUS = "\u2212"

EXPECTED = {
    "all one way": {"order": 1.0, "nematic": 1.0},
    "any way": {"order": 0.0, "nematic": 0.0},
    "in two lanes": {"order": 0.0, "nematic": 1.0},
    "in a mill": {"order": 0.0, "milling": 1.0},
    # The mean of cos 30°, cos 20° and cos 0°, each of two; the ranks 4 and 5 of 0 to 5.
    "the informed lead": {
        "drift": (math.cos(math.radians(30)) + math.cos(math.radians(20)) + 1) / 3,
        "front": 0.9,
    },
    # The cosine of 120°; the ranks 0 and 1.
    "the informed fail": {"drift": -0.5, "front": 0.1},
    # Sets of 3, 2 and 1, with 3 pairs that touch.
    "three clusters": {
        "clusters.count": 3.0,
        "clusters.largest": 3.0,
        "clusters.n_eff": (9 + 4 + 1) / 6,
        "contacts_per_body": 2 * 3 / 6,
    },
}
"""The values of the groups, from the definitions in docs/measures.md."""


def test_the_figure_of_the_measures_is_what_a_daemon_computes(client: jostle.Client) -> None:
    made = runpy.run_path(str(PICTURES / "measures.py"))["picture"](client)
    assert made == (PICTURES / "measures.svg").read_text(encoding="utf-8")
    panels = re.findall(r'title" y="-72">([^<]+)<(.*?)</g>', made, flags=re.DOTALL)
    shown = {
        title: {
            name: float(value.replace(MINUS, "-"))
            for name, value in re.findall(rf">([a-z_.]+) ({MINUS}?[\d.]+)</text>", panel)
        }
        for title, panel in panels
    }
    assert len(shown) == 8
    for title, values in EXPECTED.items():
        assert {name: shown[title][name] for name in values} == {
            name: round(value, 2) for name, value in values.items()
        }
