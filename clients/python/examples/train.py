"""Trains a shepherd, and holds it against the policy that always says the same.

    JOSTLED=../../../target/release/jostled python train.py --figure train.svg

Three of thirty can be told where to go at a time. The constant policy informs those at one place
in the group, and always of the goal; it gets the best place and the best weight of a grid. The
policy that is trained gives each cell of what is seen from above a score, a weighted sum of what
is seen there, informs those in the cell of the highest, and leans against where the group goes
astray. Its seven numbers are found by the cross-entropy method: draw some about a mean, keep the
best quarter, and go on from those. All policies of a generation meet the same seeds, and the two
are compared on seeds that neither has met. A third policy informs whoever is at a place drawn anew
each time of the goal, to show what changing alone is worth.

Everything is drawn from seeds, so that the figures are the same every time.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import jostle
from jostle.env import ShepherdEnv

Floats = NDArray[np.float64]

# Where the cells are: -0.8 to 0.8, ahead and to the left, in units of half the square's side.
AHEAD, LEFT = np.meshgrid(np.linspace(-0.8, 0.8, 5), np.linspace(-0.8, 0.8, 5))
NAMES = ("heading along", "heading across", "share", "ahead", "aside", "along", "against")


@dataclass(frozen=True)
class Plan:
    """How much is done."""

    n: int = 30
    informed: int = 3
    max_steps: int = 100
    generations: int = 8
    population: int = 16
    seeds: int = 4
    constant_seeds: int = 32
    held_out: int = 64


QUICK = Plan(10, 2, 8, generations=2, population=4, seeds=2, constant_seeds=4, held_out=4)


@dataclass(frozen=True)
class Constant:
    """Informs those at one place of the goal, with one weight."""

    ahead: float
    weight: float

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Always the same."""
        return np.array([self.ahead, 0.0, self.weight, 0.0])


@dataclass(frozen=True)
class Anywhere:
    """Informs those at a place drawn anew each time of the goal, with all weight."""

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Looks at nothing."""
        return np.array([*draws.uniform(-0.8, 0.8, 2), 1.0, 0.0])


@dataclass(frozen=True)
class Scores:
    """Informs those in the cell of the highest score; left and right are the same to it."""

    numbers: Floats

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Looks at each cell, and at where the group goes."""
        share, along, across = observation[7:].reshape(5, 5, 3).transpose(2, 0, 1).astype(float)
        seen = (along, np.abs(across), 5.0 * share, AHEAD, np.abs(LEFT))
        score = np.tensordot(self.numbers[:5], np.array(seen), 1)
        best = np.argmax(np.where(share > 0.0, score, -np.inf))
        forward, against = self.numbers[5:]
        return np.array([AHEAD.flat[best], LEFT.flat[best], forward, -against * observation[1]])


Policy = Constant | Anywhere | Scores
Measure = Callable[[Iterable[Policy], range], Floats]

_env: ShepherdEnv


def begin(endpoint: str, plan: Plan) -> None:
    """Makes this process's environment, on the daemon of all."""
    global _env
    _env = ShepherdEnv(
        plan.n,
        plan.informed,
        max_weight=4.0,
        steps_per_action=10,
        max_steps=plan.max_steps,
        endpoint=endpoint,
        dt=0.05,
    )


def drift(policy: Policy, seed: int) -> float:
    """The drift of an episode."""
    observation, info = _env.reset(seed=seed)
    draws = np.random.default_rng(seed)
    is_over = False
    while not is_over:
        observation, _, _, is_over, info = _env.step(policy.act(observation, draws))
    return float(info["drift"])


