"""Measures DAQP or PIQP on programs of the bench: outsiders.py daqp|piqp programs.json

The programs are converted to the solver's form beforehand. A pass calls the solver once for each of
them from Python, as a user would: the time includes the wheel's overhead and the set-up. The
quickest of several passes counts, in the thread's CPU time. With y = W^(1/2) (d - u) every program
is: minimise |y|² / 2 subject to rows y + slack >= 0.
"""

import json
import sys
import time

import numpy as np
import scipy.sparse as sparse

PASSES = 7


def rows_of(program):
    """Returns the rows in the metric of W as a sparse matrix, and the slacks of free motion."""
    free = np.array(program["free"])
    i, j = np.array(program["i"], int), np.array(program["j"], int)
    normal = np.array(program["normal"]).reshape(-1, 2)
    lever = np.array(program["lever"]).reshape(-1, 2)
    parts_i = np.column_stack([-normal, -lever[:, 0]])
    parts_j = np.column_stack([normal, lever[:, 1]])
    slack = program["gap"] + np.sum(parts_i * free[i] + parts_j * free[j], axis=1)
    count, scale = len(i), np.sqrt(program["weights"])
    columns = [3 * index[:, None] + np.arange(3) for index in (i, j)]
    entries = np.concatenate([(parts / scale).ravel() for parts in (parts_i, parts_j)])
    row = np.repeat(np.arange(count), 3)
    indices = (np.concatenate([row, row]), np.concatenate([c.ravel() for c in columns]))
    rows = sparse.csc_matrix((entries, indices), shape=(count, free.size))
    rows.eliminate_zeros()
    return rows, slack


def daqp_calls(programs):
    import daqp

    for program in programs:
        rows, slack = rows_of(program)
        count, size = rows.shape
        # The lower bounds are -slack; 1e30 is no upper bound.
        arguments = (
            np.eye(size),
            np.zeros(size),
            np.ascontiguousarray(rows.toarray()),
            np.full(count, 1e30),
            -slack,
        )
        # Warm start from the multipliers guessed from the step before. In DAQP the multipliers of
        # lower bounds are negative.
        guess = -np.array(program["guess"])

        def call(arguments=arguments, guess=guess):
            _, _, flag, info = daqp.solve(*arguments, dual_start=guess)
            return flag == 1, -np.array(info["lam"]), info["iterations"]

        yield call


def piqp_calls(programs):
    import piqp

    for program in programs:
        rows, slack = rows_of(program)
        size = rows.shape[1]
        weights, linear = sparse.identity(size, format="csc"), np.zeros(size)

        def call(weights=weights, linear=linear, rows=rows, slack=slack):
            solver = piqp.SparseSolver()
            solver.setup(weights, linear, G=rows, h_l=-slack)
            status = solver.solve()
            result = solver.result
            return status == piqp.PIQP_SOLVED, np.array(result.z_l), result.info.iter

        yield call


def main():
    module, path = sys.argv[1:]
    with open(path, encoding="utf-8") as file:
        programs = json.load(file)
    calls = list({"daqp": daqp_calls, "piqp": piqp_calls}[module](programs))
    best = float("inf")
    for _ in range(PASSES):
        began = time.thread_time()
        answers = [call() for call in calls]
        best = min(best, time.thread_time() - began)
    report = {
        "microseconds": 1e6 * best / len(calls),
        "iterations": float(np.mean([iterations for _, _, iterations in answers])),
        "solved": sum(solved for solved, _, _ in answers),
        "multipliers": [np.maximum(values, 0.0).tolist() for _, values, _ in answers],
    }
    print(json.dumps(report))


main()
