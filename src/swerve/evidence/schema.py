"""Check stored evidence: the fields of its header and its arrays, see `base.schema`.

Shapes: K tasks, N trajectories, H hypotheses, V = ceil(H / 8) bytes, I islands, n states, g goal
dimensions, B features of the motion.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from swerve.base.schema import (
    ArrayRule,
    Count,
    Data,
    Positive,
    Seed,
    check_most,
    check_names,
    checked,
    checked_arrays,
    numbers,
)
from swerve.base.store import StoredFile
from swerve.evidence.motion import Motion, features
from swerve.problem.record import ProblemRecord
from swerve.problem.schema import stored_record

REAL, WHOLE = "f", "iu"
SHARE = (-1e-6, 1.0 + 1e-6)  # a share, and what rounding adds to it
LOG = ("-inf",)  # the log of 0
SPARE = ("inf",)  # an error of which nothing is known, a reach without an end

PARTS: dict[str, dict[str, ArrayRule]] = {
    "tasks": {"start": numbers(REAL, "Kn"), "goal": numbers(REAL, "Kg")},
    "summary": {
        "avoid_probability": numbers(REAL, "KH", *SHARE),
        "avoid_variance": numbers(REAL, "KH", 0.0, also=SPARE),
        "log_ratio": numbers(REAL, "KH", also=LOG),
        "log_ratio_error": numbers(REAL, "KH", 0.0, also=("inf", "nan")),
        "log_partition": numbers(REAL, "K", also=LOG),
        "kl": numbers(REAL, "K", also=("-inf", "inf")),
        "effective_sample_size": numbers(REAL, "K", 0.0),
        "distinct_share": numbers(REAL, "K", *SHARE),
        "island_log_partition": numbers(REAL, "KI", also=LOG),
        "avoid_without_island": numbers(REAL, "K*H", *SHARE),
        "soft_value": numbers(REAL, "K", also=("-inf", "nan")),
        "end": numbers(REAL, "Kn"),
        "end_reach": numbers(REAL, "Kn", 0.0, also=SPARE),
        "shortest": numbers(REAL, "K", 0.0),
        "fastest": numbers(REAL, "Kn", 0.0, also=SPARE),
    },
    "samples": {
        "total_reward": numbers(REAL, "KN", also=LOG),
        "log_probability": numbers(REAL, "KN"),
        "length": numbers(WHOLE, "KN", 0),
        "log_correction": numbers(REAL, "KN", also=LOG),
        "ancestor": numbers(WHOLE, "KN", 0),
        "violations": numbers("u", "KNV", 0, 255),
        "kept": numbers(REAL, "K**n"),
        "soft_value": numbers(REAL, "K", also=("-inf", "nan")),
    },
    "missed": {"share": numbers(REAL, "K", *SHARE, also=("nan",))},
    "motion": {name: numbers(REAL, "nBB" if name == "forms" else "n") for name in Motion._fields},
}
OPTIONAL = ("missed", "motion")  # parts that evidence of earlier versions does not have

EXACT_ERROR = numbers(REAL, "KH", 0.0)  # of exact answers: known everywhere


class HeaderData(Data):
    """The header of evidence; the problem is checked apart."""

    problem: Any
    method: Literal["smc", "tempered", "importance", "plain", "exact"]
    num_trajectories: Count
    solver: str
    seed: Seed
    sampling_beta: Positive


class StoredEvidence:
    """A file of evidence whose header has been checked; each part is checked as it is read.

    Args:
      stored: the file.

    Attributes:
      problem: problem of the evidence.
      parts: names of the parts that the file has.

    Raises:
      StoreError: if the header or the names of the arrays are not those of evidence.
    """

    def __init__(self, stored: StoredFile) -> None:
        header = checked(stored.path, stored.header, HeaderData)
        self.problem = stored_record(stored.path, header.problem)
        found = {name.partition("/")[0] for name in stored.names}
        self.parts = tuple(part for part in PARTS if part in found or part not in OPTIONAL)
        self._rules = {
            part: {f"{part}/{name}": rule for name, rule in PARTS[part].items()}
            for part in self.parts
        }
        check_names(stored, *self._rules.values())
        self._stored, num_trajectories = stored, header.num_trajectories
        self._lengths = _lengths(self.problem, num_trajectories)
        self._most = {
            "samples/length": self.problem.num_steps,
            "samples/ancestor": num_trajectories - 1,
        }
        if header.method == "exact":
            self._rules["summary"]["summary/log_ratio_error"] = EXACT_ERROR

    def read(self, part: str, name: str | None = None) -> list[np.ndarray]:
        """Return the arrays of a part, such as "tasks", in their order.

        Args:
          part: name of the part.
          name: name of the one array to read; all are read if None.

        Raises:
          StoreError: if one of the arrays is altered, or does not hold what it should.
        """
        rules = self._rules[part]
        if name is not None:
            rules = {f"{part}/{name}": rules[f"{part}/{name}"]}
        arrays = checked_arrays(self._stored, rules, self._lengths)
        for key, most in self._most.items():
            if key in arrays:
                check_most(self._stored, key, arrays[key], most)
        return list(arrays.values())


def _lengths(problem: ProblemRecord, num_trajectories: int) -> dict[str, int]:
    """Return what the letters of shapes stand for, but K and I, which any array may tell first."""
    middle, num_hypotheses = problem.space.bounds.mean(axis=1), len(problem.hypotheses)
    return {
        "n": len(middle),
        "g": len(problem.goal_names),
        "H": num_hypotheses,
        "V": -(-num_hypotheses // 8),
        "N": num_trajectories,
        "B": len(features(middle, problem.space)),
    }
