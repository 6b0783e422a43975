"""What a notebook shows: pictures, tables, a live view, bars; in a real kernel."""

from __future__ import annotations

import dataclasses
import pickle
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import msgspec
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import jostle
from conftest import MAX_WAIT_SECS, Daemon
from jostle._draw import HEIGHT, WIDTH, Camera
from jostle._state import draw_state

Create = Callable[..., jostle.Swarm]


def shown(thing: Any) -> str:
    """The HTML that a notebook shows, with every element closed."""
    text: str = thing._repr_html_()
    ET.fromstring(f"<all>{text.replace('<br>', '<br/>')}</all>")
    return text


def picture(text: str) -> ET.Element:
    found = re.search(r"<svg.*</svg>", text, re.S)
    assert found is not None
    return ET.fromstring(found[0])


def bodies(text: str) -> list[tuple[str, float, np.ndarray[Any, Any]]]:
    """Colour, width and ends of every line of a body, in pixels."""
    lines = []
    for path in picture(text).iter("{http://www.w3.org/2000/svg}path"):
        for ends in re.findall(r"M(\S+) (\S+)L([\d.-]+) ([\d.-]+)", path.get("d", "")):
            if path.get("stroke-width") != "3":
                width = float(path.get("stroke-width", "0"))
                lines.append((path.get("stroke", ""), width, np.array(ends, float).reshape(2, 2)))
    return lines


def test_a_picture_is_to_scale(create: Create) -> None:
    x, y, alpha = [0.0, 3.0], [0.0, 0.0], [0.0, np.pi / 2]
    swarm = create(n=2, pi1=3.0, start=jostle.given(x, y, alpha))
    swarm.inform(jostle.ids([1]), 0.0)
    # An edge and a fill for each of them.
    (edge, width, first), _, (edge_2, _, second), _ = bodies(shown(swarm.state()))
    assert edge != edge_2
    scale = (second.mean(axis=0) - first.mean(axis=0))[0] / 3.0
    # As in MODEL.md: radius 1/(1 + pi1), half the axis (pi1 - 1) times that.
    assert width == pytest.approx(2.0 * scale / 4.0, rel=0.01)
    assert first[1] - first[0] == pytest.approx([scale, 0.0], abs=0.2)
    # North is up.
    assert second[1] - second[0] == pytest.approx([0.0, -scale], abs=0.2)


def test_a_zero_has_no_sign(create: Create) -> None:
    swarm = create(n=3)
    swarm.inform(jostle.count(1), 0.0)
    state = swarm.state()
    for zero in (-0.0, -1e-9):
        order = msgspec.structs.replace(state.order, drift=zero)
        assert "drift +0.00" in shown(dataclasses.replace(state, order=order))
    table = shown(msgspec.structs.replace(state.order, drift=-0.0))
    assert "<th>drift</th><td>0</td>" in re.sub(r"<(\w+) [^>]*>", r"<\1>", table)


def test_the_picture_says_how_far_the_informed_agree(create: Create) -> None:
    swarm = create(n=4)
    assert swarm.state().order.direction_strength is None
    swarm.inform(jostle.ids([0]), 0.5)
    text = shown(swarm.state())
    assert " along 0.50 rad" in text
    assert "disagree" not in text
    swarm.inform(jostle.ids([1]), 1.5)
    order = swarm.status().order
    assert order.direction == pytest.approx(1.0)
    assert order.direction_strength == pytest.approx(np.cos(0.5))
    assert " along 1.00 rad, the informed disagree: strength 0.88" in shown(swarm.state())
    swarm.inform(jostle.ids([1]), 0.5 + 3.1416)
    order = swarm.status().order
    assert (order.direction, order.drift) == (None, None)
    text = shown(swarm.state())
    assert ", the informed disagree: strength 0.00" in text
    assert "drift" not in text


def test_every_individual_is_in_the_picture(create: Create) -> None:
    for n, pi1 in ((1, 1.0), (2, 32.0), (60, 4.0), (300, 1.0)):
        swarm = create(n=n, pi1=pi1)
        state = swarm.step(20, state=True)
        assert state.pi1 == pi1
        for ends in (it[2] for it in bodies(shown(state))):
            assert ((ends >= 0.0) & (ends <= (WIDTH, HEIGHT))).all()
        assert f"{n} individual" in shown(state)
    far = create(n=3)
    far.inject(at=[[900_000.0, -3e5, 0.0]])
    assert len(bodies(shown(far))) == 8


