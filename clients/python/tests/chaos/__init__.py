"""A chaos test: a full load on one daemon, injected faults, and every guarantee judged at the end.

    PYTHONPATH=clients/python/tests target/venv/bin/python -m chaos --minutes 5

`plan` draws the load and the faults from a seed. `clients`, `controller_process` and `viewers`
produce the load on the daemon of `node`; `faults` injects faults; `observer` and `meter` sample
what the daemon reports; `shutdown` ends the load and reads the final state. `guarantees` judges it
with `replies`, `crashes`, `controllers`, `recordings` and `resources`, and `report` prints it.
"""
