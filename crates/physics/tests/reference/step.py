"""One step of the model, slow and dense, written from the model's description alone.

A step takes a specification and a state, dictionaries with the keys of the cases' `spec` and
`before`. No data are kept between two steps.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import quadprog

import attraction
import stream
from contacts import Body, Contact, crossed_pairs, find_contacts

# Twice the reach of the exact cases. `_solve_about` doubles the reach until no contact beyond it
# could constrain the solution.
REACH_IN_STEPS = 6.0
# Rounding in the optimality conditions after the polish; lengths are of order one.
KKT_TOLERANCE = 1e-12


class CrossedBodies(Exception):
    """Two axes cross under `endpoints`; no contact would push them apart."""


@dataclass(frozen=True)
class Solution:
    """Result of a step: free motion, contacts and rows of its last QP, and the configuration.

    `free` and `configuration` have n rows of three; `rows` has 3 n columns and, like `slacks` and
    `multipliers`, an entry for each contact.
    """

    free: np.ndarray
    contacts: list[Contact]
    slacks: np.ndarray
    multipliers: np.ndarray
    rows: np.ndarray
    configuration: np.ndarray


def advance(spec: dict[str, Any], state: dict[str, Any], seed: int, step: int) -> Solution:
    """Advances a state by one step.

    Source: paper, Principle 1, eq. (7), and the appendix. `relinearise` solves a second QP with the
    same objective, linearised about the configuration after the first one.
    """
    body = Body.of_aspect_ratio(spec["pi1"])
    before = configuration_of(state)
    free = free_motion(spec, state, seed, step)
    solution = _solve_about(spec, body, state, before, free, np.zeros_like(free))
    if spec["relinearise"]:
        if spec["stepping"] != "position":
            raise ValueError("relinearise requires position stepping")
        predicted = solution.configuration - before
        solution = _solve_about(spec, body, state, before, free, predicted)
    return solution


def configuration_of(state: dict[str, Any]) -> np.ndarray:
    """Returns n rows (x, y, alpha)."""
    return np.array([state["x"], state["y"], state["alpha"]], dtype=float).T.reshape(-1, 3)


def free_motion(spec: dict[str, Any], state: dict[str, Any], seed: int, step: int) -> np.ndarray:
    """Returns the free motion, eqs. (1) to (4), with noise: n rows (dx, dy, dalpha)."""
    c_s, dt = spec["pi3"], spec["dt"]
    ids = ids_of(state)
    social = attraction.pulls(spec["attraction"], ids, state["x"], state["y"])
    free = np.zeros((len(ids), 3))
    for i, alpha in enumerate(state["alpha"]):
        heading = np.array([math.cos(alpha), math.sin(alpha)])
        direction = np.array([math.cos(state["direction"][i]), math.sin(state["direction"][i])])
        pull = c_s * (state["weight"][i] * direction + social[i])
        free[i, :2] = dt * heading
        free[i, 2] = dt * (-heading[1] * pull[0] + heading[0] * pull[1])
        if spec["noise"] > 0.0:
            xi = stream.standard_normal(seed, step, ids[i])
            free[i, 2] += math.sqrt(2.0 * spec["noise"] * dt) * xi
    return free


def ids_of(state: dict[str, Any]) -> list[int]:
    """Returns the ids of the state; without ids, 0 to n - 1."""
    return state.get("id", list(range(len(state["x"]))))


def weights_of(spec: dict[str, Any], count: int) -> np.ndarray:
    """Returns the diagonal of W, 3 n numbers; s = rho1 = 1, so rho2 = 1 / pi4."""
    return np.tile([1.0, 1.0, 1.0 / spec["pi4"]], count)


def _solve_about(
    spec: dict[str, Any],
    body: Body,
    state: dict[str, Any],
    before: np.ndarray,
    free: np.ndarray,
    predicted: np.ndarray,
) -> Solution:
    """Solves the QP with contacts linearised about `before + predicted`."""
    about = before + predicted
    if spec["contacts"] == "endpoints" and crossed_pairs(body, about):
        raise CrossedBodies(crossed_pairs(body, about))
    omega = spec["pi3"] * (1.0 + max(state["weight"], default=0.0))
    reach = REACH_IN_STEPS * spec["dt"] * (1.0 + body.half_length * omega)
    while True:
        contacts = find_contacts(spec["contacts"], body, about, reach)
        if spec["stepping"] == "velocity":
            contacts = [contact for contact in contacts if contact.gap <= 0.0]
        elif spec["stepping"] != "position":
            raise ValueError(f"unknown stepping {spec['stepping']!r}")
        rows = np.array([contact.row(len(before)) for contact in contacts]).reshape(-1, before.size)
        gaps = np.array([contact.gap for contact in contacts])
        if spec["stepping"] == "velocity":
            gaps = np.zeros_like(gaps)
        offsets = gaps - rows @ predicted.ravel()
        displacement, multipliers = solve_qp(
            weights_of(spec, len(before)), free.ravel(), rows, offsets
        )
        moved = displacement.reshape(-1, 3)
        if _closable(body, moved - predicted) <= reach:
            slacks = rows @ displacement + offsets
            return Solution(free, contacts, slacks, multipliers, rows, before + moved)
        reach *= 2.0


def _closable(body: Body, moved: np.ndarray) -> float:
    """Bounds the decrease of a linearised gap by `moved`: no lever exceeds the half-length."""
    each = np.hypot(moved[:, 0], moved[:, 1]) + body.half_length * np.abs(moved[:, 2])
    return 2.0 * float(each.max(initial=0.0))


def solve_qp(
    weights: np.ndarray, free: np.ndarray, rows: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Minimises 1/2 (d - u)' W (d - u) subject to rows d + offsets >= 0.

    Returns d (3 n numbers) and a multiplier for each row. Raises ArithmeticError if the residual
    of the optimality conditions exceeds KKT_TOLERANCE.
    """
    if len(rows) == 0:
        return free, np.zeros(0)
    # In units in which W is the identity the problem is well scaled.
    scale = np.sqrt(weights)
    scaled_rows = rows / scale
    result = quadprog.solve_qp(np.eye(len(free)), scale * free, scaled_rows.T, -offsets)
    multipliers = _polish(scaled_rows, rows @ free + offsets, result[4] > 0.0)
    displacement = free + (rows.T @ multipliers) / weights
    residual = np.abs(np.minimum(multipliers, rows @ displacement + offsets)).max()
    if residual > KKT_TOLERANCE:
        raise ArithmeticError(f"the residual of the optimality conditions is {residual}")
    return displacement, multipliers


def _polish(scaled_rows: np.ndarray, free_slacks: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Solves with the active contacts as equations, and refines once."""
    multipliers = np.zeros(len(free_slacks))
    if active.any():
        held = scaled_rows[active]
        matrix = held @ held.T
        solved = np.linalg.solve(matrix, -free_slacks[active])
        solved -= np.linalg.solve(matrix, matrix @ solved + free_slacks[active])
        multipliers[active] = solved
    return multipliers
