"""Check stored foresight: the fields of its header and its arrays, see `base.schema`.

Shapes: G goals, g goal dimensions.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from swerve.base.schema import Count, Data, check_names, checked_arrays, numbers
from swerve.base.store import StoredFile

GOALS = {
    "goals": numbers("f", "Gg"),
    "goal_centre": numbers("f", "g"),
    "goal_scale": numbers("f", "g", sys.float_info.min),
}


class ForesightData(Data):
    """The header of a `Foresight`; the states are checked apart."""

    problem: str
    evidence: str
    space: dict[str, Any]
    goal_is_state: bool
    num_steps: Count
    num_layers: Annotated[int, Meta(ge=1, le=10)]


def read_goals(stored: StoredFile, lengths: dict[str, int]) -> list[np.ndarray]:
    """Return the goals, and their centre and scale.

    Raises:
      StoreError: if an array is missing, altered or of another size.
    """
    return list(checked_arrays(stored, GOALS, lengths).values())


def read_layers(
    stored: StoredFile, num_inputs: int, num_hypotheses: int, num_layers: int
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Return the weights and the biases of the layers, each as wide as the layer before it gives.

    Raises:
      StoreError: if a layer is missing, altered or of another size.
    """
    outputs = [f"layer {k}" for k in range(num_layers)]
    rules, widths = {}, {"inputs": num_inputs, outputs[-1]: num_hypotheses}
    for k, (width, out) in enumerate(pairwise(["inputs", *outputs])):
        rules[f"weight/{k}"] = numbers("f", (out, width))
        rules[f"bias/{k}"] = numbers("f", (out,))
    check_names(stored, rules, GOALS)
    arrays = list(checked_arrays(stored, rules, widths).values())
    return tuple(arrays[::2]), tuple(arrays[1::2])
