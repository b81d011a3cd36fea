"""The exact nominal distribution of the walks for the tests of this folder."""

from __future__ import annotations

import pytest
from support.walks import PROBLEM

from swerve import learn
from swerve.solvers.exact.tabular import TableNominal


@pytest.fixture(scope="session")
def nominal() -> TableNominal:
    found = learn(PROBLEM, "tabular")
    assert isinstance(found, TableNominal)
    return found
