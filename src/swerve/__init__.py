"""Swerve infers which constraint a demonstrator is obeying.

    Problem --learn--> Nominal --sample--> Evidence --infer(demonstrations)--> Inference

The public names below are bound on first use, so that `import swerve` is quick and inference from
stored evidence never imports JAX.
"""

TYPE_CHECKING = False  # as typing's, whose import would cost a third of ours

if TYPE_CHECKING:
    from swerve.belief_plots import plot_contributions
    from swerve.boxes import ActionBox, Box
    from swerve.constraints import Constraint, Predicate, Union
    from swerve.course import Course, follow
    from swerve.course_plots import animate_course, plot_course
    from swerve.demonstrations import (
        Demonstration,
        read_demonstrations,
        read_tasks,
        write_demonstrations,
    )
    from swerve.demonstrators.boltzmann import demonstrate
    from swerve.demonstrators.optimal_control import Optimum, optimal_control
    from swerve.estimators import hoeffding_error, hoeffding_sample_size
    from swerve.evidence import Evidence
    from swerve.foresight import Foresight
    from swerve.foresight_training import Rollouts, foresee
    from swerve.grids import grid
    from swerve.hypotheses import HypothesisSet
    from swerve.inference import Inference, infer
    from swerve.mdp import MDP, rk4
    from swerve.monitor import Monitor
    from swerve.nominal import Nominal, learn, load_nominal, save_nominal
    from swerve.occupancy import Occupancy
    from swerve.pairs import Pair, best_pair
    from swerve.plots import plot_posterior
    from swerve.problem import Problem
    from swerve.resolving import resolve
    from swerve.rewards import divergence
    from swerve.sampling import sample
    from swerve.selection import Pick, greedy
    from swerve.shapes import Ball, HalfSpace, Polygon
    from swerve.sliding import windows
    from swerve.solvers.discrete import Discrete
    from swerve.solvers.distilled import Distilled
    from swerve.solvers.enumeration import Enumeration
    from swerve.solvers.grid import Grid
    from swerve.solvers.ppo import PPO
    from swerve.solvers.soft_paths import SoftPaths
    from swerve.solvers.soft_value import SoftValue
    from swerve.solvers.tabular import Tabular
    from swerve.space import StateSpace, Task
    from swerve.specification import load_problem
    from swerve.state_action import StateAction
    from swerve.systems.car import Car
    from swerve.systems.double_pendulum import DoublePendulum
    from swerve.systems.gridworld import Gridworld
    from swerve.systems.pendulum import Pendulum
    from swerve.systems.tabular import TabularMDP, tabular
    from swerve.systems.walker import Walker
    from swerve.tasks import draw_tasks
    from swerve.temperature import BetaFit, fit_beta

__version__ = "0.1.0"

_HOMES = {
    "ActionBox": "boxes",
    "Ball": "shapes",
    "BetaFit": "temperature",
    "Box": "boxes",
    "Car": "systems.car",
    "Constraint": "constraints",
    "Course": "course",
    "Demonstration": "demonstrations",
    "Discrete": "solvers.discrete",
    "Distilled": "solvers.distilled",
    "DoublePendulum": "systems.double_pendulum",
    "Enumeration": "solvers.enumeration",
    "Evidence": "evidence",
    "Foresight": "foresight",
    "Grid": "solvers.grid",
    "Gridworld": "systems.gridworld",
    "HalfSpace": "shapes",
    "HypothesisSet": "hypotheses",
    "Inference": "inference",
    "MDP": "mdp",
    "Monitor": "monitor",
    "Nominal": "nominal",
    "Occupancy": "occupancy",
    "Optimum": "demonstrators.optimal_control",
    "PPO": "solvers.ppo",
    "Pair": "pairs",
    "Pick": "selection",
    "Polygon": "shapes",
    "Pendulum": "systems.pendulum",
    "Predicate": "constraints",
    "Problem": "problem",
    "SoftPaths": "solvers.soft_paths",
    "Rollouts": "foresight_training",
    "SoftValue": "solvers.soft_value",
    "StateAction": "state_action",
    "StateSpace": "space",
    "Tabular": "solvers.tabular",
    "TabularMDP": "systems.tabular",
    "Task": "space",
    "Union": "constraints",
    "Walker": "systems.walker",
    "best_pair": "pairs",
    "animate_course": "course_plots",
    "demonstrate": "demonstrators.boltzmann",
    "optimal_control": "demonstrators.optimal_control",
    "divergence": "rewards",
    "draw_tasks": "tasks",
    "fit_beta": "temperature",
    "follow": "course",
    "foresee": "foresight_training",
    "greedy": "selection",
    "grid": "grids",
    "hoeffding_error": "estimators",
    "hoeffding_sample_size": "estimators",
    "infer": "inference",
    "learn": "nominal",
    "load_nominal": "nominal",
    "load_problem": "specification",
    "read_demonstrations": "demonstrations",
    "read_tasks": "demonstrations",
    "plot_contributions": "belief_plots",
    "plot_course": "course_plots",
    "plot_posterior": "plots",
    "rk4": "mdp",
    "resolve": "resolving",
    "sample": "sampling",
    "tabular": "systems.tabular",
    "save_nominal": "nominal",
    "windows": "sliding",
    "write_demonstrations": "demonstrations",
}

__all__ = [
    "MDP",
    "PPO",
    "ActionBox",
    "Ball",
    "BetaFit",
    "Box",
    "Car",
    "Constraint",
    "Course",
    "Demonstration",
    "Discrete",
    "Distilled",
    "DoublePendulum",
    "Enumeration",
    "Evidence",
    "Foresight",
    "Grid",
    "Gridworld",
    "HalfSpace",
    "HypothesisSet",
    "Inference",
    "Monitor",
    "Nominal",
    "Occupancy",
    "Optimum",
    "Pair",
    "Pendulum",
    "Pick",
    "Polygon",
    "Predicate",
    "Problem",
    "Rollouts",
    "SoftPaths",
    "SoftValue",
    "StateAction",
    "StateSpace",
    "Tabular",
    "TabularMDP",
    "Task",
    "Union",
    "Walker",
    "animate_course",
    "best_pair",
    "demonstrate",
    "divergence",
    "draw_tasks",
    "fit_beta",
    "follow",
    "foresee",
    "greedy",
    "grid",
    "hoeffding_error",
    "hoeffding_sample_size",
    "infer",
    "learn",
    "load_nominal",
    "load_problem",
    "optimal_control",
    "plot_contributions",
    "plot_course",
    "plot_posterior",
    "read_demonstrations",
    "read_tasks",
    "resolve",
    "rk4",
    "sample",
    "save_nominal",
    "tabular",
    "windows",
    "write_demonstrations",
]


def __getattr__(name: str) -> object:
    """Import a public name's module on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'swerve' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(f"swerve.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
