"""Break the library on purpose, one place at a time, and see that a test notices.

    python tests/mutation_check.py [--write docs/testing.md]

Each mutant replaces one piece of text in a copy of the sources and runs one test module, stopping
at its first failure. A mutant that survives is a hole in the tests: the exit status is then 1. The
table of docs/testing.md between the two markers is what --write writes.
"""

from __future__ import annotations

import argparse
import functools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

from mutants.mutant import Mutant

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 900.0  # s
PACKAGES = (  # those of src/swerve that have mutants, in the order of the table
    "base",
    "constraints",
    "demonstrations",
    "hypotheses",
    "simulation",
    "evidence",
    "inference",
    "trust",
    "solvers",
    "sampling",
    "fitting",
    "monitoring",
)
MUTANTS: tuple[Mutant, ...] = tuple(
    mutant for name in PACKAGES for mutant in import_module(f"mutants.{name}").MUTANTS
)
MARKERS = "<!-- mutants -->\n", "<!-- end of mutants -->\n"


def caught_by(mutant: Mutant) -> str | None:
    """Return the first test that fails on a mutant, or None if it survives.

    Raises:
      ValueError: if the text to replace is not there exactly once, or tests fail without it.
    """
    if first_failure(mutant.tests, ROOT / "src") is not None:
        raise ValueError(f"{mutant.tests}: fails on the library as it is")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        path = copy / "swerve" / mutant.file
        text = path.read_text()
        if text.count(mutant.right) != 1:
            raise ValueError(
                f"{mutant.file}: expected once, found {text.count(mutant.right)} times:"
                f" {mutant.right!r}"
            )
        path.write_text(text.replace(mutant.right, mutant.wrong))
        return first_failure(mutant.tests, copy)


@functools.cache
def first_failure(tests: str, sources: Path) -> str | None:
    """Return the first test that fails on some sources, or None."""
    module, *options = tests.split()
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, "-W", "default", f"tests/{module}.py", *options],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(sources)},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    failed = re.search(r"^FAILED tests/(.+?)(?: - |$)", done.stdout, re.MULTILINE)
    if done.returncode and not failed:
        raise ValueError(f"{tests}: no test failed, and yet:\n{done.stdout[-2000:]}")
    return failed[1] if failed else None


def main() -> None:
    """Try every mutant and print which test catches it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", type=Path, help="page whose table to write")
    page = parser.parse_args().write
    rows = ["| what is done wrong | where | caught by |", "|---|---|---|"]
    survivors = 0
    for mutant in MUTANTS:
        test = caught_by(mutant)
        survivors += test is None
        print(f"{'SURVIVES' if test is None else 'caught'}: {mutant.what} [{mutant.file}] {test}")
        rows.append(f"| {mutant.what} | `{mutant.file}` | `{test}` |")
    print(f"{len(MUTANTS) - survivors} of {len(MUTANTS)} mutants caught")
    if page is not None:
        first, last = MARKERS
        before, _, rest = page.read_text().partition(first)
        after = rest.partition(last)[2]
        page.write_text(before + first + "\n".join(rows) + "\n" + last + after)
    sys.exit(1 if survivors else 0)


if __name__ == "__main__":
    main()
