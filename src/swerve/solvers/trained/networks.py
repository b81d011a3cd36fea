"""Define small dense networks, applied to one input at a time and mapped over batches."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key


class DenseNetwork(eqx.Module):
    """A multilayer perceptron with tanh between its layers.

    Args:
      sizes: sizes of the input, of every hidden layer and of the output.
      last_scale: factor on the last layer's first weights; if small, outputs begin near 0.
      key: source of randomness.
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]

    def __init__(self, sizes: tuple[int, ...], last_scale: float, *, key: Key[Array, ""]) -> None:
        keys = jax.random.split(key, len(sizes) - 1)
        scales = [1.0] * (len(sizes) - 2) + [last_scale]
        self.weights = [
            scale * jax.random.normal(layer_key, (outputs, inputs), jnp.float32) / inputs**0.5
            for layer_key, scale, inputs, outputs in zip(
                keys, scales, sizes[:-1], sizes[1:], strict=True
            )
        ]
        self.biases = [jnp.zeros(outputs, jnp.float32) for outputs in sizes[1:]]

    def __call__(self, x: Float[Array, " in"]) -> Float[Array, " out"]:
        """Return the output for one input."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = jnp.tanh(weight @ x + bias)
        return self.weights[-1] @ x + self.biases[-1]


def to_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a network, or of any tree of arrays, to be stored."""
    return {f"{k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(tree))}


def from_arrays(like: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Rebuild the tree that `to_arrays` took apart, from another tree of the same form.

    Raises:
      ValueError: if an array is missing, unknown, of another shape or kind, or holds NaN.
    """
    leaves, form = jax.tree.flatten(like)
    names = [str(k) for k in range(len(leaves))]
    if set(arrays) != set(names):
        raise ValueError(f"expected {len(names)} arrays of numbers, got {len(arrays)}")
    for name, leaf in zip(names, leaves, strict=True):
        array, kind = arrays[name], np.dtype(jnp.result_type(leaf)).kind
        if (array.shape, array.dtype.kind) != (np.shape(leaf), kind):
            raise ValueError(
                f"array {name!r}: expected kind {kind!r} and shape {np.shape(leaf)}, got "
                f"{array.dtype.kind!r} and {array.shape}"
            )
        if kind == "f" and np.isnan(array).any():
            raise ValueError(f"array {name!r}: expected numbers, got NaN")
    return jax.tree.unflatten(form, [jnp.asarray(arrays[name]) for name in names])
