"""Sum the weights of the walks of all lengths on a table of states, by linear algebra.

With w(s, s') the sum of the weights of the steps from s to s', the walks of all lengths from one
state to another have the sum of weights

    G = 1 + w + w w + ... = (1 - w)^-1,

and the walks that end where they first reach one of the states E, with a weight v for each end,
have the sum

    Z(s) = G[s, E] G[E, E]^-1 v.

A hypothesis c takes away the few steps w_c that enter c. They lead from states A to states B:

    G_c = (1 - w + w_c)^-1 = G - G[:, A] (1 + w_c G[B, A])^-1 w_c G[B, :]    (Woodbury),

so Z_c follows from small matrices for any start and end.

Shapes: P states, M steps, H hypotheses, E states where walks end, B hypotheses of a block, k states
that the steps of one hypothesis leave or reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

BLOCK = 64  # hypotheses whose small matrices are solved at once, to bound memory
CANCELLED = 1e-8  # share of Z_0: a smaller Z_c has lost its digits, and is solved for on its own
GONE = 1e-12  # share of the walks that counts as none
NEGATIVE = -1e-9  # lowest value that rounding may give a sum of weights that is exactly 0


class Steps(NamedTuple):
    """Steps between states.

    Attributes:
      source: [M] the state that each step leaves.
      target: [M] the state that each step leads to.
      num_states: P.
      entering: for each of H hypotheses, the numbers of the steps that enter it.
    """

    source: np.ndarray
    target: np.ndarray
    num_states: int
    entering: Sequence[np.ndarray]


class Ends(NamedTuple):
    """Where walks end: states [E], and their weights there [E]."""

    states: np.ndarray
    weight: np.ndarray


class Block(NamedTuple):
    """The steps that some hypotheses take away, padded to the same size.

    Attributes:
      hypotheses: [B] indices of the hypotheses.
      source: [B, k] states that the steps into the hypotheses leave.
      target: [B, k] states that these steps lead to.
      kernel: [B, k, k] (1 + w_c G[target, source])^-1 w_c; 0 where padded.
    """

    hypotheses: np.ndarray
    source: np.ndarray
    target: np.ndarray
    kernel: np.ndarray


@dataclass(frozen=True, eq=False)
class Walks:
    """Walks of all lengths.

    Attributes:
      steps: the steps that walks consist of.
      weight: [M] weight of each step; 0 for a step that is not allowed.
    """

    steps: Steps
    weight: np.ndarray

    @cached_property
    def matrix(self) -> Any:
        """[P, P] sparse, w."""
        return self._matrix(self.weight)

    @cached_property
    def green(self) -> np.ndarray:
        """[P, P] G.

        Raises:
          ValueError: if the walks have no finite sum.
        """
        green = np.linalg.inv(np.eye(self.steps.num_states) - self.matrix.toarray())
        if not green.min() > NEGATIVE:  # (1 - w)^-1 has negative elements where the series diverges
            raise ValueError("longer and longer walks weigh more and more: there is no finite sum")
        return green

    def values(self, ends: Ends) -> np.ndarray:
        """Return Z(s) [P] of the walks from each state to where they end."""
        among = self.green[np.ix_(ends.states, ends.states)]
        return np.asarray(self.green[:, ends.states] @ np.linalg.solve(among, ends.weight))

    def policy(self, ends: Ends) -> np.ndarray:
        """Return the probability [M] of each step where it starts; 0 where walks end."""
        values = self.values(ends)
        going = np.where(values > 0.0, values, np.inf)
        going[ends.states] = np.inf
        source, target = self.steps.source, self.steps.target
        return np.asarray(self.weight * values[target] / going[source])

    def longer(self, start: int, ends: Ends, num_steps: int) -> float:
        """Return the share of the walks from a start that take more than `num_steps` steps."""
        onwards = self._matrix(self.policy(ends)).T.tocsr()
        there = np.zeros(self.steps.num_states)
        there[start] = 1.0
        for _ in range(num_steps):
            there = onwards @ there
            there[ends.states] = 0.0
            if there.sum() < GONE:
                return 0.0
        return float(there.sum())

    def sample(
        self, start: int, ends: Ends, num: int, most: int, generator: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sample walks of at most `most` steps, by rejecting longer walks.

        Returns:
          Steps [num, most], arbitrary after the end of a walk, and lengths [num].
        """
        order = np.argsort(self.steps.source, kind="stable")
        total = np.concatenate([[0.0], np.cumsum(self.policy(ends)[order])])
        first = np.searchsorted(self.steps.source[order], np.arange(self.steps.num_states + 1))
        is_end = np.isin(np.arange(self.steps.num_states), ends.states)
        steps, length = np.zeros((num, most), int), np.full(num, -1)
        while (length < 0).any():
            rows = np.flatnonzero(length < 0)
            state = np.full(len(rows), start)
            for step in range(most):
                low, high = total[first[state]], total[first[state + 1]]
                point = low + generator.random(len(rows)) * (high - low)
                place = np.searchsorted(total, point, side="right") - 1
                steps[rows, step] = order[np.clip(place, first[state], first[state + 1] - 1)]
                state = self.steps.target[steps[rows, step]]
                length[rows[is_end[state]]] = step + 1
                rows, state = rows[~is_end[state]], state[~is_end[state]]
                if not len(rows):
                    break
        return steps, length

    def avoiding(self, start: int, ends: Ends) -> np.ndarray:
        """Return Z_c [H] of the walks from a start that avoid each hypothesis."""
        rows = np.concatenate([[start], ends.states])
        leaving, arriving = self.green[rows], self.green[:, ends.states]
        kept = np.empty(len(self.steps.entering))
        for block in self.blocks:
            change = leaving[:, block.source].swapaxes(0, 1) @ block.kernel
            green = arriving[rows] - change @ arriving[block.target]  # [B, 1 + E, E]
            weight = np.broadcast_to(ends.weight[:, None], (len(green), len(ends.weight), 1))
            first = np.linalg.solve(green[:, 1:], weight)
            kept[block.hypotheses] = (green[:, :1] @ first)[:, 0, 0]
        total = self.values(ends)[start]
        for index in np.flatnonzero(~(kept > CANCELLED * total)).tolist():
            kept[index] = self._solved(start, ends, self.steps.entering[index])
        return np.minimum(kept, total)

    @cached_property
    def blocks(self) -> list[Block]:
        """Blocks of hypotheses; all hypotheses of a block take away about equally many steps."""
        sizes = np.array([len(steps) for steps in self.steps.entering])
        order = np.argsort(sizes, kind="stable")
        return [self._block(order[k : k + BLOCK]) for k in range(0, len(order), BLOCK)]

    def _block(self, hypotheses: np.ndarray) -> Block:
        parts = []
        for index in hypotheses.tolist():
            entering = self.steps.entering[index]
            source, row = np.unique(self.steps.source[entering], return_inverse=True)
            target, column = np.unique(self.steps.target[entering], return_inverse=True)
            parts.append((source, target, row, column, self.weight[entering]))
        size = max(1, *(max(len(part[0]), len(part[1])) for part in parts))
        sources, targets = np.zeros((2, len(parts), size), int)
        taken = np.zeros((len(parts), size, size))
        for k, (source, target, row, column, weight) in enumerate(parts):
            sources[k, : len(source)], targets[k, : len(target)] = source, target
            np.add.at(taken[k], (row, column), weight)
        between = self.green[targets[:, :, None], sources[:, None, :]]
        kernel = np.linalg.solve(np.eye(size) + taken @ between, taken)
        return Block(hypotheses, sources, targets, kernel)

    def _solved(self, start: int, ends: Ends, taken: np.ndarray) -> float:
        """Return Z_c to all digits, by solving a system of its own without the steps taken away."""
        weight, size = self.weight.copy(), self.steps.num_states
        weight[taken] = 0.0
        goes = weight > 0.0
        if (
            start not in self.steps.source[goes]
            or not np.isin(ends.states, self.steps.target[goes]).any()
        ):
            return 0.0
        is_end = np.isin(np.arange(size), ends.states)
        weight[is_end[self.steps.source]] = 0.0
        matrix: Any = self._matrix(weight)
        matrix.eliminate_zeros()
        reaching = _reaching(matrix, ends.states)
        if start not in reaching:
            return 0.0
        own = np.zeros(size)
        own[ends.states] = ends.weight
        one: Any = scipy.sparse.identity(len(reaching), format="csc")
        system = one - matrix[reaching][:, reaching]
        values: Any = scipy.sparse.linalg.spsolve(system, own[reaching])
        return float(values[np.searchsorted(reaching, start)])

    def _matrix(self, weight: np.ndarray) -> Any:
        places = (self.steps.source, self.steps.target)
        return scipy.sparse.csr_matrix((weight, places), shape=2 * (self.steps.num_states,))


def _reaching(matrix: Any, ends: np.ndarray) -> np.ndarray:
    """Return, in order, the ends and the states from which walks lead to the ends."""
    backwards = matrix.T.tocsr()
    found = [
        scipy.sparse.csgraph.breadth_first_order(backwards, end, return_predecessors=False)
        for end in ends.tolist()
    ]
    return np.unique(np.concatenate(found))
