"""The documentation: its code runs as it stands, its links and pages are all there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from support.rooms import ROOMS, WITH_JAX

import swerve

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))


def python_blocks(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.slow
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
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.rglob("*.md")]
    for page in pages:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_paths_of_contributing_are_there() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    rooms = {path.name for path in (ROOT / "src" / "swerve").iterdir()}
    for path in re.findall(r"`([\w.]+/[\w./]*)`", text):
        room = path.partition("/")[0]
        place = ROOT / "src" / "swerve" / path if room in rooms else ROOT / path
        assert place.exists() or "NAME" in path or path == "site/", path


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_tables_of_packages_are_those_of_the_import_rule(page: str) -> None:
    rows = re.findall(r"^\| `(\w+)`.*?\| .*? \| (.*) \|$", (ROOT / page).read_text(), re.MULTILINE)
    assert [name for name, _ in rows] == list(ROOMS[: ROOMS.index("swerve")])
    for name, wing in rows:
        modules = re.findall(r"`(\w+)`", wing)
        with_jax = [f"{name}.{module}" for module in modules]
        if not modules and wing in ("JAX", "yes"):
            with_jax = [name]
        assert with_jax == [room for room in WITH_JAX if room.partition(".")[0] == name]


def test_what_architecture_points_at_is_there() -> None:
    section = (DOCS / "architecture.md").read_text().partition("## Where to find what")[2]
    rows = re.findall(r"`(\w+/[\w/]+\.py)`, `([\w.]+)`", section.partition("\n## ")[0])
    assert len(rows) > 10
    for path, name in rows:
        text = (ROOT / "src" / "swerve" / path).read_text()
        for part in name.split("."):
            assert re.search(rf"^ *(def |class )?{part}\b", text, re.MULTILINE), f"{path}: {part}"


def test_every_public_name_is_in_the_reference_once() -> None:
    pages = "".join(page.read_text() for page in REFERENCE)
    assert sorted(re.findall(r"^::: swerve\.(.*)$", pages, re.MULTILINE)) == sorted(swerve.__all__)
    index = (DOCS / "reference" / "index.md").read_text()
    assert sorted(re.findall(r"\[`\w+`\]\[swerve\.(\w+)\]", index)) == sorted(swerve.__all__)


def build(folder: Path, **changes: Any) -> None:
    """Build a documentation of one page in a folder, with the settings of `make docs`."""
    config = pytest.importorskip("mkdocs.config")
    commands = pytest.importorskip("mkdocs.commands.build")
    (folder / "pages").mkdir(exist_ok=True)
    if not (folder / "pages" / "index.md").exists():
        (folder / "pages" / "index.md").write_text("# Swerve\n")
    places = {"docs_dir": str(folder / "pages"), "site_dir": str(folder / "site")}
    few = {"nav": [{"Swerve": "index.md"}], "plugins": [], "theme": "mkdocs"}
    commands.build(config.load_config(str(ROOT / "mkdocs.yml"), **places, **few, **changes))


@pytest.mark.parametrize(
    ("page", "text"),
    [("forgotten.md", "# Left out of the navigation"), ("index.md", "[nowhere](missing.md)")],
)
def test_a_page_left_out_and_a_broken_link_stop_the_build(
    tmp_path: Path, page: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    build(tmp_path)
    assert (tmp_path / "site" / "index.html").exists()
    (tmp_path / "pages" / page).write_text(text)
    abort = pytest.importorskip("mkdocs.exceptions").Abort
    with pytest.raises(abort, match="strict"):
        build(tmp_path)


def test_hooks_are_tools_of_the_locked_environment() -> None:
    yaml = pytest.importorskip("yaml")
    repositories = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert [repository["repo"] for repository in repositories] == ["local"]
    for hook in repositories[0]["hooks"]:
        assert hook["language"] == "unsupported"  # run as it is: nothing is installed or fetched
        assert hook["entry"].startswith(".venv/bin/")


def test_what_the_fast_tests_leave_out_is_there() -> None:
    found = re.search(
        r"^SLOW_TESTS := ((?:.*\\\n)*.*)", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    assert found is not None
    for name in found[1].replace("\\\n", " ").split():
        assert (ROOT / "tests" / name).exists(), name
