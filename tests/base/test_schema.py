"""Whatever a well-formed file holds, it is refused by name, or does no harm."""

from __future__ import annotations

import base64
import io
import os
import shutil
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.synthetic import make_evidence, make_record, make_samples
from support.wrong_contents import (
    read_zip,
    write_record,
    write_zip,
    wrong_files,
    wrong_json,
)

from swerve.answer import infer
from swerve.base import store
from swerve.base.store import StoreError
from swerve.constraints.base import Union
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.occupancy import Occupancy
from swerve.constraints.polygons import Polygon
from swerve.constraints.predicate import Predicate
from swerve.constraints.shapes import Ball, HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.evidence.evidence import KIND, VERSION, Evidence
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.windows import windows
from swerve.monitoring.foresight import Foresight
from swerve.problem.schema import stored_record
from swerve.work.folder import WorkFolder

STORED = Path(__file__).parents[1] / "data" / "before_packages"
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of large numbers in arithmetic


def outcome(use: Callable[[], object]) -> str:
    """Return whether use is refused, or does no harm; anything else fails the test."""
    try:
        use()
    except StoreError:
        return "refused"
    return "harmless"


def outcomes(cases: Iterable[tuple[str, Callable[[], object]]]) -> dict[str, list[str]]:
    """Return the cases by their outcome."""
    found: dict[str, list[str]] = {"refused": [], "harmless": []}
    for what, use in cases:
        try:
            found[outcome(use)].append(what)
        except Exception as error:
            pytest.fail(f"{what}: {type(error).__name__}: {error}")
    return found


