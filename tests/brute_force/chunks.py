"""How many random problems are compared, and in which portions.

`make test` compares the first 300. The environment variable SWERVE_BRUTE_FORCE sets another number,
as `make verify` does.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import jax

NUM_PROBLEMS = int(os.environ.get("SWERVE_BRUTE_FORCE", "300"))
AT_ONCE = 20  # problems of one test
CLEARED = 100  # problems after which what JAX keeps of them is dropped: it fills the memory
CHUNKS = [
    range(first, min(first + AT_ONCE, NUM_PROBLEMS)) for first in range(0, NUM_PROBLEMS, AT_ONCE)
]


def every(step: int) -> list[range]:
    """Return the chunks with one of `step` problems in each."""
    return [range(chunk.start, chunk.stop, step) for chunk in CHUNKS]


def over(seeds: range, compare: Callable[[int], list[str]]) -> None:
    """Compare the problems of some seeds, and fail with everything that differs in any of them."""
    found = []
    for seed in seeds:
        try:
            found += compare(seed)
        except Exception as error:
            error.add_note(f"seed {seed}")
            found.append(f"seed {seed}: {type(error).__name__}: {error}")
    if seeds.stop % CLEARED == 0:
        jax.clear_caches()
    assert not found, f"{len(found)} differences:\n" + "\n".join(found)
