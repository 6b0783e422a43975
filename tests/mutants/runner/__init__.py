"""The modules of `tests/mutants/run`."""
