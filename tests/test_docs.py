"""The code that the README and the how-to show runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


def python_blocks(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


def test_readme_and_how_to_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "readme"}
    for block in python_blocks(ROOT / "README.md"):
        exec(compile(block, "README.md", "exec", dont_inherit=True), names)
    shown = capsys.readouterr().out
    assert names["result"].headline in shown
    assert "rank" in shown
    assert not names["result"].struck_out[53]
    assert names["evidence"].effective_sample_size[0] > 1_000
    (tmp_path / "work").mkdir()
    names["evidence"].save("work/grid.seed0.smc.10000.evidence")
    for block in python_blocks(ROOT / "docs" / "how-to.md"):
        exec(compile(block, "how-to.md", "exec", dont_inherit=True), names)
    assert capsys.readouterr().out.count("rank") == 3


def test_links_lead_somewhere() -> None:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    for page in pages:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
