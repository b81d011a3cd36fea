"""Actions are sampled with the probabilities of the policy."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swerve.simulation.trajectory import sample_action

LARGEST = float(np.nextafter(np.float32(1.0), np.float32(0.0)))


draw_from_one = jax.jit(jax.vmap(sample_action, (None, 0)))
draw_from_each = jax.jit(jax.vmap(sample_action))


def draw(probabilities: np.ndarray, uniforms: np.ndarray) -> np.ndarray:
    """Draw for each uniform number, from one distribution [A] or one for each [N, A]."""
    with np.errstate(divide="ignore"):
        log_probabilities = np.log(np.asarray(probabilities, np.float32))
    draw_all = draw_from_one if log_probabilities.ndim == 1 else draw_from_each
    drawn = draw_all(jnp.asarray(log_probabilities), jnp.asarray(uniforms, jnp.float32))
    action, log_probability = map(np.asarray, drawn)
    lanes = np.broadcast_to(log_probabilities, (len(uniforms), log_probabilities.shape[-1]))
    np.testing.assert_array_equal(log_probability, lanes[np.arange(len(uniforms)), action])
    return action


class TestDrawAction:
    @pytest.mark.parametrize(
        "probabilities",
        [[1.0], [0.5, 0.5], [0.1, 0.2, 0.3, 0.4], [0.0, 0.3, 0.0, 0.0, 0.7, 0.0], [1e-3, 0.999]],
    )
    def test_frequencies_of_evenly_spaced_numbers_are_the_probabilities(
        self, probabilities: list[float]
    ) -> None:
        num = 100_000
        action = draw(np.array(probabilities), (np.arange(num) + 0.5) / num)
        counts = np.bincount(action, minlength=len(probabilities))
        np.testing.assert_allclose(counts, num * np.array(probabilities), atol=1.5)
        assert (np.diff(action) >= 0).all()

    @pytest.mark.parametrize("num_actions", [2, 5, 9, 64, 200])
    def test_what_has_no_probability_is_never_drawn(self, num_actions: int) -> None:
        """Not for the least number, nor the largest, nor those nearest to the steps between."""
        generator = np.random.default_rng(num_actions)
        num = 2000
        probabilities = generator.random((num, num_actions)) ** 3
        zero = generator.random((num, num_actions)) < 0.5
        zero[np.arange(num), generator.integers(0, num_actions, num)] = False
        probabilities[zero] = 0.0
        probabilities /= probabilities.sum(axis=1, keepdims=True)
        probabilities = probabilities.astype(np.float32)
        steps = np.cumsum(probabilities, axis=1)
        near = np.take_along_axis(steps, generator.integers(0, num_actions, (num, 1)), axis=1)[:, 0]
        for uniforms in (
            np.zeros(num),
            np.full(num, LARGEST),
            near,
            np.nextafter(near, np.float32(0.0)),
            np.nextafter(near, np.float32(1.0)),
            generator.random(num),
        ):
            chosen = draw(probabilities, np.clip(uniforms, 0.0, LARGEST))
            assert (probabilities[np.arange(num), chosen] > 0).all()

    def test_the_extremes_draw_the_first_and_the_last_possible(self) -> None:
        probabilities = np.array([0.0, 0.0, 0.25, 0.5, 0.0, 0.25, 0.0])
        action = draw(probabilities, np.array([0.0, LARGEST, 0.25, 0.75]))
        np.testing.assert_array_equal(action, [2, 5, 3, 5])

    def test_log_probabilities_need_not_be_normalised_exactly(self) -> None:
        """Rounding leaves sums beside 1: no number may then fall beyond the last action."""
        for scale in (0.9999, 1.0, 1.0001):
            probabilities = scale * np.array([0.3, 0.3, 0.4, 0.0])
            action = draw(probabilities, np.array([0.0, 0.9999, LARGEST]))
            np.testing.assert_array_equal(action, [0, 2, 2])

    @given(seed=st.integers(0, 2**32 - 1))
    @settings(max_examples=30)
    def test_inverts_the_cumulative_distribution(self, seed) -> None:
        generator = np.random.default_rng(seed)
        probabilities, uniforms = generator.dirichlet(np.ones(6)), generator.random(64)
        action = draw(probabilities, uniforms)
        steps = np.concatenate([[0.0], np.cumsum(probabilities)])
        assert (steps[action] <= uniforms + 1e-6).all()
        assert (uniforms <= steps[action + 1] + 1e-6).all()
