"""Folders of slow results: their scale and version, and wall times."""

from __future__ import annotations

from pathlib import Path

import pytest

from swerve.demonstrators.path_search import Search
from swerve.reproduce import keeping, kept_demonstrations
from swerve.reproduce.keeping import Clock, Keeping
from swerve.systems.pendulum import pendulum


def test_interrupted_times_add_up_and_finished_ones_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(keeping.time, "perf_counter", lambda: now[0])
    path = tmp_path / "seconds.json"

    def interrupted() -> None:
        with Clock(path).timing("learn"):
            now[0] += 3.0
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with Clock(path).timing("learn"):
        now[0] += 4.0
    with Clock(path).timing("learn"):
        now[0] += 50.0  # a later run, which loads the finished result
    with Clock(path).timing("sample"):
        now[0] += 0.5
    assert Clock(path).seconds == {"learn": 7.0, "sample": 0.5}
    for of in ("others", "others"):  # other inputs are timed again, once
        with Clock(path).timing("sample", of):
            now[0] += 2.0
    assert Clock(path).seconds == {"learn": 7.0, "sample": 2.0}


def test_what_others_made_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Keeping.at(tmp_path, "quick", (1, 2), 0, False)
    assert Keeping.at(tmp_path, "quick", (1, 2), 0, False).folder == made.folder
    others = [Keeping.at(tmp_path, "full", (1, 3), 0, False)]
    others.append(Keeping.at(tmp_path, "quick", (1, 2), 1, False))
    assert len({made.folder, *(one.folder for one in others)}) == 3
    with pytest.raises(ValueError, match=r"quick.seed0: was filled by another .* other settings"):
        Keeping.at(tmp_path, "quick", (1, 3), 0, False)
    monkeypatch.setattr(keeping, "version", lambda name: "0.0.0")
    with pytest.raises(ValueError, match="filled by another version of Swerve"):
        Keeping.at(tmp_path, "quick", (1, 2), 0, False)


def test_no_demonstrations_are_made_for_a_link_that_leads_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Keeping.at(tmp_path, "quick", 1, 0, False)
    (made.folder / "shown").symlink_to(tmp_path / "gone")
    monkeypatch.setattr(kept_demonstrations, "_optima", lambda *arguments: pytest.fail("made"))
    with pytest.raises(FileExistsError, match="shown is a link that leads nowhere; remove it or"):
        kept_demonstrations.kept_optima(made, "shown", pendulum(), 0, 1, Search())
