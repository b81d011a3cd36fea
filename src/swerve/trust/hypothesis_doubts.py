"""Give what is odd about the hypotheses: the same set twice, sets nobody comes to, narrow ones.

Each hypothesis has a share of the prior probability. Two that are the same set share what one of
them should have alone; one outside the bounds can neither win nor lose by any demonstration. The
edges of one that is narrow for float32, in which states are simulated, are not where they are said
to be.

Shapes: H hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from swerve.base.phrases import some_names
from swerve.base.space import StateSpace
from swerve.constraints.base import Constraint
from swerve.constraints.shapes import HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet
from swerve.hypotheses.grid import BoxHypotheses
from swerve.hypotheses.same import same_as, set_key

FEW_STEPS = 16  # steps of float32: a region less wide than this is coarse


def hypothesis_warnings(
    hypotheses: HypothesisSet, space: StateSpace, known: Sequence[Constraint] = ()
) -> Iterator[str]:
    """Yield warnings about hypotheses that are the same, known, outside the bounds, or narrow."""
    if isinstance(hypotheses, ConstraintHypotheses):
        yield from _same(hypotheses, space)
        yield from _known(hypotheses, space, known)
    yield from _coarse(hypotheses, space)
    found: dict[str, list[tuple[int, float, float]]] = {}
    for index, name, low, high in _outside(hypotheses, space):
        found.setdefault(name, []).append((index, low, high))
    for name, places in found.items():
        yield _outside_text(name, places, space)


def _same(hypotheses: ConstraintHypotheses, space: StateSpace) -> Iterator[str]:
    """Yield a warning for each group of hypotheses that are the same set."""
    groups: dict[int, list[int]] = {}
    for index, first in enumerate(same_as(hypotheses, space).tolist()):
        groups.setdefault(first, []).append(index)
    for group in groups.values():
        if len(group) > 1:
            names = some_names([str(index) for index in group])
            yield (
                f"hypotheses {names} are the same set ({hypotheses.name(group[0])}), each with a "
                f"share of the prior: together they count {len(group)} times. Keep one of them"
            )


def _known(
    hypotheses: ConstraintHypotheses, space: StateSpace, known: Sequence[Constraint]
) -> Iterator[str]:
    """Yield a warning for each hypothesis that is a known constraint."""
    names = {set_key(constraint, space): constraint.name for constraint in known}
    for index, constraint in enumerate(hypotheses.constraints if names else ()):
        name = names.get(set_key(constraint, space))
        if name is not None:
            yield (
                f"hypothesis {index} is known already ({name}): nobody enters it, and no "
                "demonstration can speak for it or against it. Leave it out, for it has a share "
                "of the prior"
            )


def _coarse(hypotheses: HypothesisSet, space: StateSpace) -> Iterator[str]:
    """Yield a warning for each state in which float32 is coarse for a hypothesis."""
    for name in space.names:
        index, low, high = _spans(hypotheses, name)
        if name in space.angles or not len(index):
            continue
        size = np.maximum(np.abs(low), np.abs(high))
        spacing = np.spacing(size.astype(np.float32)).astype(float)
        coarse = np.flatnonzero(high - low < FEW_STEPS * spacing)
        if len(coarse):
            at = coarse[0]
            yield (
                f"hypothesis {index[at]} is {high[at] - low[at]:.3g} wide in {name}, at "
                f"{size[at]:.7g}: states are simulated in single precision, whose numbers are "
                f"{spacing[at]:.2g} apart there. Count {name} from an origin nearby, such as "
                f"{low[at]:.7g}, in the MDP, the hypotheses and the data"
            )


def _spans(hypotheses: HypothesisSet, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return indices, low and high ends [P] of hypotheses, or parts, that are finite in a state."""
    if isinstance(hypotheses, BoxHypotheses):
        edges = hypotheses.edges()
        low, high = edges.get(name, (np.empty(0), np.empty(0)))
        step = math.prod(hypotheses.shape[list(edges).index(name) + 1 :]) if name in edges else 1
        return step * np.arange(len(low)), low, high
    found = [
        (index, *part.spans[name])
        for index in range(len(hypotheses))
        for part in hypotheses.constraint(index).parts
        if name in part.spans and np.isfinite(part.spans[name]).all()
    ]
    columns = np.array(found, float).reshape(-1, 3).T
    return columns[0].astype(int), columns[1], columns[2]


def _outside(
    hypotheses: HypothesisSet, space: StateSpace
) -> Iterator[tuple[int, str, float, float]]:
    """Yield each hypothesis outside the bounds: its index, the state, and its interval there."""
    bounds = {
        name: (low, high)
        for name, (low, high) in zip(space.names, space.bounds.tolist(), strict=True)
        if name not in space.angles
    }
    if isinstance(hypotheses, BoxHypotheses):
        for axis, (name, (low, high)) in enumerate(hypotheses.edges().items()):
            if name not in bounds:
                continue
            is_out = (high <= bounds[name][0]) | (low > bounds[name][1])  # [low, high)
            if not is_out.any():  # places are not worked out: there may be millions of hypotheses
                continue
            place = np.indices(hypotheses.shape)[axis].ravel()
            for index in np.flatnonzero(is_out[place]).tolist():
                yield index, name, float(low[place[index]]), float(high[place[index]])
        return
    for index in range(len(hypotheses)):
        each = [_beyond(part, bounds) for part in hypotheses.constraint(index).parts]
        if each[0] is not None and None not in each:
            yield index, *each[0]


def _beyond(
    part: Constraint, bounds: dict[str, tuple[float, float]]
) -> tuple[str, float, float] | None:
    """Return a state in which a constraint lies outside the bounds, and its interval there."""
    states = part.states if isinstance(part, StateAction) else part
    holds_high = isinstance(states, HalfSpace)  # other sets hold at most their low edges
    for name, (low, high) in part.spans.items():
        least, most = bounds.get(name, (-math.inf, math.inf))
        if high < least or (high == least and not holds_high) or low > most:
            return name, low, high
    return None


def _outside_text(name: str, places: list[tuple[int, float, float]], space: StateSpace) -> str:
    low, high = space.bounds[space.column(name)].tolist()
    first, least, most = places[0]
    names = some_names([str(index) for index, _, _ in places])
    are, have = ("hypothesis", "it has") if len(places) == 1 else ("hypotheses", "each has")
    return (
        f"{are} {names}: wholly outside the bounds of {name}, [{low:.6g}, {high:.6g}] (hypothesis "
        f"{first} has {name} from {least:.6g} to {most:.6g}). Nominal trajectories hardly go "
        f"there, and yet {have} a share of the prior: another unit? Leave out what cannot be, or "
        "widen the MDP's bounds"
    )
