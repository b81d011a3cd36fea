"""Put the tables that `swerve reproduce` wrote into the pages that show them.

    python experiments/refresh.py

A page shows a table between two comments,

    <!-- from docs/results/NAME/TABLE.md -->
    <!-- end -->

and the file replaces the text between the comments. The script prints the pages that it changed.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"(<!-- from (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages() -> list[Path]:
    """Return the pages that may show results."""
    return [ROOT / "docs" / "results.md", *sorted((ROOT / "experiments").glob("*/README.md"))]


def refreshed(page: str) -> str:
    """Return a page with every table replaced by its file."""
    return BLOCK.sub(lambda found: found[1] + (ROOT / found[2]).read_text() + found[3], page)


def main() -> None:
    """Refresh all pages."""
    for path in pages():
        page = path.read_text()
        if refreshed(page) != page:
            print(path.relative_to(ROOT))
            path.write_text(refreshed(page))


if __name__ == "__main__":
    main()