class TestEvidence:
    @pytest.mark.parametrize("name", ["sampled", "exact"])
    def test_wrong_contents(self, tmp_path: Path, name: str) -> None:
        path, source = tmp_path / "wrong.evidence", tmp_path / "right.evidence"
        if name == "exact":
            source = STORED / "tabular.evidence"
        else:
            record = make_record(known=(Box(x=(9.5, 9.7)),))
            make_evidence(record, samples=make_samples(40)).save(source)

        def use(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
            write_zip(path, header, arrays)
            evidence = Evidence.load(path)
            infer(evidence).table()
            shape = evidence.num_tasks, evidence.num_trajectories
            assert evidence.samples.total_reward.shape == shape
            if evidence.problem.beta < 1e300:  # what a reward is worth then, no number holds
                assert not np.isnan(evidence.log_weight).any()

        files = wrong_files(source)
        if name == "exact":  # the problem of one kind of evidence is enough
            files = (file for file in files if "$.problem." not in file[0])
        found = outcomes((what, partial(use, *parts)) for what, *parts in files)
        assert len(found["refused"]) > 300
        assert len(found["harmless"]) < 0.7 * len(found["refused"])

    def test_what_was_refused_is_said(self, tmp_path: Path) -> None:
        path = tmp_path / "a.evidence"
        make_evidence().save(path)
        header, arrays = read_zip(path)
        for change, message in {
            ("beta", -1.0): r"Expected `float` > 0.0 - at `\$.beta`",
            ("num_steps", "5"): r"Expected `int`, got `str` - at `\$.num_steps`",
            ("between_states", 1): r"Expected `bool`, got `int` - at `\$.between_states`",
            ("color", "red"): r"Object contains unknown field `color`",
            ("goal_names", ("x", "x")): r"names that are used twice: x, x",
        }.items():
            name, value = change
            write_zip(path, header | {"problem": header["problem"] | {name: value}}, arrays)
            with pytest.raises(StoreError, match=f"a.evidence: holds wrong contents: {message}"):
                Evidence.load(path)
        log_ratio = arrays["summary/log_ratio"]
        for array, message in (
            (log_ratio[:, 1:], r"'summary/log_ratio' has shape \(3, 11\), expected \(3, 12\)"),
            (log_ratio.astype(int), r"'summary/log_ratio' is of type int64"),
            (np.full_like(log_ratio, np.nan), r"'.*': expected finite numbers or -inf"),
            (None, r"'summary/log_ratio' is missing"),
        ):
            changed = {name: x for name, x in arrays.items() if name != "summary/log_ratio"}
            write_zip(
                path, header, changed if array is None else arrays | {"summary/log_ratio": array}
            )
            with pytest.raises(
                StoreError, match=f"wrong contents: array {message}.*it was; make it"
            ):
                Evidence.load(path)


def every_kind() -> list[Any]:
    """Constraints of every kind that can be stored, with states theta and x and action u."""
    walls = Occupancy("walls", np.eye(3, dtype=bool), (0.0, 0.0), 1.0, ("x", "y"))
    box = Box(x=(-np.inf, 1.0), theta=(0.0, 1.0))
    triangle = Polygon([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], ("x", "y"))
    return [
        box,
        ActionBox(u=(0.0, 1.0)),
        Ball(1.0, x=2.0),
        HalfSpace(1.0, x=1.0, y=-1.0),
        triangle,
        StateAction(box, ActionBox(u=(0.0, 1.0))),
        walls,
        Predicate("fast", lambda states: states[..., 0] > 0.0),
        Union("both", [box, triangle]),
    ]


@pytest.mark.parametrize("kind", ["constraints", "windows", "grid", "table"])
def test_records_of_problems(kind: str) -> None:
    record = make_record()
    data = record.to_json()
    data["space"] |= {
        "names": ["theta", "x", "y"],
        "bounds": [*data["space"]["bounds"], [0.0, 9.0]],
    }
    match kind:
        case "constraints":
            data["hypotheses"] = ConstraintHypotheses(every_kind()).to_json()
            data["known"] = [constraint.to_json() for constraint in every_kind()]
        case "windows":
            data["hypotheses"] = windows(2, x=(0.0, 9.0, 3.0)).to_json()
        case "table":
            data["transitions"] = [[2, 1, 1], [[0, 1, -1], [1, 0, 0]], [[0.0], [1.0], [2.0]]]
    right = stored_record("a", data).to_json()
    assert right | {"is_timed": True} == data | {"is_timed": True}

    def use(changed: Any) -> None:
        found = stored_record("a", changed)
        assert len(found.fingerprint) == 64
        assert found.summary

    found = outcomes((what, partial(use, changed)) for what, changed in wrong_json(data))
    assert len(found["refused"]) > 300
    assert len(found["harmless"]) < 0.5 * len(found["refused"])


def test_foresight(tmp_path: Path) -> None:
    record = Evidence.load(STORED / "grid.evidence").problem
    path = tmp_path / "wrong.foresight"

    def use(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        write_zip(path, header, arrays)
        foresight = Foresight.load(path, record)
        assert foresight.log_avoid(np.zeros(2), np.array(0.0), np.zeros(2)).shape == (30,)
        for goal in foresight.goals[:1]:
            assert foresight.towards(goal)(np.zeros(2), 0).shape == (30,)

    files = wrong_files(STORED / "grid.foresight")
    found = outcomes((what, partial(use, *parts)) for what, *parts in files)
    assert len(found["refused"]) > 300


def test_work_folders(tmp_path: Path) -> None:
    shutil.copytree(STORED / "work", tmp_path / "work")
    folder = WorkFolder(tmp_path / "work", "pendulum?max_torque=10")
    path = folder.path / "problem.json"
    data, others = store.read_json(path), []

    def use(changed: Any) -> None:
        write_record(path, changed)
        try:
            found = folder.read()
        except StoreError:
            raise
        except ValueError as error:
            others.append(str(error))
            return
        if found.record is not None:
            folder.read_evidence(found.settings.completed(found.settings), found.record)

    cases = [*wrong_json(data), *((name, name) for name in ("text", 1, None))]
    found = outcomes((str(what), partial(use, changed)) for what, changed in cases)
    assert len(found["refused"]) > 300
    assert all("holds the results of" in text for text in others)


@pytest.mark.parametrize(
    "source", ["/dev/zero", "/dev/stdin", "pipe", "\x00", "a" * 5000, "/proc/kmsg", "folder"]
)
def test_a_source_that_is_no_file_is_missing(tmp_path: Path, source: str) -> None:
    """A record of others may name anything: nothing of it is waited for, or read without end."""

    os.mkfifo(tmp_path / "pipe")
    shutil.copytree(STORED / "work", tmp_path / "work")
    folder = WorkFolder(tmp_path / "work", "pendulum?max_torque=10")
    path = folder.path / "problem.json"
    name = str(tmp_path / source) if source in ("pipe", "folder") else source
    write_record(path, store.read_json(path) | {"sources": {name: "0" * 64}})
    assert folder.read().changes == (f"{name} has changed",)


class TestSizes:
    """Reading takes no more memory than the file has bytes."""

    def test_compressed_parts_are_refused(self, tmp_path: Path) -> None:

        path = tmp_path / "a.evidence"
        make_evidence().save(path)
        header, arrays = read_zip(path)
        write_zip(path, header, arrays)
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(name, content)
        with pytest.raises(StoreError, match=r"altered: 'header.json' is compressed"):
            Evidence.load(path)

    def test_an_array_of_another_size_than_its_bytes_is_refused(self, tmp_path: Path) -> None:
        """Before it is allocated: this one would have 8 EB."""

        path = tmp_path / "a"
        store.write(path, KIND, VERSION, {}, {"x": np.zeros(3)})
        with zipfile.ZipFile(path) as archive:
            header = archive.read("header.json")
        stream = io.BytesIO()
        shape = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 10**9)}
        np.lib.format.write_array_header_1_0(stream, shape)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("header.json", header)
            archive.writestr("x.npy", stream.getvalue() + bytes(24))
        with (
            store.open_file(path, KIND, VERSION) as stored,
            pytest.raises(
                StoreError, match=r"array 'x' cannot be read \(shape .* are not those of 24 bytes\)"
            ),
        ):
            stored.array("x")

    def test_parts_larger_than_the_file_are_refused(self, tmp_path: Path) -> None:
        """Members that lie over one another: a small file with many large parts."""

        path = tmp_path / "a"
        names = [f"x{k}" for k in range(50)]
        with zipfile.ZipFile(path, "w") as archive:
            store_header = f'{{"format": "{KIND}", "version": {VERSION}, "arrays": {names}}}'
            archive.writestr("header.json", store_header.replace("'", '"'))
            archive.writestr("x0.npy", bytes(10_000))
            first = archive.getinfo("x0.npy")
            for name in names[1:]:
                again = zipfile.ZipInfo(f"{name}.npy")
                again.header_offset, again.CRC = first.header_offset, first.CRC
                again.file_size = again.compress_size = first.file_size
                archive.filelist.append(again)
                archive.NameToInfo[again.filename] = again
        with pytest.raises(StoreError, match="its parts have more bytes than the file"):
            store.open_file(path, KIND, VERSION)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("[" * 100_000 + "]" * 100_000, "nested more than 100 deep"),
            ('{"a":' * 100_000, "nested more than 100 deep"),
            ("[NaN]", "NaN is no number of JSON"),
            ("1" * 5000, "Exceeds the limit"),
        ],
    )
    def test_json_without_limits_is_refused(self, tmp_path: Path, text: str, message: str) -> None:
        path = tmp_path / "record.json"
        path.write_text(f'{{"crc32": "00000000", "data": {text}}}')
        with pytest.raises(StoreError, match=f"cut short or altered, not JSON .{message}"):
            store.read_json(path)

    def test_a_record_of_too_many_bytes_is_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "record.json"
        store.write_json(path, ["x" * 1000])
        monkeypatch.setattr("swerve.base.json_text.MAX_BYTES", 1000)
        with pytest.raises(StoreError, match=r"not JSON .more than 1,000 bytes"):
            store.read_json(path)
        with pytest.raises(ValueError, match="more than 1,000 bytes"):
            store.write_json(path, ["x" * 1000])

    def test_brackets_in_texts_are_no_depth(self, tmp_path: Path) -> None:
        path = tmp_path / "record.json"
        data = {"[" * 200: '\\"' + "{" * 200}
        store.write_json(path, data)
        assert store.read_json(path) == data

    def test_a_map_is_no_larger_than_it_says(self) -> None:

        data = Occupancy("walls", np.eye(3, dtype=bool), (0.0, 0.0), 1.0).to_json()
        bomb = base64.b64encode(zlib.compress(bytes(10**7))).decode()
        for change, message in (
            ({"blocked": bomb}, "not a map of 3 x 3 cells"),
            ({"shape": [30, 30]}, "not a map of 30 x 30 cells"),
            ({"shape": [10**5, 10**5]}, "a map of 100000 x 100000 cells is too large"),
        ):
            with pytest.raises(ValueError, match=message):
                Occupancy.from_json(data | change)


@pytest.mark.parametrize("name", ["x.evidence", "problem.json"])
def test_a_pipe_in_a_work_folder_is_refused_at_once(tmp_path: Path, name: str) -> None:

    path = tmp_path / name
    os.mkfifo(path)
    read = store.read_json if name.endswith("json") else Evidence.load
    with pytest.raises(OSError, match=f"{name}: expected a file, got a pipe: name another file"):
        read(path)
