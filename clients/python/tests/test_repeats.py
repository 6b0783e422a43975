"""Repeated blocks of experiments against the same commands, sent by hand to a swarm.

The steps, the draws and the values of ramps are computed here from docs/protocols.md.
"""

from __future__ import annotations

import math
import os
import random
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import pytest

import jostle
from conftest import MAX_WAIT_SECS
from jostle._experiment import to_toml

# Sums and shares of these numbers are exact, so that a ramp has the same bits by any formula.
DT = Fraction(1, 64)
STEPS = 72

Json = dict[str, Any]


@dataclass
class Block:
    """A block as the file has it, and when and with which values it is executed."""

    fields: Json
    # The step and the values of "$" and ramps of each execution.
    executions: list[tuple[int, Json]]
    draw: int | None


def step_at(time: Fraction) -> int:
    """The first step at or after a time."""
    return math.ceil(time / DT)


def some(draw: random.Random, variables: dict[str, Fraction]) -> tuple[Json, Json]:
    """A command: as the file has it, and by hand with the number `x` where a ramp is."""
    angle = draw.randrange(-48, 48) / 16
    weight = draw.choice([None, 0.25, 0.75])
    informs: Json = {"direction": angle, **({} if weight is None else {"weight": weight})}
    if draw.random() < 0.25:
        informs["for_time"] = draw.randrange(1, 40) / 64
    share = draw.choice([0.125, 0.25, 0.5])
    selects: list[Json] = [
        {"fraction": share},
        {"fraction": share},
        {"count": draw.randrange(1, 4)},
        {"informed": draw.random() < 0.5},
        {"foremost": {"count": draw.randrange(1, 4), "along": angle}},
    ]
    select = draw.choice(selects)
    kind = draw.choice(["inform", "inform", "uninform", "uninform", "inject", "remove", "set"])
    match kind:
        case "inform":
            args: Json = {"select": select, **informs}
        case "uninform":
            args = {"select": select}
        case "inject":
            args = {"count": draw.randrange(1, 3)}
            if draw.random() < 0.5:
                args |= {"direction": angle}
        case "remove":
            args = {"select": {"count": 1}}
        case _:
            args = draw.choice(
                [{"noise": draw.randrange(0, 16) / 32}, {"pi3": 1 + draw.randrange(0, 16) / 32}]
            )
    by_hand = {kind: args}
    in_file = {kind: args}
    if "fraction" in args.get("select", {}) and draw.random() < 0.4:
        in_file = {kind: {**args, "select": {"fraction": "$share"}}}
        by_hand = {kind: {**args, "select": {"fraction": float(variables["share"])}}}
    return in_file, by_hand


def block(draw: random.Random, variables: dict[str, Fraction]) -> Block:
    """A block that is repeated, or sometimes not, with one to three commands."""
    chosen = [some(draw, variables) for _ in range(draw.randrange(1, 4))]
    in_file: Json = {}
    by_hand: Json = {}
    for one, other in chosen:
        # Each verb once: the order of the commands is that of the keys.
        if not one.keys() & in_file.keys():
            in_file |= one
            by_hand |= other
    end = STEPS * DT
    first = Fraction(draw.randrange(0, 80), 128)
    every = draw.choice([Fraction(1, 64), Fraction(3, 128), Fraction(1, 16), Fraction(11, 128)])
    every *= draw.choice([1, 1, 2, 4])
    if draw.random() < 0.2:
        in_file = {"step": (step := draw.randrange(0, STEPS)), **in_file}
        executions = [(step, by_hand)]
    else:
        last = None
        # So many steps of a ramp that its shares are exact.
        counts = [it for it in (1, 2, 4, 8, 16) if first + it * every <= end]
        if counts and draw.random() < 0.7:
            last = first + draw.choice(counts) * every
        has_ramp = last is not None and last < end and draw.random() < 0.6
        times: Json = {"every": float(every)}
        if draw.random() < 0.4 and variables["every"] == every:
            times["every"] = "$every"
        if first or draw.random() < 0.5:
            times["from"] = float(first)
        if last is not None:
            times["until"] = float(last)
        name = draw.choice(["noise", "pi3"])
        low, high = draw.choice([(1.0, 1.5), (2.0, 1.0), (1.25, 1.25)])
        if has_ramp:
            in_file.pop("set", None)
            by_hand.pop("set", None)
            in_file["set"] = {name: {"ramp": [low, high]}}
        in_file = {**times, **in_file}
        executions = []
        k = 0
        while (time := first + k * every) <= (end if last is None else last):
            # No block is executed at the end of a run.
            if (step := step_at(time)) >= STEPS:
                break
            values = dict(by_hand)
            if has_ramp:
                assert last is not None
                share = (time - first) / (last - first)
                values["set"] = {name: low + float(share) * (high - low)}
            executions.append((step, values))
            k += 1
    number = draw.choice([0, 1, draw.randrange(10**6)]) if draw.random() < 0.35 else None
    if number is not None:
        in_file["draw"] = number
    return Block(in_file, executions, number)


