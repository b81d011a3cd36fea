"""Define constraint inference problems: an MDP, hypotheses and a demonstrator's beta.

The nominal distribution of the problem is

    pi_0(xi) = m(xi) exp(beta R(xi)) / Z_0

over the trajectories that avoid the known constraints, with base measure m = 1 ("counting") or
m = A^-length ("uniform"). A hypothesis c restricts this distribution further:

    pi_c(xi) = m(xi) exp(beta R(xi)) 1[xi avoids c] / Z_c
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from swerve.base.arguments import positive_number
from swerve.base.pickling import PickledByFields
from swerve.constraints.base import Constraint, check_constraints
from swerve.constraints.boxes import ActionBox
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.problem.boundary import actions_of, plain_array
from swerve.problem.mdp import MDP, check_mdp
from swerve.problem.record import MEASURES, ProblemRecord, digest
from swerve.problem.repeatable import check_predicates, check_repeatable

NARROW = {"float64": "float32", "int64": "int32", "uint64": "uint32"}
OF_A_FILE = r"^(swerve_problem_.*)_[0-9a-f]{8}$"  # module of a user's file, with the path's hash


@dataclass(frozen=True, eq=False)
class Problem(PickledByFields):
    """An MDP, hypothesised constraints, and the assumptions about the demonstrator.

    Attributes:
      mdp: dynamics, reward, actions, horizon.
      hypotheses: the constraints to choose from, made by `grid` or `windows`, or a list of
        constraints.
      beta: inverse temperature of the demonstrator, nats per unit of reward.
      measure: base measure of trajectories, "uniform" (A^-length) or "counting" (1).
      known: constraints that are known to hold; the nominal distribution obeys these too.
      between_states: whether crossing a constraint between two states counts as entering it; False
        judges the states alone, as the paper does. None means False for a tabular MDP, which has no
        states between its states, and True for others.
    """

    mdp: MDP
    hypotheses: HypothesisSet
    beta: float = 1.0
    measure: str = "uniform"
    known: Sequence[Constraint] = ()
    between_states: bool = None  # pyright: ignore[reportAssignmentType]  # set below

    if TYPE_CHECKING:  # lists of constraints are accepted, and become a HypothesisSet

        def __init__(
            self,
            mdp: MDP,
            hypotheses: HypothesisSet | Sequence[Constraint],
            beta: float = 1.0,
            measure: str = "uniform",
            known: Sequence[Constraint] = (),
            between_states: bool | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.mdp, MDP):
            raise ValueError(f"mdp: expected a swerve.MDP, got {self.mdp!r}")
        check_mdp(self.mdp)
        check_repeatable(self.mdp, _mdp_digest(self.mdp))
        space, action_names = self.mdp.space, tuple(self.mdp.action_names)
        if self.between_states is None:
            object.__setattr__(self, "between_states", not space.is_lattice)
        if not isinstance(self.hypotheses, HypothesisSet):
            check_constraints(self.hypotheses, space, action_names, "hypotheses")
            object.__setattr__(self, "hypotheses", ConstraintHypotheses(self.hypotheses))
        object.__setattr__(self, "beta", positive_number(self.beta, "beta"))
        if self.measure not in MEASURES:
            raise ValueError(f"measure: expected one of {MEASURES}, got {self.measure!r}")
        self.hypotheses.check(space, action_names)
        _check_actions(self.hypotheses, self.mdp)
        known = check_constraints(self.known, space, action_names, "known")
        object.__setattr__(self, "known", known)
        if self.hypotheses.needs_code:
            judged = map(self.hypotheses.constraint, range(len(self.hypotheses)))
            check_predicates(judged, space, "hypotheses")
        check_predicates(known, space, "known")

    @cached_property
    def compiled(self) -> dict[Any, Callable[..., Any]]:
        """Functions that JAX compiled for this problem, by `simulation.compiled`."""
        return {}

    @property
    def record(self) -> ProblemRecord:
        """The problem as plain data."""
        return ProblemRecord(
            name=_mdp_name(self.mdp),
            space=self.mdp.space,
            action_names=tuple(self.mdp.action_names),
            goal_names=tuple(self.mdp.goal_names),
            goal_is_last_state=type(self.mdp).goal_of is MDP.goal_of,
            num_actions=self.mdp.num_actions,
            num_steps=self.mdp.num_steps,
            dt=float(self.mdp.dt),
            hypotheses=self.hypotheses,
            known=tuple(self.known),
            beta=float(self.beta),
            measure=self.measure,
            between_states=bool(self.between_states),
            mdp_digest=_mdp_digest(self.mdp),
            transitions=getattr(self.mdp, "transitions", None),
            is_timed=bool(self.mdp.is_timed),
        )


def _check_actions(hypotheses: HypothesisSet, mdp: MDP) -> None:
    """Raise ValueError where a hypothesis forbids none of the actions: no data could support it."""
    if not hypotheses.about_actions:
        return
    table = np.asarray(mdp.actions)
    span = ", ".join(
        f"{name} from {low:g} to {high:g}"
        for name, low, high in zip(mdp.action_names, table.min(0), table.max(0), strict=True)
    )
    for index in range(len(hypotheses)):
        for part in hypotheses.constraint(index).parts:
            box = part.actions if isinstance(part, StateAction) else part
            if isinstance(box, ActionBox) and not box.among(mdp).any():
                raise ValueError(
                    f"hypotheses: {part.name} forbids none of the {len(table)} actions of "
                    f"{type(mdp).__name__} ({span}), so that no data could tell it from no "
                    "constraint: widen it, or give the MDP such actions"
                )


def _mdp_name(mdp: MDP) -> str:
    """Return the class and the scalar parameters, as in 'Pendulum(max_torque=10.0)'."""
    parameters = [
        f"{field.name}={value:.6g}" if isinstance(value, float) else f"{field.name}={value}"
        for field in dataclasses.fields(mdp)
        for value in [getattr(mdp, field.name)]
        if isinstance(value, int | float | str)
    ]
    return f"{type(mdp).__name__}({', '.join(parameters)})"


def _mdp_digest(mdp: MDP) -> str:
    """Hash an MDP's class, its parameters, its arrays and its actions."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(mdp)
    module = re.sub(OF_A_FILE, r"\1", type(mdp).__module__)
    parts = [f"{module}.{type(mdp).__qualname__}", _mdp_name(mdp)]
    for path, leaf in leaves:
        if callable(leaf):  # the bytes of a function are an address in memory
            parts.append(f"{jax.tree_util.keystr(path)}{_name_of(leaf)}")
            continue
        array = plain_array(leaf)
        kind = str(array.dtype)
        if isinstance(leaf, jax.Array):  # of 64 bits only where JAX was told so
            kind = NARROW.get(leaf.dtype.name, leaf.dtype.name)  # of a key, its algorithm
            array = array.astype(kind) if kind in NARROW.values() else array
        parts.append(f"{jax.tree_util.keystr(path)}{kind}{array.shape}")
        parts.append(array.tobytes().hex())
    parts += _static_fields(mdp, "")
    parts.append(np.asarray(actions_of(mdp), np.float64).tobytes().hex())
    return digest("\n".join(parts))


def _name_of(code: Callable[..., Any]) -> str:
    """Return the name of a function; of an object that can be called, that of its class."""
    if isinstance(code, partial):
        return f"{_name_of(code.func)}{code.args}{code.keywords}"
    named = code if hasattr(code, "__qualname__") else type(code)
    return f"{named.__module__}.{named.__qualname__}"


def _static_fields(module: Any, path: str) -> list[str]:
    """Return the static fields of a module and of modules inside; JAX has no leaves for these."""
    parts = []
    for field in dataclasses.fields(module):
        value, where = getattr(module, field.name), f"{path}.{field.name}"
        if field.metadata.get("static"):
            parts.append(f"{where}={value!r}")
        elif dataclasses.is_dataclass(value):
            parts += _static_fields(value, where)
    return parts
