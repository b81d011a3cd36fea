"""Mutants of src/swerve/simulation."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "count one step too many (the start state twice)",
        "simulation/trajectory.py",
        "carry.length + active,",
        "carry.length + active + (step == 0),",
        "simulation/test_trajectory",
    ),
    Mutant(
        "ignore early termination",
        "simulation/trajectory.py",
        "ended = mdp.terminated(next_state, goal) | (step == mdp.num_steps - 1)",
        "ended = step == mdp.num_steps - 1",
        "simulation/test_trajectory",
    ),
    Mutant(
        "pay the terminal reward at the horizon alone",
        "simulation/trajectory.py",
        "jnp.where(ended, mdp.terminal_reward(next_state, goal), 0.0)",
        "jnp.where(step == mdp.num_steps - 1, mdp.terminal_reward(next_state, goal), 0.0)",
        "simulation/test_trajectory",
    ),
    Mutant(
        "forget the base measure in soft values",
        "simulation/policies.py",
        'math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0',
        "0.0",
        "solvers/grid/test_grid -k soft_value",
    ),
    Mutant(
        "look ahead past the end of an episode",
        "simulation/policies.py",
        "ahead = jnp.where(taken.ended, 0.0, self.value(taken.state, step + 1, goal))",
        "ahead = self.value(taken.state, step + 1, goal)",
        "solvers/grid/test_grid -k early_termination",
    ),
    Mutant(
        "look ahead with the problem's beta whatever beta is asked for",
        "simulation/policies.py",
        "self.beta * reward + ahead",
        "problem.beta * reward + ahead",
        "solvers/trained/test_soft_value -k span",
    ),
    Mutant(
        "let trajectories through known constraints",
        "simulation/trajectory.py",
        "return Step(next_state, jnp.where(forbidden, -jnp.inf, reward), ended | forbidden)",
        "return Step(next_state, reward, ended)",
        "simulation/test_trajectory",
    ),
    Mutant(
        "sample the action before the one that the uniform number falls on",
        "simulation/trajectory.py",
        "uniform * cumulative[-1] >= cumulative[:-1], dtype",
        "uniform * cumulative[-1] >= cumulative[1:], dtype",
        "simulation/test_trajectory",
    ),
    Mutant(
        "learn from a coarse policy without its weights",
        "simulation/continuation.py",
        "return Continuation(states, left - values)",
        "return Continuation(states, 0.0 * left)",
        "monitoring/test_foresight -k coarse",
    ),
)
