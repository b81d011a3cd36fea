"""Compute advantages and losses of maximum-entropy policy gradients, as pure functions.

Rewards are soft: they contain the log-probability of the executed action (the paper, eq. 6).
`ppo.PPOTrainer.soft_rewards` forms them, in nats,

    r~_t = beta r_t - log pi(a_t | s_t, t)  (- log A for the uniform measure),

so that for pi = pi_0 every return is the same number and every advantage is zero. Nothing is
normalised or discounted. Returns may differ by orders of magnitude, so losses, and nothing else,
are divided by 1 + |value| / scale. In the policy's loss, value is the value of the state; in the
value's loss, value is the target.

Shapes: L steps of a segment, N lanes, A actions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

HUBER_DELTA = 2.0  # relative error beyond which the Huber loss is linear
LEAST_ADVANTAGE = -5.0  # times the scale: an action loses all but e^-5 of its probability
LARGEST_EXPONENT = 8.0  # largest |output| of a value network: values up to scale * 3000 nats


def discounted(
    residual: Float[Array, "L N"], ended: Bool[Array, "L N"], trace: float
) -> Float[Array, "L N"]:
    """Return sum_k trace^k residual_{t+k}, up to the end of the episode or of the segment.

    For residuals r~ + V(s') - V(s) the sums are generalised advantage estimates without discount.

    Args:
      residual: nats.
      ended: True where the episode ended with this step.
      trace: lambda, between 0 and 1.
    """

    def backward(later: Array, x: tuple[Array, Array]) -> tuple[Array, Array]:
        residual, ended = x
        now = residual + trace * jnp.where(ended, 0.0, later)
        return now, now

    return jax.lax.scan(backward, jnp.zeros_like(residual[0]), (residual, ended), reverse=True)[1]


def bounded(advantage: Float[Array, "*N"], scale: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return advantages, limited from below so that disasters do not dominate the gradient.

    Args:
      advantage: nats.
      scale: number that the losses are divided by.
    """
    return jnp.maximum(advantage, LEAST_ADVANTAGE * scale)


def policy_loss(
    log_probabilities: Float[Array, " A"],
    old_log_probabilities: Float[Array, " A"],
    action: Int[Array, ""],
    advantage: Float[Array, ""],
    *,
    clip: float,
) -> Float[Array, ""]:
    """Return the loss of one step: KL(new || old) minus the clipped surrogate.

    Without the clip the loss is least at pi_old exp(advantage), normalised: the soft policy
    improvement.
    """
    log_ratio = log_probabilities - old_log_probabilities
    ratio = jnp.exp(select(log_ratio, action))
    clipped = jnp.clip(ratio, 1.0 - clip, 1.0 + clip)
    divergence = jnp.sum(jnp.exp(log_probabilities) * log_ratio)
    return divergence - jnp.minimum(ratio * advantage, clipped * advantage)


def huber(error: Float[Array, ""]) -> Float[Array, ""]:
    """Return error^2 / 2 near 0, linear beyond HUBER_DELTA."""
    size = jnp.abs(error)
    inner = jnp.minimum(size, HUBER_DELTA)
    return inner * (size - 0.5 * inner)


def loss_scale(value: Float[Array, "*N"], scale: float) -> Float[Array, "*N"]:
    """Return 1 + |value| / scale, by which losses are divided."""
    return 1.0 + jnp.abs(value) / scale


def value_of_output(output: Float[Array, "*N"], scale: float) -> Float[Array, "*N"]:
    """Return the value [nats] of a network's output: linear near 0, exponential far from it.

    The slope is `loss_scale` of the value, so equal relative errors are equal errors of the output.
    """
    size = jnp.minimum(jnp.abs(output), LARGEST_EXPONENT)
    return jnp.sign(output) * scale * jnp.expm1(size)


def select(table: Float[Array, " A"], index: Int[Array, ""]) -> Float[Array, ""]:
    """Return table[index]; over a batch of few actions a sum is faster than a gather."""
    return jnp.sum(jnp.where(jnp.arange(table.shape[0]) == index, table, 0.0))
