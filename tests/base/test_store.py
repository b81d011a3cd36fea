"""Stored files: what was written is read back, and anything else is refused."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.stored_files import (
    ARRAYS,
    HEADER,
    KIND,
    VERSION,
    assert_same,
    child_environment,
    flips,
    read,
    refuses,
)

from swerve.base import store

dtypes = st.one_of(
    hnp.boolean_dtypes(),
    hnp.integer_dtypes(endianness="?"),
    hnp.unsigned_integer_dtypes(endianness="?"),
    hnp.floating_dtypes(endianness="?"),
    hnp.complex_number_dtypes(endianness="?"),
    hnp.unicode_string_dtypes(endianness="?"),
)


def write_zip(path: Path, members: dict[str, bytes | str]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def test_reads_back_what_was_written(path: Path) -> None:
    assert_same(read(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


@given(
    array=st.one_of(
        hnp.arrays(dtypes, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)),
    ),
    fortran=st.booleans(),
)
def test_round_trip_of_arrays(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray, fortran: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "array.swerve"
    if fortran:
        array = np.asfortranarray(array)
    store.write(path, KIND, VERSION, {}, {"a": array})
    with store.open_file(path, KIND, VERSION) as stored:
        back = stored.array("a")
    assert back.dtype == array.dtype
    assert back.tobytes() == array.tobytes()
    np.testing.assert_array_equal(back, array, strict=True)


def test_round_trip_of_views_and_scalars(tmp_path: Path) -> None:
    arrays = {"strided": np.arange(12).reshape(3, 4)[::2, ::-1], "scalar": np.float64(2.5)}
    store.write(tmp_path / "f", KIND, VERSION, {}, arrays)
    with store.open_file(tmp_path / "f", KIND, VERSION) as stored:
        np.testing.assert_array_equal(stored.array("strided"), [[3, 2, 1, 0], [11, 10, 9, 8]])
        assert stored.array("scalar") == 2.5
        stored.array("strided")[0, 0] = 7  # a copy of its own that may be changed


def test_equal_contents_make_equal_files(path: Path, tmp_path: Path) -> None:
    store.write(tmp_path / "again", KIND, VERSION, HEADER, ARRAYS)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_other_tools_read_the_file(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        assert json.loads(archive.read("header.json"))["format"] == KIND
        assert {info.compress_type for info in archive.infolist()} == {zipfile.ZIP_STORED}
    with np.load(path, allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["bits"], ARRAYS["bits"])


def test_importing_loads_neither_jax_nor_polars_nor_zipfile() -> None:
    code = (
        "import sys; before = set(sys.modules);"
        "import swerve.base.store, swerve.demonstrations.demonstration;"
        "new = {name.split('.')[0] for name in set(sys.modules) - before};"
        "assert not new & {'jax', 'polars', 'zipfile', 'tempfile', 'hashlib'}, new;"
        "swerve = {name for name in sys.modules if name.startswith('swerve.')};"
        "names = 'arguments decimals files imports interrupts json_text phrases space store';"
        "names = [*names.split(), 'version'];"
        "base = {f'base.{name}' for name in names};"
        "read = ('checks', 'csv_format', 'demonstration', 'durations', 'formats', 'headers',"
        "    'parquet_format', 'recordings', 'tables');"
        "ours = {'base', 'demonstrations'} | base | {f'demonstrations.{name}' for name in read};"
        "assert swerve == {f'swerve.{name}' for name in ours}, swerve"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=child_environment(), timeout=60)


def test_any_altered_byte_is_refused_or_harmless(path: Path) -> None:
    content = path.read_bytes()
    refused = 0
    for altered in flips(content):
        path.write_bytes(altered)
        refused += refuses(lambda path: assert_same(read(path)), path)
    assert refused > len(content)  # most bytes matter


def test_any_cut_is_refused(path: Path) -> None:
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(store.StoreError, match=r"cut short or altered.*left as it was; copy"):
            read(path)
        assert path.read_bytes() == content[:length]


def test_each_array_is_verified_on_its_own(path: Path) -> None:
    content = path.read_bytes()
    data = ARRAYS["bits"].tobytes()
    assert content.count(data) == 1
    path.write_bytes(content.replace(data, data[:-1] + b"x"))
    with store.open_file(path, KIND, VERSION) as stored:
        stored.array("summary/log_ratio")
        with pytest.raises(store.StoreError, match=r"evidence.swerve: altered \(Bad CRC-32"):
            stored.array("bits")


def test_an_array_left_out_is_noticed(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    write_zip(path, {name: data for name, data in members.items() if name != "bits.npy"})
    with pytest.raises(store.StoreError, match="expected the arrays summary/log_ratio, bits, emp"):
        read(path)


def test_what_was_opened_stays_readable_when_it_is_replaced(path: Path) -> None:
    with store.open_file(path, KIND, VERSION) as stored:
        store.write(path, KIND, VERSION, {}, {"bits": np.zeros(9)})
        np.testing.assert_array_equal(stored.array("bits"), ARRAYS["bits"])


@pytest.mark.parametrize("content", [b"t,theta\n0,1\n", b"PKtheta", b"\x00" * 100])
def test_refuses_other_files(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(store.StoreError, match=r"not a Swerve file.*left as it was; give a file"):
        read(path)


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"other.txt": "x"}, "not a Swerve file, or altered: it has no header.json"),
        ({"header.json": "{}"}, "header.json lacks one of format, version, arrays"),
        ({"header.json": "[1]"}, "expected a JSON object"),
        ({"header.json": '{"format"'}, "cut short or altered, not JSON"),
    ],
)
def test_refuses_other_archives(path: Path, members: dict[str, str], message: str) -> None:
    write_zip(path, dict(members))
    with pytest.raises(store.StoreError, match=message):
        read(path)


def test_refuses_another_kind(path: Path) -> None:
    with pytest.raises(
        store.StoreError,
        match=r"evidence.swerve: expected a file of kind 'nominal', got 'evidence'. The file was",
    ):
        store.open_file(path, "nominal", VERSION)


def test_refuses_a_newer_version(path: Path) -> None:
    with pytest.raises(
        store.StoreError, match=r"version 3 of kind 'evidence', this swerve reads 2\..*upgrade swe"
    ):
        store.open_file(path, KIND, VERSION - 1)


def test_refuses_an_older_version(path: Path) -> None:
    with pytest.raises(
        store.StoreError, match=r"version 3 of .* reads 4 and no longer version 3.*make it again"
    ):
        store.open_file(path, KIND, VERSION + 1)


def test_names_the_arrays_when_one_is_missing(path: Path) -> None:
    with (
        store.open_file(path, KIND, VERSION) as stored,
        pytest.raises(store.StoreError, match=r"no array 'x', only summary/log_ratio, bits, empty"),
    ):
        stored.array("x")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.swerve"):
        store.open_file(tmp_path / "nothing.swerve", KIND, VERSION)
    with pytest.raises(FileNotFoundError, match=r"nothing\.json"):
        store.read_json(tmp_path / "nothing.json")


class Bomb:
    """Unpickling it is seen."""

    exploded = False

    def __reduce__(self) -> tuple[Any, ...]:
        return (setattr, (Bomb, "exploded", True))


@pytest.mark.parametrize(
    "array",
    [
        np.array([None]),
        np.array([Bomb()]),
        np.zeros(2, dtype=[("a", "O")]),
        np.zeros(2, dtype=[("a", "f8")]),
        np.array(["2026-01-01"], dtype="datetime64[D]"),
        np.array([b"bytes"]),
    ],
)
def test_refuses_to_write_anything_but_numbers_and_text(path: Path, array: np.ndarray) -> None:
    with pytest.raises(ValueError, match="array 'x': cannot store dtype"):
        store.write(path, KIND, VERSION, {}, {"x": array})
    assert_same(read(path))


def test_refuses_to_unpickle(path: Path) -> None:
    header = json.dumps({"format": KIND, "version": VERSION, "arrays": ["x"]})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.json", header)
        with archive.open("x.npy", "w") as member:
            np.lib.format.write_array(member, np.array([Bomb()]), allow_pickle=True)
    with (
        store.open_file(path, KIND, VERSION) as stored,
        pytest.raises(store.StoreError, match=r"array 'x' cannot be read.*Object arrays"),
    ):
        stored.array("x")
    assert not Bomb.exploded


@pytest.mark.parametrize("name", ["", "../up", "/top", "a//b", "a b", "a\x00", ".hidden", "a/"])
def test_refuses_array_names_that_are_not_file_names(path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="expected letters, digits"):
        store.write(path, KIND, VERSION, {}, {name: np.zeros(1)})
    assert_same(read(path))


@pytest.mark.parametrize("key", ["format", "version", "arrays"])
def test_refuses_reserved_header_keys(path: Path, key: str) -> None:
    with pytest.raises(ValueError, match=f"format, version, arrays are taken, got .'{key}'"):
        store.write(path, KIND, VERSION, {key: 1}, {})
    assert_same(read(path))


def test_refuses_headers_that_are_not_json(path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.write(path, KIND, VERSION, {"beta": float("nan")}, {})
    with pytest.raises(TypeError, match="not JSON serializable"):
        store.write(path, KIND, VERSION, {"beta": np.float32(1)}, {})
    assert_same(read(path))