def changes(values: Json) -> list[jostle.Change]:
    """The commands of an execution as changes."""
    kinds = {
        "inform": jostle.Inform,
        "uninform": jostle.Uninform,
        "inject": jostle.Inject,
        "remove": jostle.Remove,
        "set": jostle.Set,
    }
    return [kinds[verb](**args) for verb, args in values.items()]


def by_hand(client: jostle.Client, spec: Json, informed: int, blocks: list[Block]) -> str | int:
    """The hash after the commands of all blocks, or the step at which one is rejected."""
    swarm = client.create("by-hand", spec)
    number = 1
    alone = all(it.draw is None for it in blocks)
    try:
        if informed:
            swarm.inform(jostle.count(informed), direction=0.0)
            number += 1
        done = [0] * len(blocks)
        due = sorted({step for it in blocks for step, _ in it.executions})
        for step in due:
            if step > swarm.status().step:
                swarm.step(step - swarm.status().step)
            for index, it in enumerate(blocks):
                for at, values in it.executions:
                    if at != step:
                        continue
                    these = changes(values)
                    first = number if it.draw is None else it.draw + done[index]
                    try:
                        if alone:
                            # Each change has the next draw.
                            for more, change in enumerate(these):
                                swarm.batch([change], draw=first + more)
                        else:
                            swarm.batch(these, draw=first)
                    except jostle.JostleError:
                        return step
                    if it.draw is None:
                        number += len(these)
                    else:
                        done[index] += len(these)
        swarm.step(STEPS - swarm.status().step)
        return swarm.status().state_hash
    finally:
        swarm.delete()


@pytest.mark.parametrize("part", range(4))
def test_random_repeated_blocks_are_the_commands_by_hand(part: int, client: jostle.Client) -> None:
    base = int(os.environ.get("JOSTLE_SEED", "50"))
    executed = repeats = hashes = drawn = alone = 0
    # A command that is rejected ends a run, by hand at the same step.
    for index in range(40):
        if hashes >= 5 and executed > 60 and repeats >= 6:
            break
        seed = 1000 * base + 40 * part + index
        draw = random.Random(seed)
        variables = {
            "share": Fraction(draw.randrange(1, 8), 16),
            "every": draw.choice([Fraction(1, 16), Fraction(3, 64), Fraction(1, 64)]),
        }
        blocks = [block(draw, variables) for _ in range(draw.randrange(1, 5))]
        informed = draw.choice([0, 0, 2])
        n = draw.randrange(12, 24)
        used = to_toml({"at": [it.fields for it in blocks]})
        grid: Json = {"n": [n], **({"informed": [informed]} if informed else {})}
        grid |= {name: float(it) for name, it in variables.items() if f'"${name}"' in used}
        source = {
            "name": "repeated",
            "seed": seed,
            "duration": float(STEPS * DT),
            "spec": {"dt": float(DT), "pi2": 0.5},
            "grid": [grid],
            "at": [it.fields for it in blocks],
        }
        what = f"JOSTLE_SEED={base}, {seed}:\n{to_toml(source)}"
        experiment = client.submit(source).wait(MAX_WAIT_SECS)
        try:
            rows = experiment.rows()
            spec = {"n": n, "dt": float(DT), "pi2": 0.5}
            if not rows:
                # A command of step 0 is rejected: whatever the seed, this block is.
                assert experiment.progress().faulted == 1, what
                continue
            (row,) = rows
            found = by_hand(client, {**spec, "seed": row.seed}, informed, blocks)
            if row.fault is not None:
                assert found == row.steps, (what, row.fault)
                continue
            assert (row.state_hash, row.steps) == (found, STEPS), what
            # A third way: the daemon schedules the commands of the run.
            played = client.play(source, name="played")
            played.step(STEPS)
            assert played.status().state_hash == found, what
            played.delete()
        finally:
            experiment.delete()
        hashes += 1
        executed += sum(len(it.executions) for it in blocks)
        repeats += sum(len(it.executions) > 1 for it in blocks)
        drawn += any(it.draw is not None for it in blocks)
        alone += all(it.draw is None for it in blocks)
    counts = (hashes, executed, repeats, drawn, alone)
    assert hashes >= 5, counts
    assert executed > 60, counts
    assert repeats >= 6, counts
