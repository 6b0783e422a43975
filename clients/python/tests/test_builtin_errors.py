"""Errors as Python's own kinds, and what calls with a wrong type or an object to pickle say."""

from __future__ import annotations

import copy
import pickle
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jostle
from jostle import _part
from jostle._delivery import Target
from jostle._experiment import Files

Create = Callable[..., jostle.Swarm]

BUILTINS: dict[type[jostle.JostleError], type[Exception]] = {
    jostle.DeadlineExceeded: TimeoutError,
    jostle.InvalidArgument: ValueError,
    jostle.Unavailable: ConnectionError,
}
KINDS = [
    thing
    for thing in vars(jostle).values()
    if isinstance(thing, type) and issubclass(thing, jostle.JostleError)
]


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_is_its_builtin_and_no_other(kind: type[jostle.JostleError]) -> None:
    assert issubclass(kind, BUILTINS.get(kind, jostle.JostleError))
    own = BUILTINS.get(kind, type(None))
    for builtin in (OSError, ValueError, TimeoutError, ConnectionError, LookupError):
        assert issubclass(kind, builtin) is issubclass(own, builtin)


@pytest.mark.parametrize("kind", KINDS)
def test_a_copied_or_pickled_error_is_the_same(kind: type[jostle.JostleError]) -> None:
    error = kind("no luck: try again", details={"field": "n", "range": [1, 2]}, step=7)
    error.code = "of a newer daemon"
    error.add_note("a note")
    copies = [pickle.loads(pickle.dumps(error, it)) for it in range(pickle.HIGHEST_PROTOCOL + 1)]
    for one in (error, *copies, copy.copy(error), copy.deepcopy(error)):
        assert type(one) is kind
        assert (str(one), one.args) == ("no luck: try again", ("no luck: try again",))
        assert vars(one) == vars(error)
        # It is none of the system's.
        if isinstance(one, OSError):
            assert (one.errno, one.strerror, one.filename) == (None, None, None)


def test_calls_raise_builtins(create: Create, free_endpoint: str) -> None:
    swarm = create(n=50)
    with pytest.raises(TimeoutError, match=r"not done within 0\.2 s"):
        swarm.step(10**8, timeout=0.2)
    swarm.pause()
    with pytest.raises(ValueError, match="pi1"):
        swarm.set(pi1=0.5)
    with pytest.raises(ConnectionError, match="jostled serve"):
        jostle.connect(free_endpoint, timeout=0.3)


def failed_part() -> None:
    """Executes a part of an experiment without a program."""
    files = Files('name = "a"\nseed = 1\n')
    _part.run_part(files, "1", "/no/such/jostled", Target("/no/such/folder", ""))


def test_a_part_without_a_program_is_unavailable_not_a_fault_of_its_files() -> None:
    with pytest.raises(jostle.Unavailable, match="/no/such/jostled") as here:
        failed_part()
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(jostle.Unavailable) as there,
    ):
        pool.submit(failed_part).result()
    assert (str(there.value), there.value.details) == (str(here.value), here.value.details)


@pytest.mark.parametrize("condition", ["order > 0.99999 for 1000", "milling > 0.9 for 1000"])
def test_a_wait_that_times_out_names_the_condition(create: Create, condition: str) -> None:
    swarm = create(n=5, rate=1.0)
    awaited = rf"^swarm '{swarm.name}' did not reach {re.escape(condition)}( \(.*\))? within"
    with pytest.raises(jostle.DeadlineExceeded, match=rf"{awaited} 0\.4 s"):
        swarm.wait(condition, timeout=0.4)
    # Its two commands need a part of the time.
    with pytest.raises(jostle.DeadlineExceeded, match=rf"{awaited} 4 s: it runs on; `pause\(\)`"):
        swarm.run(until=condition, wait=True, timeout=4.0)
    assert swarm.status().phase == "running"


@pytest.mark.parametrize("condition", [5, b"order > 0.9", 0.5, ["order > 0.9"], True])
def test_a_condition_that_is_no_text_is_rejected(create: Create, condition: Any) -> None:
    swarm = create(n=2)
    with pytest.raises(jostle.InvalidArgument, match=r"condition is .*'order > 0\.9") as caught:
        swarm.wait(condition)
    assert caught.value.details["field"] == "condition"
    assert swarm.status().seq == 0


@pytest.mark.parametrize(
    "mask", [[True, False], np.array([True, False]), [np.True_], (one for one in (True, False))]
)
def test_a_mask_gets_its_remedy(create: Create, mask: Any) -> None:
    swarm = create(n=2)
    given = list(mask)
    with pytest.raises(jostle.InvalidArgument, match="mask") as caught:
        swarm.inform(jostle.ids(given), direction=0.0)
    assert "state.id[mask]" in str(caught.value)
    assert "np.flatnonzero(mask)" in str(caught.value)
    assert caught.value.details["field"] == "select.ids"
    with swarm.join("ada", jostle.ids([0, 1])) as ada:
        with pytest.raises(jostle.InvalidArgument, match=r"set\.ids is a boolean mask"):
            ada.advance(ids=given, direction=0.0)
        assert ada.step == 0


def test_a_boolean_is_no_number(client: jostle.Client, create: Create) -> None:
    swarm: Any = create(n=3)
    calls: dict[str, Callable[[], object]] = {
        "select.count": lambda: jostle.count(True),
        "select.foremost.count": lambda: jostle.foremost(True, along=0.0),
        "count": lambda: swarm.inject(True),
        "at_step": lambda: swarm.at(True),
        "step": lambda: swarm.wait(step=True),
        "steps": lambda: swarm.step(True),
        "after": lambda: swarm.events(after=True),
        "publish_every": lambda: swarm.set(publish_every=True),
        "limit": lambda: client.audit(limit=True),
    }
    for field, call in calls.items():
        with pytest.raises(jostle.InvalidArgument, match="True") as caught:
            call()
        assert caught.value.details["field"] == field
    assert swarm.status().seq == 0


def test_pickling_a_client_says_what_to_do_instead(client: jostle.Client, create: Create) -> None:
    swarm = create(n=2)
    with swarm.join("ada", jostle.ids([0])) as ada, swarm.states() as states:
        for thing in (client, swarm, ada, states, swarm.at(3), client.experiment("any")):
            for fails in (pickle.dumps, copy.deepcopy):
                with pytest.raises(TypeError, match="cannot be pickled") as caught:
                    fails(thing)
                remedy = f"`jostle.connect({client.endpoint!r}).swarm(name)`"
                assert remedy in str(caught.value)


def test_what_a_pickled_name_leads_to(client: jostle.Client, create: Create) -> None:
    swarm = create(n=2)
    name = pickle.loads(pickle.dumps((client.endpoint, swarm.name)))
    with jostle.connect(name[0]) as other:
        assert other.swarm(name[1]).status().n == 2


def test_a_missing_file_is_still_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        jostle.Snapshot.load(tmp_path / "missing.snapshot")
    assert caught.value.errno is not None
    assert not isinstance(caught.value, jostle.JostleError)
