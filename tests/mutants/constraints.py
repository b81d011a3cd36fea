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
        "constraints/edges.py",
        "return (values >= self._lows[0]) & (values < self._highs[0])",
        "return (values >= self._lows[0]) & (values <= self._highs[0])",
        "constraints/test_edges",
    ),
    Mutant(
        "leave the edges of a box where rounding decides",
        "constraints/edges.py",
        "return np.asarray(np.float32(np.asarray(edges) - blur(edges, resolution)))",
        "return np.asarray(np.float32(np.asarray(edges)))",
        "constraints/test_edges",
    ),
    Mutant(
        "enter a corner that is only touched",
        "constraints/edges.py",
        "deep = xp.minimum(wide(low + 2.0 * blur), high)",
        "deep = xp.minimum(wide(low), high)",
        "constraints/test_edges",
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
        "return hit | where_near(passes, has_between & ~hit, (*places[0], *places[1]), 1)",
        "return hit",
        "constraints/test_edges",
    ),
    Mutant(
        "let wide bounds move the edges of small regions",
        "constraints/edges.py",
        "return float(np.float32(min(resolution, SHARE * width)))",
        "return float(np.float32(resolution))",
        "constraints/test_edges",
    ),
    Mutant(
        "let a path along a line of the map through a wall",
        "constraints/occupancy.py",
        "low - xp.where(is_seam, 2.0 * self.blur, 0.0)",
        "low",
        "constraints/test_edges",
    ),
)
