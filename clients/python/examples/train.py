"""Trains a policy for `ShepherdEnv` and compares it with the best constant policy.

    JOSTLED=../../../target/release/jostled python train.py --figure train.svg

Three of thirty individuals are informed at a time. The constant policy informs those at one place
in the group, always of the goal; a grid search finds its best place and weight. The trained policy
gives each cell of the view from above a score, a weighted sum of the observation of the cell,
informs those in the cell with the highest score, and steers against the group's sideways drift.
The cross-entropy method finds its seven numbers: it draws policies about a mean, keeps the best
quarter, and repeats. All policies of a generation have the same seeds, and the comparison uses
held-out seeds. A third policy informs individuals at a random place of the goal, to measure the
effect of changing the place alone.

All draws are from seeds, so the results are reproducible.
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

# The centres of the cells, ahead and to the left, in units of half the square's side.
AHEAD, LEFT = np.meshgrid(np.linspace(-0.8, 0.8, 5), np.linspace(-0.8, 0.8, 5))
NAMES = ("heading along", "heading across", "share", "ahead", "aside", "along", "against")


@dataclass(frozen=True)
class Plan:
    """The size of the training."""

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
    """Informs those at a fixed place of the goal, with a fixed weight."""

    ahead: float
    weight: float

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Returns the same action for every observation."""
        return np.array([self.ahead, 0.0, self.weight, 0.0])


@dataclass(frozen=True)
class Anywhere:
    """Informs those at a random place of the goal, with full weight."""

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Returns a random place."""
        return np.array([*draws.uniform(-0.8, 0.8, 2), 1.0, 0.0])


@dataclass(frozen=True)
class Scores:
    """Informs those in the cell with the highest score; it is symmetric in left and right."""

    numbers: Floats

    def act(self, observation: NDArray[np.float32], draws: np.random.Generator) -> Floats:
        """Scores each cell."""
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
    """Creates the environment of this process, on the shared daemon."""
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
    """The drift of an episode with a policy."""
    observation, info = _env.reset(seed=seed)
    draws = np.random.default_rng(seed)
    is_over = False
    while not is_over:
        observation, _, _, is_over, info = _env.step(policy.act(observation, draws))
    return float(info["drift"])


def best_constant(measure: Measure, plan: Plan) -> tuple[Constant, float]:
    """The best place and weight of a grid; the best four are evaluated with more seeds."""
    grid = [Constant(a, w) for a in (-0.8, -0.4, 0.0, 0.4, 0.8) for w in (0.25, 0.5, 1.0)]
    few = measure(grid, range(plan.constant_seeds // 4)).mean(axis=1)
    those = [grid[index] for index in np.argsort(-few)[:4]]
    again = measure(those, range(plan.constant_seeds)).mean(axis=1)
    return those[int(again.argmax())], float(again.max())


def train(measure: Measure, plan: Plan, draws: np.random.Generator) -> tuple[Scores, list[Floats]]:
    """The mean policy of the last generation, and the drifts of each generation's policies."""
    # The first mean scores all cells equally.
    mean, spread = np.array([0.0] * 5 + [0.5, 0.0]), np.ones(len(NAMES))
    curve = []
    for generation in range(plan.generations):
        numbers = mean + spread * draws.standard_normal((plan.population, len(mean)))
        first = 1000 + generation * plan.seeds
        drifts = measure(map(Scores, numbers), range(first, first + plan.seeds)).mean(axis=1)
        best = numbers[np.argsort(-drifts)[: plan.population // 4]]
        # Smoothing keeps the spread of a small population from collapsing.
        mean, spread = best.mean(axis=0), 0.6 * best.std(axis=0) + 0.3 * spread
        curve.append(drifts)
        print(f"generation {generation + 1}: drift {drifts.mean():+.3f}, best {drifts.max():+.3f}")
    return Scores(mean), curve


def draw(
    path: Path, plan: Plan, constant: float, curve: list[Floats], held_out: dict[str, Floats]
) -> None:
    """Plots the training, and the drifts of the policies on the held-out seeds."""
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
        # Equal results give equal files.
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else {})


def error(numbers: Floats) -> float:
    """The standard error of the mean."""
    return float(numbers.std(ddof=1) / np.sqrt(len(numbers)))


def describe(gained: Floats) -> str:
    """The mean gain over paired seeds, as a text."""
    return (
        f"{gained.mean():+.3f} ± {error(gained):.3f} better, on {np.sum(gained > 0.0)} of "
        f"{len(gained)}"
    )


def main() -> None:
    """Trains, compares and plots."""
    parser = argparse.ArgumentParser(
        description="Trains a policy for ShepherdEnv; a few minutes on two cores."
    )
    parser.add_argument("--quick", action="store_true", help="a short test, too short to learn")
    parser.add_argument("--figure", type=Path, help="file of the plot, such as train.svg")
    parser.add_argument("--seed", type=int, default=1, help="seed of the training")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    plan = QUICK if args.quick else Plan()
    began = time.monotonic()
    with (
        jostle.local() as daemon,
        ProcessPoolExecutor(
            args.processes,
            # No connection survives a fork.
            mp_context=multiprocessing.get_context("forkserver"),
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
            + ("" if name == "learned" else f"; learned is {describe(gained)} held-out seeds")
        )
    print(f"{time.monotonic() - began:.0f} s")
    if args.figure is not None:
        draw(args.figure, plan, its_drift, curve, held_out)


if __name__ == "__main__":
    try:
        main()
    except jostle.JostleError as error_of_jostle:
        raise SystemExit(f"{type(error_of_jostle).__name__}: {error_of_jostle}") from None
