"""Mutants do not rot: what each of them breaks is still there, once."""

from __future__ import annotations

import pytest
from mutation_check import MUTANTS, ROOT, Mutant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what)
def test_what_a_mutant_breaks_is_there(mutant: Mutant) -> None:
    text = (ROOT / "src" / "swerve" / mutant.file).read_text()
    assert text.count(mutant.right) == 1
    assert (ROOT / "tests" / f"{mutant.tests.split()[0]}.py").exists()
