"""What `tests/mutants/run` is made of."""
