"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

For a matrix of weights with gradient G, running means of G G^T and G^T G have eigenvectors Q_L and
Q_R; Adam works on Q_L^T G Q_R, and its step is turned back,

    L <- b L + (1 - b) G G^T,    R <- b R + (1 - b) G^T G,
    W <- W - rate Q_L Adam(Q_L^T G Q_R) Q_R^T.

The bases follow by one step of orthogonal iteration every few updates. Vectors get plain Adam.
Fitting a value to a few hundredths of a nat is badly conditioned. SOAP copes with such fits: on the
pendulum, the KL divergence after equally many steps is several times less than with Adam.

Shapes: p x q weights.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Int

DECAY = 0.95  # b, of all running means
REFRESHED = 10  # updates between two steps of the bases
EPSILON = 1e-8  # added to the root of the mean square, against division by 0


class Moments(NamedTuple):
    """Running means for one array of weights.

    Attributes:
      mean: mean of the gradient.
      square: mean of the gradient's squares, for a matrix in the eigenbasis.
      covariance: [p, p] and [q, q] means of G G^T and G^T G of a matrix; empty for a vector.
      basis: eigenvectors of the covariances, in columns, the largest eigenvalues first.
    """

    mean: Array
    square: Array
    covariance: tuple[Array, ...]
    basis: tuple[Array, ...]


class SOAPState(NamedTuple):
    """Moments of each array of weights, and the number of updates so far."""

    moments: Any
    num_updates: Int[Array, ""]


def soap(schedule: optax.Schedule) -> optax.GradientTransformation:
    """Return the optimiser, whose learning rate follows a schedule over updates."""
    return optax.chain(scale_by_soap(), optax.scale_by_learning_rate(schedule))


def scale_by_soap() -> optax.GradientTransformation:
    """Return the transformation of gradients to steps, Q_L Adam(Q_L^T G Q_R) Q_R^T."""

    def init(params: Any) -> SOAPState:
        return SOAPState(jax.tree.map(_moments, params), jnp.int32(0))

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, SOAPState]:
        num_updates, leaves = state.num_updates + 1, jax.tree.structure(updates)
        pairs = [
            _step(g, m, num_updates)
            for g, m in zip(
                leaves.flatten_up_to(updates), leaves.flatten_up_to(state.moments), strict=True
            )
        ]
        steps = leaves.unflatten([step for step, _ in pairs])
        return steps, SOAPState(leaves.unflatten([moments for _, moments in pairs]), num_updates)

    return optax.GradientTransformation(init, update)


def _moments(weights: Array) -> Moments:
    """Return the moments that an array of weights begins with."""
    sides = weights.shape if weights.ndim == 2 else ()
    return Moments(
        jnp.zeros_like(weights),
        jnp.zeros_like(weights),
        tuple(jnp.zeros((side, side), jnp.float32) for side in sides),
        tuple(jnp.eye(side, dtype=jnp.float32) for side in sides),
    )


def _step(gradient: Array, moments: Moments, num_updates: Int[Array, ""]) -> tuple[Array, Moments]:
    """Return the step for one array, before scaling by the rate, and the moments after the step."""
    mean = _follow(moments.mean, gradient)
    square = _follow(moments.square, _turned(gradient, moments.basis) ** 2)
    unbiased = (1.0 - DECAY**num_updates).astype(jnp.float32)
    step = _turned(mean, moments.basis) / unbiased / (jnp.sqrt(square / unbiased) + EPSILON)
    step = _turned(step, tuple(basis.T for basis in moments.basis))
    if gradient.ndim != 2:
        return step, moments._replace(mean=mean, square=square)
    covariance = (
        _follow(moments.covariance[0], gradient @ gradient.T),
        _follow(moments.covariance[1], gradient.T @ gradient),
    )
    moments = Moments(mean, square, covariance, moments.basis)
    return step, jax.lax.cond(num_updates % REFRESHED == 1, _refreshed, lambda m: m, moments)


def _follow(average: Array, value: Array) -> Array:
    return DECAY * average + (1.0 - DECAY) * value


def _turned(matrix: Array, basis: tuple[Array, ...]) -> Array:
    """Return a matrix in a basis, Q_L^T M Q_R; an array without a basis unchanged."""
    return basis[0].T @ matrix @ basis[1] if basis else matrix


def _refreshed(moments: Moments) -> Moments:
    """Take one step of orthogonal iteration with both bases, and reorder the squares likewise."""
    square, basis = moments.square, []
    for axis, (covariance, old) in enumerate(zip(moments.covariance, moments.basis, strict=True)):
        image = covariance @ old
        order = jnp.argsort(-jnp.sum(old * image, axis=0))
        basis.append(jnp.linalg.qr(image[:, order])[0])
        square = jnp.take(square, order, axis=axis)
    return moments._replace(square=square, basis=tuple(basis))