def test_the_size_of_bodies_is_the_one_last_received(create: Create, client: jostle.Client) -> None:
    swarm = create(n=3, pi1=2.0)
    assert client.swarm(swarm.name).state().pi1 == 2.0
    swarm.state()
    swarm.set(pi1=1.5)
    assert swarm.state().pi1 == 1.5
    swarm.batch([jostle.Set(pi1=1.25)])
    with swarm.states() as states:
        assert next(states).pi1 == 1.25
    client.swarm(swarm.name).reset()
    assert swarm.step(state=True).pi1 == 2.0
    client.swarm(swarm.name).set(pi1=1.0)
    swarm.status()
    state = swarm.state()
    assert state.pi1 == 1.0
    assert pickle.loads(pickle.dumps(state)).pi1 == 1.0


def test_arrows_show_the_preferred_directions_and_not_the_headings(create: Create) -> None:
    swarm = create(n=30)
    assert "<polygon" not in shown(swarm.state())
    swarm.inform(jostle.ids([0, 4]), 0.7)
    swarm.inform(jostle.ids([9]), 4.0)
    # No body has turned yet.
    state = swarm.state()
    polygons = picture(shown(state)).iter("{http://www.w3.org/2000/svg}polygon")
    tips = [np.array(it.get("points", "").split(" ")[0].split(","), float) for it in polygons]
    # A disc in the upper right corner, in pixels whose y increases downwards.
    away = np.array(tips) - (WIDTH - 30.0, 30.0)
    directions = np.arctan2(-away[:, 1], away[:, 0]) % (2.0 * np.pi)
    assert np.sort(directions) == pytest.approx([0.7, 4.0], abs=0.01)
    assert not np.isclose(state.alpha[[0, 4, 9]] % (2.0 * np.pi), [0.7, 0.7, 4.0], atol=0.1).any()


def test_the_camera_moves_only_if_it_must(create: Create) -> None:
    state = create(n=30).state()
    camera = Camera()
    draw_state(state, camera)
    scale = camera.scale
    camera.follow(state.position * 0.9 + 100.0)
    assert camera.scale == scale
    camera.follow(state.position * 2.0)
    assert camera.scale < scale / 2.0
    camera.follow(state.position)
    assert camera.scale > 0.8 * scale


def test_tables_show_all_fields_and_escape_text(create: Create, client: jostle.Client) -> None:
    swarm = create(n=3)
    evil = "<script>alert('1')</script>&<b>"
    with jostle.connect(client.endpoint, client=evil) as other:
        other.swarm(swarm.name).inform(jostle.count(1), 0.0, request_id=f'"{evil}"')
    for thing in (
        client,
        swarm,
        swarm.status(),
        swarm.spec(),
        swarm.state().order,
        swarm.history(),
        swarm.history()[-1],
        swarm.journal(),
        swarm.parameters()["pi3"],
        client.swarms(),
        client.experiments(),
        client.hello(),
        client.metrics(),
        swarm.step(),
        client.experiment("unknown"),
        client.swarm("unknown"),
        jostle.HtmlList[int](),
    ):
        text = shown(thing)
        assert "<script" not in text
        assert "<b>&" not in text
    assert "&lt;script" in shown(swarm.journal())
    assert "NotFound" in shown(client.swarm("unknown"))
    assert "<tr>" in shown(client)
    long = shown(jostle.HtmlList(range(500)))
    assert long.count("<tr>") == 26
    assert "… 476 more …" in long
    with jostle.connect(client.endpoint) as other:
        pass
    assert "closed" in shown(other)


