"""Swerve infers which constraint a demonstrator is obeying.

    Problem --learn--> Nominal --sample--> Evidence --infer(demonstrations)--> Inference

The public names below are bound on first use, so that `import swerve` is quick and inference from
stored evidence never imports JAX.
"""

from swerve.base import imports  # first: what is imported after it is what is installed
from swerve.base.version import VERSION

__version__ = VERSION
TYPE_CHECKING = False  # as typing's, whose import would cost a third of ours

if TYPE_CHECKING:
    from swerve.answer import Inference, infer
    from swerve.base.space import StateSpace, Task
    from swerve.constraints.base import Constraint, Union
    from swerve.constraints.boxes import ActionBox, Box
    from swerve.constraints.occupancy import Occupancy
    from swerve.constraints.polygons import Polygon
    from swerve.constraints.predicate import Predicate
    from swerve.constraints.shapes import Ball, HalfSpace
    from swerve.constraints.state_action import StateAction
    from swerve.demonstrations.demonstration import (
        Demonstration,
        read_demonstrations,
        read_tasks,
        write_demonstrations,
    )
    from swerve.demonstrators.boltzmann import demonstrate
    from swerve.demonstrators.optimal_control import Optimum, optimal_control
    from swerve.evidence.estimators import hoeffding_error, hoeffding_sample_size
    from swerve.evidence.evidence import Evidence
    from swerve.fitting.beta import BetaFit, fit_beta
    from swerve.fitting.rewards import divergence
    from swerve.hypotheses.base import HypothesisSet
    from swerve.hypotheses.grid import grid
    from swerve.hypotheses.windows import windows
    from swerve.inference.greedy import Pick, Picks, greedy
    from swerve.inference.pairs import Pair, best_pair
    from swerve.monitoring.course import Course, follow
    from swerve.monitoring.foresee import Rollouts, foresee
    from swerve.monitoring.foresight import Foresight
    from swerve.monitoring.monitor import Monitor
    from swerve.presentation.course_plots import animate_course, plot_course
    from swerve.presentation.plots import plot_contributions, plot_posterior
    from swerve.problem.loading import load_problem
    from swerve.problem.mdp import MDP, rk4
    from swerve.problem.problem import Problem
    from swerve.problem.tasks import draw_tasks
    from swerve.sampling.resolve import resolve
    from swerve.sampling.sample import sample
    from swerve.solvers.base import Nominal
    from swerve.solvers.exact.discrete import Discrete
    from swerve.solvers.exact.enumeration import Enumeration
    from swerve.solvers.exact.soft_paths import SoftPaths
    from swerve.solvers.exact.tabular import Tabular
    from swerve.solvers.grid.grid import Grid
    from swerve.solvers.learn import learn, load_nominal, save_nominal
    from swerve.solvers.trained.distilled import Distilled
    from swerve.solvers.trained.ppo import PPO
    from swerve.solvers.trained.soft_value import SoftValue
    from swerve.systems.car import Car
    from swerve.systems.double_pendulum import DoublePendulum
    from swerve.systems.gridworld import Gridworld
    from swerve.systems.pendulum import Pendulum
    from swerve.systems.tabular import TabularMDP, tabular
    from swerve.systems.walker import Walker


_HOMES = {
    "ActionBox": "constraints.boxes",
    "Ball": "constraints.shapes",
    "BetaFit": "fitting.beta",
    "Box": "constraints.boxes",
    "Car": "systems.car",
    "Constraint": "constraints.base",
    "Course": "monitoring.course",
    "Demonstration": "demonstrations.demonstration",
    "Discrete": "solvers.exact.discrete",
    "Distilled": "solvers.trained.distilled",
    "DoublePendulum": "systems.double_pendulum",
    "Enumeration": "solvers.exact.enumeration",
    "Evidence": "evidence.evidence",
    "Foresight": "monitoring.foresight",
    "Grid": "solvers.grid.grid",
    "Gridworld": "systems.gridworld",
    "HalfSpace": "constraints.shapes",
    "HypothesisSet": "hypotheses.base",
    "Inference": "answer",
    "MDP": "problem.mdp",
    "Monitor": "monitoring.monitor",
    "Nominal": "solvers.base",
    "Occupancy": "constraints.occupancy",
    "Optimum": "demonstrators.optimal_control",
    "PPO": "solvers.trained.ppo",
    "Pair": "inference.pairs",
    "Pick": "inference.greedy",
    "Picks": "inference.greedy",
    "Polygon": "constraints.polygons",
    "Pendulum": "systems.pendulum",
    "Predicate": "constraints.predicate",
    "Problem": "problem.problem",
    "SoftPaths": "solvers.exact.soft_paths",
    "Rollouts": "monitoring.foresee",
    "SoftValue": "solvers.trained.soft_value",
    "StateAction": "constraints.state_action",
    "StateSpace": "base.space",
    "Tabular": "solvers.exact.tabular",
    "TabularMDP": "systems.tabular",
    "Task": "base.space",
    "Union": "constraints.base",
    "Walker": "systems.walker",
    "best_pair": "inference.pairs",
    "animate_course": "presentation.course_plots",
    "demonstrate": "demonstrators.boltzmann",
    "optimal_control": "demonstrators.optimal_control",
    "divergence": "fitting.rewards",
    "draw_tasks": "problem.tasks",
    "fit_beta": "fitting.beta",
    "follow": "monitoring.course",
    "foresee": "monitoring.foresee",
    "greedy": "inference.greedy",
    "grid": "hypotheses.grid",
    "hoeffding_error": "evidence.estimators",
    "hoeffding_sample_size": "evidence.estimators",
    "infer": "answer",
    "learn": "solvers.learn",
    "load_nominal": "solvers.learn",
    "load_problem": "problem.loading",
    "read_demonstrations": "demonstrations.demonstration",
    "read_tasks": "demonstrations.demonstration",
    "plot_contributions": "presentation.plots",
    "plot_course": "presentation.course_plots",
    "plot_posterior": "presentation.plots",
    "rk4": "problem.mdp",
    "resolve": "sampling.resolve",
    "sample": "sampling.sample",
    "tabular": "systems.tabular",
    "save_nominal": "solvers.learn",
    "windows": "hypotheses.windows",
    "write_demonstrations": "demonstrations.demonstration",
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
    "Picks",
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
