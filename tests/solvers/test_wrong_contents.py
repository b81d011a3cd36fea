"""Nominal distributions and checkpoints of others: refused by name, or harmless."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.wrong_contents import read_zip, write_zip, wrong_array

import swerve
from swerve.base.store import StoreError
from swerve.solvers.trained.networks import to_arrays
from swerve.solvers.trained.run import Run

STORED = Path(__file__).parents[1] / "data" / "before_packages"
MADE: dict[str, Any] = runpy.run_path(str(STORED / "problems.py"))
SETTINGS = (None, 1, [], "text", {"num_steps": "many"}, {"num_steps": -1}, {"width": 1.5})

WRONG_KINDS = ("U3", "c16", "i8")
NAN_ROW = np.full((1, 6), np.nan)


def refused(path: Path, problem: swerve.Problem) -> bool:
    """Return whether a nominal distribution is refused by name."""
    try:
        swerve.load_nominal(path, problem)
    except StoreError as error:
        return str(error).startswith(f"{path}: holds wrong contents: ")
    return False


class TestNominal:
    def test_wrong_arrays(self, tmp_path: Path) -> None:
        problem, path = MADE["problem_of"]("ppo"), tmp_path / "wrong.nominal"
        header, arrays = read_zip(STORED / "ppo.nominal")
        for name in ("0", "history"):
            write_zip(path, header, {key: x for key, x in arrays.items() if key != name})
            assert refused(path, problem), name
        write_zip(path, header, arrays | {"999": np.zeros(3)})
        assert refused(path, problem)
        harmless = []
        for what, array in wrong_array(arrays["0"]):
            write_zip(path, header, arrays | {"0": array})
            if not refused(path, problem):
                harmless.append(what)
        changed = ("one is", "all are", "negated", "large")  # other numbers, but numbers
        assert all(what.startswith(changed) and "nan" not in what for what in harmless)

    def test_wrong_history(self, tmp_path: Path) -> None:
        problem, path = MADE["problem_of"]("ppo"), tmp_path / "wrong.nominal"
        header, arrays = read_zip(STORED / "ppo.nominal")
        history = arrays["history"]
        for wrong in (*(history.astype(kind) for kind in WRONG_KINDS), history[:0], NAN_ROW):
            write_zip(path, header, arrays | {"history": wrong})
            assert refused(path, problem), wrong
        write_zip(path, header, arrays | {"history": history + np.inf})
        assert not refused(path, problem)

    @pytest.mark.parametrize("name", ["ppo", "grid"])
    def test_wrong_settings(self, tmp_path: Path, name: str) -> None:
        problem, path = MADE["problem_of"](name), tmp_path / "wrong.nominal"
        header, arrays = read_zip(STORED / f"{name}.nominal")
        for settings in (*SETTINGS, {"num_points": "many"}, {"num_points": [0.5]}):
            if isinstance(settings, dict) and settings.keys() - header["settings"].keys():
                continue
            write_zip(path, header | {"settings": settings}, arrays)
            assert refused(path, problem), settings
        for field in ("problem", "solver", "settings"):
            write_zip(path, {key: x for key, x in header.items() if key != field}, arrays)
            assert refused(path, problem), field
        write_zip(path, header | {"one more": 1}, arrays)
        assert refused(path, problem)


def test_checkpoints(tmp_path: Path) -> None:
    """One that is whole is taken up; with other contents it is refused by name."""
    problem, solver = MADE["problem_of"]("ppo"), swerve.PPO(**MADE["SMALL"])
    path, trainer = tmp_path / "right.checkpoint", solver.trainer(problem, 0)

    def begin() -> Run:
        return Run(solver, trainer, problem, MADE["task_of"]("ppo"), 0, path)

    first = begin()
    first._checkpoint.save(first._arrays() | {"history": np.ones((1, 6))})
    assert begin().history == [(1.0,) * 6]
    header, arrays = read_zip(path)
    state = first._state._replace(iteration=first._state.iteration - 5)
    wrong = {
        "start": arrays["start"][:, :1],
        "goal": np.full_like(arrays["goal"], np.nan),
        "history": arrays["history"][:, 1:],
        "state/0": arrays["state/0"][None],
        "best/0": arrays["best/0"].astype("U3"),
    }
    cases = [arrays | {name: array} for name, array in wrong.items()]
    cases += [arrays | {"history": arrays["history"].astype(kind)} for kind in WRONG_KINDS]
    cases += [arrays | {"history": NAN_ROW}]
    cases += [arrays | {f"state/{k}": array for k, array in to_arrays(state).items()}]
    cases += [{key: x for key, x in arrays.items() if key != name} for name in ("goal", "state/0")]
    for changed in cases:
        write_zip(path, header, changed)
        with pytest.raises(StoreError, match=r"right\.checkpoint: holds wrong contents"):
            begin()
    write_zip(path, {key: value for key, value in header.items() if key != "seed"}, arrays)
    with pytest.raises(ValueError, match="a checkpoint of another run: its seed is None"):
        begin()
