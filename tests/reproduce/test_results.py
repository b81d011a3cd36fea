"""Every number of the results pages comes from a file that `swerve reproduce` wrote."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFRESH = runpy.run_path(str(ROOT / "experiments" / "refresh.py"))
NAMES = re.compile(r"figures? \d( and \d)?|\b(19|20)\d\d\b|\bC[12]\b|2 x 14|10 x 10|95 %|-D\b")


def prose(page: str) -> str:
    """A page without its tables from files, commands, code and the targets of links."""
    page = REFRESH["BLOCK"].sub("", page)
    page = re.sub(r"^(    |```).*$", "", page, flags=re.MULTILINE)
    page = re.sub(r"`[^`]*`|\]\([^)]*\)", "", page)
    return NAMES.sub("", page)


@pytest.mark.parametrize("page", REFRESH["pages"](), ids=lambda page: page.parent.name)
def test_pages_show_the_files(page: Path) -> None:
    text = page.read_text()
    assert REFRESH["refreshed"](text) == text, "run python experiments/refresh.py"


def test_no_number_is_written_by_hand() -> None:
    page = prose((ROOT / "docs" / "results.md").read_text())
    assert re.findall(r".{0,30}\d.{0,30}", page) == []


def test_a_number_that_parts_from_its_file_is_found() -> None:
    page = (ROOT / "docs" / "results.md").read_text()
    block = REFRESH["BLOCK"].search(page)
    assert block is not None
    digit = re.search(r"\d", block[0][block[0].index("-->") :])
    assert digit is not None
    place = block.start() + block[0].index("-->") + digit.start()
    other = page[:place] + str((int(page[place]) + 1) % 10) + page[place + 1 :]
    assert REFRESH["refreshed"](other) == page != other
    assert re.search(r"\d", prose("The first is 3 nats ahead."))


def test_every_table_and_figure_is_shown() -> None:
    page = (ROOT / "docs" / "results.md").read_text()
    readmes = "".join(path.read_text() for path in REFRESH["pages"]())
    for path in sorted((ROOT / "docs" / "results").glob("*/*")):
        if path.suffix == ".md":
            assert f"from docs/results/{path.parent.name}/{path.name}" in page
        elif path.suffix == ".png":
            assert f"results/{path.parent.name}/{path.name}" in readmes