def best_constant(measure: Measure, plan: Plan) -> tuple[Constant, float]:
    """The best place and weight of a grid; the four that come out best are looked at again."""
    grid = [Constant(a, w) for a in (-0.8, -0.4, 0.0, 0.4, 0.8) for w in (0.25, 0.5, 1.0)]
    few = measure(grid, range(plan.constant_seeds // 4)).mean(axis=1)
    those = [grid[index] for index in np.argsort(-few)[:4]]
    again = measure(those, range(plan.constant_seeds)).mean(axis=1)
    return those[int(again.argmax())], float(again.max())


def train(measure: Measure, plan: Plan, draws: np.random.Generator) -> tuple[Scores, list[Floats]]:
    """The mean of the last generation, and the drifts of each generation's policies."""
    # To begin with every cell is as good as any other.
    mean, spread = np.array([0.0] * 5 + [0.5, 0.0]), np.ones(len(NAMES))
    curve = []
    for generation in range(plan.generations):
        numbers = mean + spread * draws.standard_normal((plan.population, len(mean)))
        first = 1000 + generation * plan.seeds
        drifts = measure(map(Scores, numbers), range(first, first + plan.seeds)).mean(axis=1)
        best = numbers[np.argsort(-drifts)[: plan.population // 4]]
        # It does not narrow as fast as the few would have it.
        mean, spread = best.mean(axis=0), 0.6 * best.std(axis=0) + 0.3 * spread
        curve.append(drifts)
        print(f"generation {generation + 1}: drift {drifts.mean():+.3f}, best {drifts.max():+.3f}")
    return Scores(mean), curve


def draw(
    path: Path, plan: Plan, constant: float, curve: list[Floats], held_out: dict[str, Floats]
) -> None:
    """Draws how it learned, and how the policies fare on the seeds held out."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    generations = np.arange(1, len(curve) + 1)
    for generation, drifts in zip(generations, curve, strict=True):
        left.plot(np.full(len(drifts), generation), drifts, ".", color="#8fb3d1", ms=5)
    left.plot(generations, [it.mean() for it in curve], color="#2f5474", label="mean of all drawn")
    left.axhline(constant, color="#d9711a", ls="--", label="best constant policy")
    left.set(xlabel="generation", ylabel="drift, free speeds", xticks=generations)
    left.set_title(f"training: {plan.informed} of {plan.n} told at a time", fontsize=10)
    left.legend(frameon=False, loc="lower right")
    pairs = np.array(list(held_out.values()))
    right.plot(range(len(pairs)), pairs, color="#bbbbbb", lw=0.5, zorder=0)
    for place, drifts in enumerate(pairs):
        right.plot(np.full(len(drifts), place), drifts, ".", color="#8fb3d1", ms=4)
        bars = right.errorbar(
            place + 0.1, drifts.mean(), error(drifts), fmt="o", color="#2f5474", capsize=4, zorder=3
        )
        right.annotate(
            f"{drifts.mean():.2f}", (place + 0.1, drifts.mean()), (8, -4), color="#2f5474",
            textcoords="offset points",
        )  # fmt: skip
    bars.set_label("mean and its standard error")
    right.set(xticks=range(len(pairs)), xticklabels=held_out, xlim=(-0.3, len(pairs) - 0.5))
    right.set_title(f"{pairs.shape[1]} held-out seeds, a line each", fontsize=10)
    right.legend(frameon=False, loc="lower right")
    with matplotlib.rc_context({"svg.hashsalt": "train"}):
        # The same figures are the same file.
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else {})


def error(numbers: Floats) -> float:
    """The standard error of the mean."""
    return float(numbers.std(ddof=1) / np.sqrt(len(numbers)))


def told(gained: Floats) -> str:
    """A gain, pair by pair."""
    return (
        f"{gained.mean():+.3f} ± {error(gained):.3f} better, on {np.sum(gained > 0.0)} of "
        f"{len(gained)}"
    )


def main() -> None:
    """Trains, compares and draws."""
    parser = argparse.ArgumentParser(description="Trains a shepherd; a few minutes on two cores.")
    parser.add_argument("--quick", action="store_true", help="all of it, too little to learn")
    parser.add_argument("--figure", type=Path, help="a file to draw it into, such as train.svg")
    parser.add_argument("--seed", type=int, default=1, help="of what the training draws")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    plan = QUICK if args.quick else Plan()
    began = time.monotonic()
    with (
        jostle.local() as daemon,
        ProcessPoolExecutor(
            args.processes,
            # No connection survives a fork.
            mp_context=multiprocessing.get_context("spawn"),
            initializer=begin,
            initargs=(daemon.endpoint, plan),
        ) as pool,
    ):

        def measure(policies: Iterable[Policy], seeds: range) -> Floats:
            pairs = [(policy, seed) for policy in policies for seed in seeds]
            drifts = list(pool.map(drift, *zip(*pairs, strict=True), chunksize=2))
            return np.array(drifts).reshape(-1, len(seeds))

        constant, its_drift = best_constant(measure, plan)
        print(f"best constant policy: {constant}, drift {its_drift:+.3f}")
        learned, curve = train(measure, plan, np.random.default_rng(args.seed))
        for name, number in zip(NAMES, learned.numbers, strict=True):
            print(f"  {name:14} {number:+.2f}")
        seeds = range(100_000, 100_000 + plan.held_out)
        drifts = measure([constant, Anywhere(), learned], seeds)
    held_out = dict(zip(("constant", "anywhere", "learned"), drifts, strict=True))
    for name, those in held_out.items():
        gained = held_out["learned"] - those
        print(
            f"{name}: drift {those.mean():+.3f} ± {error(those):.3f}"
            + ("" if name == "learned" else f"; learned is {told(gained)} held-out seeds")
        )
    print(f"{time.monotonic() - began:.0f} s")
    if args.figure is not None:
        draw(args.figure, plan, its_drift, curve, held_out)


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error_of_jostle:
        raise SystemExit(f"{type(error_of_jostle).__name__}: {error_of_jostle}") from None
