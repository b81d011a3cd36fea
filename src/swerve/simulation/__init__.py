"""Simulation: running a policy, from the start of a task or on from any state."""
