"""Refuse to run JAX in a forked process: JAX's threads stay in the parent, and JAX waits for them.

A process that was forked before JAX had begun to run is free to use JAX.
"""

from __future__ import annotations

import os
import sys

_is_forked = False  # whether JAX had begun to run when this process was forked


def check_process() -> None:
    """Raise RuntimeError in a process that was forked after JAX had begun to run."""
    if _is_forked:
        raise RuntimeError(
            "this process was forked from one in which JAX was running already, and JAX hangs in "
            "such a process: start processes with multiprocessing.get_context('spawn') or "
            "'forkserver', or with joblib; inference from evidence works in any process"
        )


def _note_fork() -> None:
    global _is_forked  # noqa: PLW0603  # each process has its own
    bridge = sys.modules.get("jax._src.xla_bridge")
    _is_forked = _is_forked or bool(bridge and getattr(bridge, "_backends", True))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)
