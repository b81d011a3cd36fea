"""Solvers that train networks, and the run, checkpoints and picture of a training."""
