"""Mutants of src/swerve/constraints."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "judge the states alone where segments count",
        "constraints/base.py",
        "hit = constraint.crosses(starts, ends, space)",
        "hit = constraint.contains(ends, space)",
        "constraints/test_base",
    ),
    Mutant(
        "close the upper side of a box",
        "constraints/boxes.py",
        "(low <= value) & (value < high)\n        return inside\n\n    def crosses",
        "(low <= value) & (value <= high)\n        return inside\n\n    def crosses",
        "constraints/test_boxes",
    ),
    Mutant(
        "forbid actions everywhere, whatever the state they are begun in",
        "constraints/state_action.py",
        "return self.states.contains(states, space) & self.actions.forbids(actions)",
        "return self.actions.forbids(actions)",
        "constraints/test_state_action",
    ),
    Mutant(
        "look at a map at the two ends of a step alone",
        "constraints/occupancy.py",
        "for k in range(1, int(count)):",
        "for k in range(1, 1):",
        "systems/test_walker",
    ),
)
