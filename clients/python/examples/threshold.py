"""How many informed individuals lead a group of forty: a search with Optuna.

    pip install 'jostle[search]'
    python threshold.py FOLDER

It finds the number of informed individuals at which the group drifts along their direction at half
the free speed, and plots what it has evaluated. Everything is stored in FOLDER: if the search is
killed, the same command resumes it, and no experiment is executed twice.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import optuna

import jostle

HALF = 0.5
EXPERIMENT = {
    "name": "threshold",
    "seed": 1,
    "replicates": 8,
    "duration": 200,
    "spec": {"n": 40, "pi1": 4.0},
}


def search(folder: Path, trials: int) -> optuna.Study:
    """Evaluates trials until `trials` of them are complete."""
    folder.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{folder}/study.db",
        study_name="threshold",
        load_if_exists=True,
    )
    # A resumed search with the same seed would suggest the same values again.
    study.sampler = optuna.samplers.TPESampler(seed=len(study.trials))
    objective = jostle.Objective(EXPERIMENT, "v_pd", folder=folder / "experiments")
    complete = (optuna.trial.TrialState.COMPLETE,)
    while len(study.get_trials(states=complete)) < trials:
        trial = study.ask()
        informed = trial.suggest_int("informed", 1, 20)
        drift = objective(informed=informed)
        trial.set_user_attr("drift", drift)
        study.tell(trial, abs(drift - HALF))
        print(f"{informed:2} informed: drift {drift:.3f}", flush=True)
    return study


def draw(study: optuna.Study, file: Path) -> None:
    """Plots the drift against the number of informed individuals."""
    done = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    drifts = {trial.params["informed"]: trial.user_attrs["drift"] for trial in done}
    best = study.best_params["informed"]
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    axes.axhline(HALF, color="0.6", linewidth=1)
    axes.plot(*zip(*sorted(drifts.items()), strict=True), "o", color="tab:blue", label="evaluated")
    axes.plot(best, drifts[best], "o", color="tab:red", label=f"nearest to {HALF}: {best}")
    axes.set_xlabel("informed individuals of 40")
    axes.set_ylabel("mean drift / free speed")
    axes.set_xlim(0, 21)
    axes.set_xticks(range(0, 21, 2))
    axes.set_ylim(-0.1, 1)
    axes.legend(loc="lower right", frameon=False)
    figure.savefig(file, metadata={"Date": None})


def main() -> None:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of the study, the results and the plot")
    parser.add_argument("--trials", type=int, default=16, help="number of trials [16]")
    arguments = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = search(arguments.folder, arguments.trials)
    file = arguments.folder / "threshold.svg"
    draw(study, file)
    best = study.best_params["informed"]
    print(f"drift is closest to {HALF} with {best} informed individuals; plot: {file}")


if __name__ == "__main__":
    main()