def run_cells(daemon: Daemon, *cells: str) -> list[Any]:
    """Executes the cells in a new kernel and returns the output of each."""
    v4: Any = nbformat.v4
    notebook = v4.new_notebook()
    begin = f"import jostle, time\nclient = jostle.connect({daemon.endpoint!r})"
    notebook.cells = [v4.new_code_cell(cell) for cell in (begin, *cells)]
    NotebookClient(notebook, timeout=60, kernel_name="python3").execute()
    return [cell.outputs for cell in notebook.cells[1:]]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_view_updates_while_other_cells_run(daemon: Daemon, create: Create) -> None:
    swarm = create(n=10, rate=20.0)
    live, shown_live, after, shown_again = run_cells(
        daemon,
        f"swarm = client.swarm({swarm.name!r})\nview = swarm.view(30.0)\nview",
        "import threading\n"
        "swarm.run(until_step=200, wait=True)\n"
        "swarm.inform(jostle.count(3), 0.0)\n"
        "time.sleep(0.5)\n"
        "print(view)\nview.stop()\nview.stop()\nprint(view)\n"
        # They end soon after their subscriptions are undeclared.
        "def left():\n"
        "    return [it.name for it in threading.enumerate() if 'jostle' in it.name]\n"
        "until = time.monotonic() + 10\n"
        "while left() and time.monotonic() < until:\n"
        "    time.sleep(0.01)\n"
        "print(left())",
        "swarm.view(0.3).show()",
        "swarm.delete()\nswarm.view(20.0).show()",
    )
    assert len(live) == 1
    text = live[0].data["text/html"]
    assert "step 200" in text
    assert "3 informed" in text
    assert len(bodies(text)) == 20
    # What a cell prints comes in as many outputs as the kernel has flushed.
    printed = "".join(o.text for o in shown_live if o.output_type == "stream")
    assert printed.splitlines() == [f"View({swarm.name!r}, live)", f"View({swarm.name!r})", "[]"]
    assert "step 200" in after[0].data["text/html"]
    assert "NotFound" in shown_again[0].data["text/html"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_view_ends_with_its_swarm_or_client(daemon: Daemon, create: Create) -> None:
    swarm = create(n=3, rate=20.0)
    live, outputs = run_cells(
        daemon,
        f"swarm = client.swarm({swarm.name!r})\nswarm.run()\nview = swarm.view(30.0)\nview",
        # During this many states the view has had the time to show one.
        "with swarm.states() as states:\n    for _ in range(20):\n        next(states)\n"
        "began = time.monotonic()\nswarm.delete()\nprint(view.wait(10.0))\n"
        "other = client.create(swarm.name, {'n': 2, 'rate': 20.0})\nother.run()\n"
        "view = other.view(30.0)\ndisplay(view)\nclient.close()\nprint(view.wait(10.0))\n"
        "print(time.monotonic() - began < 8.0)",
    )
    assert "step" in live[0].data["text/html"]
    text = "".join(output.text for output in outputs if output.output_type == "stream")
    assert text.split() == ["True", "True", "True"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_bar_is_in_one_place_of_a_notebook(daemon: Daemon, create: Create) -> None:
    swarm = create(n=3, rate=20.0)
    waited, quick, plotted = run_cells(
        daemon,
        f"swarm = client.swarm({swarm.name!r})\nswarm.run(until_step=2000, wait=True).step",
        "swarm.step(10).step",
        "table = swarm.frame(steps=30, every=10, show=True)\nlen(table)",
    )
    bar, result = waited
    assert "<progress" in bar.data["text/html"]
    assert "100 % step 2000" in bar.data["text/html"]
    assert result.data["text/plain"] == "2000"
    assert [output.output_type for output in quick] == ["execute_result"]
    assert "step 2040" in plotted[0].data["text/html"]
    assert plotted[-1].data["text/plain"] == "12"


def test_bars_are_hidden_without_a_terminal(
    create: Create, capsys: pytest.CaptureFixture[str]
) -> None:
    swarm = create(n=3, rate=20.0)
    swarm.run(until_step=500, wait=True)
    swarm.frame(steps=3)
    assert capsys.readouterr() == ("", "")
    swarm.run(until_step=900, wait=True, show=True)
    swarm.frame(steps=3, show=True)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert swarm.name in printed.err
    assert "step 903" in printed.err


def test_a_terminal_has_a_bar(daemon: Daemon, create: Create) -> None:
    swarm = create(n=3, rate=20.0)
    code = (
        f"import jostle\nwith jostle.connect({daemon.endpoint!r}) as client:\n"
        f"    client.swarm({swarm.name!r}).run(until_step=1500, wait=True)\n"
    )
    # `script` gives it a terminal.
    began = time.monotonic()
    ran = subprocess.run(
        [
            "script",
            "-qec",
            f'stty rows 40 cols 100; {sys.executable} -W error -c "{code}"',
            "/dev/null",
        ],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=MAX_WAIT_SECS,
        check=True,
    )
    assert time.monotonic() - began < 10.0
    assert re.search(rf"{swarm.name} .*%.*step \d+ of 1500", ran.stdout), ran.stdout


def test_a_view_without_a_notebook_names_the_extra(create: Create) -> None:
    swarm = create(n=2)
    view = swarm.view()
    assert repr(view) == f"View({swarm.name!r})"
    view.stop()
    assert view.wait()
    with pytest.raises(jostle.InvalidArgument):
        swarm.view(0.0)
    code = (
        "import sys\nsys.modules['IPython'] = None\nimport jostle\n"
        f"with jostle.connect({swarm._session.endpoint!r}) as client:\n"
        f"    try:\n        client.swarm({swarm.name!r}).view().show()\n"
        "    except ImportError as error:\n        print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'jostle[notebook]'" in ran.stdout
