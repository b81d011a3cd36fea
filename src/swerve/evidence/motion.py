"""Hold how states move, so that recorded states can be held against the dynamics without JAX.

Within a time D the component i of a state changes by

    s'_i - s_i = D [(1 - p_i) g_i(s) + p_i g_i(s')] +- D (a_i + e_i + b_i),    g_i(s) = u' Q_i u,

where u holds 1 and features of the state s. Q_i is fitted to steps of the dynamics from states
anywhere in the bounds, each with several actions. The place p_i is 0, 1/2 or 1, whichever fits
best: 0 for explicit Euler steps, 1/2 for accurate integration. What the state does not tell is a_i,
the spread of the successors over the actions, and e_i, the error of the fit. The straight line
between two states leaves out b_i: half of |g_i(s') - g_i(s)|, all of it for Euler steps, and what
the rate may stray in between, D c_i / 4, where c_i is the change of g_i in a second.

Shapes: L states, n state dimensions, M states to fit to, K actions, B features, F = B (B + 1) / 2
products of features.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swerve.base.space import StateSpace

PLACES = (0.0, 0.5, 1.0)
STRAYING = 0.25  # a rate that goes up and comes back as fast strays by D c / 4 on average
USUAL = 0.98  # quantile: steps beyond, such as those that end at a wall of the model, are rare
FITTED = 2 / 3  # share of the steps that the fit is made of; the other steps tell how good it is
UNTOLD = 1e12  # extents a second: with such an error, the motion says nothing of a component
PREFERRED = 0.8  # another place than 1/2 must leave an error smaller by this factor
RIDGE = 1e-8  # for features that depend on one another, such as a small angle and its sine
MOST_WAVES = 6  # dimensions: with more, sines of states that are no angles make too many features


class Motion(NamedTuple):
    """How states of a problem move; see the formula above.

    Attributes:
      forms: [n, B, B] Q, in units of the states a second.
      place: [n] p.
      reach: [n] a, on average, in units of the states a second.
      error: [n] e, for usual states.
      worst: [n] the largest a + e of any state.
      turning: [n] c, on average, in units of the states a second, a second.
    """

    forms: np.ndarray
    place: np.ndarray
    reach: np.ndarray
    error: np.ndarray
    worst: np.ndarray
    turning: np.ndarray

    def silenced(self, column: int, space: StateSpace, *, is_jump: bool) -> Motion:
        """Return the motion that says nothing of a component of the state.

        Args:
          column: the component.
          space: state space.
          is_jump: whether single steps alone are left out, and sums of steps still judged.
        """
        error, worst = self.error.copy(), self.worst.copy()
        worst[column] = UNTOLD * space.extent[column]
        if not is_jump:
            error[column] = worst[column]
        return self._replace(error=error, worst=worst)

    def rates(self, states: np.ndarray, space: StateSpace) -> np.ndarray:
        """Return g [L, n] of states [L, n]."""
        found = features(states, space)
        return np.stack([((found @ form) * found).sum(axis=1) for form in self.forms], axis=1)

    def steps(self, states: np.ndarray, elapsed: np.ndarray, space: StateSpace) -> Steps:
        """Return the steps between states [L, n] that lie elapsed [L-1] s apart."""
        rates, duration = self.rates(states, space), elapsed[:, None]
        predicted = duration * ((1.0 - self.place) * rates[:-1] + self.place * rates[1:])
        turned = np.abs(rates[1:] - rates[:-1])
        bend = duration * (0.5 + np.abs(self.place - 0.5)) * turned
        bend += STRAYING * duration**2 * self.turning
        return Steps(space.difference(states[:-1], states[1:]), predicted, duration, bend)


class Steps(NamedTuple):
    """Recorded steps beside what the dynamics say of them.

    Attributes:
      moved: [L-1, n] change of the states.
      predicted: [L-1, n] change by the dynamics, with the average of the actions.
      duration: [L-1, 1] s.
      bend: [L-1, n] what the straight line between two states leaves out at most.
    """

    moved: np.ndarray
    predicted: np.ndarray
    duration: np.ndarray
    bend: np.ndarray


def features(states: np.ndarray, space: StateSpace) -> np.ndarray:
    """Return u [..., B] of states [..., n]: 1, the states scaled to the bounds, sines and cosines.

    Sines and cosines of states that are not declared as angles are features too: a heading that
    never turns round need not be declared.
    """
    is_angle = space.is_angle
    scaled = (states - space.bounds.mean(axis=1)) / (0.5 * space.extent)
    waving = states if len(is_angle) <= MOST_WAVES else states[..., is_angle]
    one = np.ones((*states.shape[:-1], 1))
    parts = [one, scaled[..., ~is_angle], np.sin(waving), np.cos(waving)]
    return np.concatenate(parts, axis=-1)


def fit_motion(before: np.ndarray, after: np.ndarray, space: StateSpace, dt: float) -> Motion:
    """Fit the motion to steps of dt [s] from states [M, n] in random order to states [M, K, n]."""
    start = np.repeat(before[:, None], after.shape[1], axis=1)
    rate = space.difference(start, after) / dt
    pair = _products(features(before, space))[:, None], _products(features(after, space))
    fits = [_fitted((1.0 - place) * pair[0] + place * pair[1], rate) for place in PLACES]
    left = np.array([fit.reach + fit.error for fit in fits])
    left[PLACES.index(0.5)] *= PREFERRED
    chosen = left.argmin(axis=0)
    weights, reach, error, worst = (
        np.stack([fits[k][part][..., i] for i, k in enumerate(chosen)], axis=-1)
        for part in range(4)
    )
    turning = np.abs((pair[1] - pair[0]) @ weights).mean(axis=(0, 1)) / dt
    return Motion(_forms(weights.T), np.array(PLACES)[chosen], reach, error, worst, turning)


class _Fit(NamedTuple):
    """The weights [F, n] of one place, and what they leave [n]; see `Motion`."""

    weights: np.ndarray
    reach: np.ndarray
    error: np.ndarray
    worst: np.ndarray


def _fitted(products: np.ndarray, rate: np.ndarray) -> _Fit:
    """Fit products [M, K, F] to rates [M, K, n]; some of the states tell how good the fit is.

    The averages over the actions are fitted: noise would bend the fit at the edges of the bounds.
    """
    num, size = int(FITTED * len(rate)), rate.shape[-1]
    known, wanted = products[:num].mean(axis=1), rate[:num].mean(axis=1)
    is_usual = np.ones(wanted.shape)
    weights = np.zeros((products.shape[-1], size))
    for _ in range(2):  # the second time without unusual states, which would bend the fit as well
        for i in range(size):
            used = known * is_usual[:, i : i + 1]
            normal = used.T @ used
            normal[np.diag_indices_from(normal)] += RIDGE * num
            weights[:, i] = np.linalg.solve(normal, used.T @ wanted[:, i])
        missed = np.abs(known @ weights - wanted)
        is_usual = missed <= np.quantile(missed, USUAL, axis=0)
    left = products @ weights - rate
    high, low = left.max(axis=1), left.min(axis=1)
    return _Fit(
        weights,
        0.5 * (high - low).mean(axis=0),
        np.quantile(0.5 * np.abs(high + low)[num:], USUAL, axis=0),
        np.abs(left).max(axis=(0, 1)),
    )


def _products(found: np.ndarray) -> np.ndarray:
    """Return the products [..., F] of each two features [..., B], each product once."""
    first, second = np.triu_indices(found.shape[-1])
    return found[..., first] * found[..., second]


def _forms(weights: np.ndarray) -> np.ndarray:
    """Return weights [n, F] of products as matrices [n, B, B] above the diagonal."""
    num = int((np.sqrt(8 * weights.shape[1] + 1) - 1) / 2)
    forms = np.zeros((len(weights), num, num))
    forms[(slice(None), *np.triu_indices(num))] = weights
    return forms
