"""Simulation: running a policy."""
