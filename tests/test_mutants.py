"""Mutants do not rot: what each of them breaks is still there, once."""

from __future__ import annotations

import re

import pytest
from mutation_check import MARKERS, MUTANTS, ROOT, Mutant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what)
def test_what_a_mutant_breaks_is_there(mutant: Mutant) -> None:
    text = (ROOT / "src" / "swerve" / mutant.file).read_text()
    assert text.count(mutant.right) == 1
    assert (ROOT / "tests" / f"{mutant.tests.split()[0]}.py").exists()


def test_the_page_lists_them() -> None:
    first, last = MARKERS
    page = (ROOT / "docs" / "testing.md").read_text()
    table = page.partition(first)[2].partition(last)[0]
    rows = re.findall(r"^\| (.+) \| `(\S+\.py)` \| `(\S+\.py)::.*` \|$", table, re.MULTILINE)
    assert [row[:2] for row in rows] == [(mutant.what, mutant.file) for mutant in MUTANTS]
    for _, _, test in rows:
        assert (ROOT / "tests" / test).exists(), test
