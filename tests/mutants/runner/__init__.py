"""What `mutants/run` is made of."""
