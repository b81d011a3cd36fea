"""The packages in the order of their imports, and which of them may import JAX."""

from __future__ import annotations

ROOMS = (
    "base",
    "constraints",
    "demonstrations",
    "hypotheses",
    "problem",
    "systems",
    "simulation",
    "evidence",
    "inference",
    "trust",
    "solvers",
    "sampling",
    "fitting",
    "demonstrators",
    "monitoring",
    "presentation",
    "work",
    "answer",
    "reproduce",
    "cli",
    "swerve",  # the public names: `swerve/__init__.py`
)
WITH_JAX = (  # what may import JAX at module level: packages and modules
    "problem.boundary",
    "problem.mdp",
    "problem.problem",
    "problem.repeatable",
    "problem.tasks",
    "systems",
    "simulation",
    "solvers",
    "sampling",
    "fitting",
    "demonstrators",
    "monitoring.foresee",
    "reproduce",
)
