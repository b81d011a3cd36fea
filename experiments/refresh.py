"""Put the tables that `swerve reproduce` wrote into the pages that show them.

    python experiments/refresh.py [--check]

A page shows a table between two comments,

    <!-- from docs/results/NAME/TABLE.md -->
    <!-- end -->

and what stands between them is replaced by the file. With --check nothing is written; the pages
that are out of date are named, and the exit status is 1 if there are any.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"(<!-- from (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages() -> list[Path]:
    """Return the pages that may show results."""
    return [ROOT / "docs" / "results.md", *sorted((ROOT / "experiments").glob("*/README.md"))]


def refreshed(page: str) -> str:
    """Return a page with every table as it is in its file."""
    return BLOCK.sub(lambda found: found[1] + (ROOT / found[2]).read_text() + found[3], page)


def main() -> None:
    """Refresh all pages, or name those that are out of date."""
    old = [path for path in pages() if refreshed(path.read_text()) != path.read_text()]
    for path in old:
        print(path.relative_to(ROOT))
        if "--check" not in sys.argv:
            path.write_text(refreshed(path.read_text()))
    sys.exit("--check" in sys.argv and bool(old))


if __name__ == "__main__":
    main()
