import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from swerve.base import store

KIND, VERSION = "evidence", 3
HEADER = {"swerve": "0.1.0", "beta": 0.67, "names": ["theta", "omega"], "none": None}
ARRAYS = {
    "summary/log_ratio": np.array([[0.5, -1.25]]),
    "bits": np.arange(5, dtype=np.uint8),
    "empty": np.zeros((0, 3), np.float32),
}
NOBODY = 65534

dtypes = st.one_of(
    hnp.boolean_dtypes(),
    hnp.integer_dtypes(endianness="?"),
    hnp.unsigned_integer_dtypes(endianness="?"),
    hnp.floating_dtypes(endianness="?"),
    hnp.complex_number_dtypes(endianness="?"),
    hnp.unicode_string_dtypes(endianness="?"),
)
json_data = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "evidence.swerve"
    store.write(path, KIND, VERSION, HEADER, ARRAYS)
    return path


def read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    with store.open_file(path, KIND, VERSION) as stored:
        return stored.header, {name: stored.array(name) for name in stored.names}


def assert_same(content: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    header, arrays = content
    assert header == HEADER
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array, strict=True)


def write_zip(path: Path, members: dict[str, bytes | str]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


@contextmanager
def without_privileges() -> Iterator[Path]:
    """Yield a folder that others own, seen by a user whom permission bits bind."""
    with tempfile.TemporaryDirectory() as name:  # pytest's own folders are closed to other users
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "theirs").mkdir(mode=0o755)
        (folder / "ours").mkdir()
        (folder / "ours").chmod(0o777)
        user = os.geteuid()
        if user == 0:
            os.seteuid(NOBODY)
        else:
            (folder / "theirs").chmod(0o555)
        try:
            yield folder
        finally:
            os.seteuid(user)
            (folder / "theirs").chmod(0o755)


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
        "ours = ('store', 'demonstrations', 'space', 'state_checks', 'tables');"
        "assert swerve == {f'swerve.{name}' for name in ours}, swerve"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=child_environment(), timeout=60)


def refuses(read: Callable[[Path], Any], path: Path) -> bool:
    """Return whether reading is refused; then the message has to say what is needed."""
    content = path.read_bytes()
    message = None
    try:
        read(path)
    except store.StoreError as error:
        message = str(error)
    assert path.read_bytes() == content
    assert message is None or (message.startswith(f"{path}: ") and "left as it was; " in message)
    return message is not None


def flips(content: bytes) -> Iterator[bytes]:
    for position in range(len(content)):
        for flip in (0x01, 0xFF):
            altered = bytearray(content)
            altered[position] ^= flip
            yield bytes(altered)


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
        store.StoreError, match=r"version 3 of .* reads 4 and no longer that one.*make it again"
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


def test_a_full_disk_leaves_the_old_file(path: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limit[1]))
    try:
        with pytest.raises(
            OSError, match=r"cannot write evidence.swerve in /.*too large; choose a"
        ):
            store.write(path, KIND, VERSION, {}, {"big": np.zeros(100_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert_same(read(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interruption_leaves_the_old_file(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    def interrupt(_: int) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(error):
        store.write(path, KIND, VERSION, {}, {})
    monkeypatch.undo()
    assert_same(read(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_writing_flushes_file_and_folder_to_the_disk(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed = []

    def record(descriptor: int) -> None:
        is_folder = os.path.samestat(os.fstat(descriptor), path.parent.stat())
        replaced = os.fstat(descriptor).st_ino == path.stat().st_ino
        flushed.append((is_folder, replaced))

    monkeypatch.setattr(os, "fsync", record)
    store.write(path, KIND, VERSION, {}, {})
    assert flushed == [(False, False), (True, False)]  # the file before it takes its place


def test_a_leftover_confuses_nobody_and_goes_with_the_next_write(path: Path) -> None:
    leftover = path.with_name(f".{path.name}.tmp")
    leftover.write_bytes(b"x" * 100_000)
    assert_same(read(path))
    store.write(path, KIND, VERSION, HEADER, ARRAYS)
    assert_same(read(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_concurrent_writers_leave_one_whole_content(path: Path) -> None:
    failures = []

    def write(number: int) -> None:
        try:
            for _ in range(20):
                store.write(path, KIND, VERSION, {"n": number}, {"a": np.full(2000, number)})
                header, arrays = read(path)
                assert (arrays["a"] == header["n"]).all()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def child_environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def test_a_killed_writer_leaves_the_old_or_the_new_content(tmp_path: Path) -> None:
    code = (
        "import itertools, sys, numpy as np; from swerve import store\n"
        "for n in itertools.count():\n"
        "    arrays = {'a': np.full(300_000, n), 'b': np.full(7, n)}\n"
        f"    store.write(sys.argv[1], {KIND!r}, {VERSION}, {{'n': n}}, arrays)"
    )
    paths = [tmp_path / str(number) / "f.swerve" for number in range(12)]
    rng = random.Random(0)
    interrupted = 0
    for group in (paths[:6], paths[6:]):
        children = [
            subprocess.Popen([sys.executable, "-c", code, str(path)], env=child_environment())
            for path in group
        ]
        try:
            deadline = time.monotonic() + 60
            while not all(path.exists() for path in group) and time.monotonic() < deadline:
                time.sleep(0.01)
            for child in children:
                time.sleep(rng.uniform(0.0, 0.05))
                child.send_signal(signal.SIGKILL)
        finally:
            for child in children:
                child.kill()
                assert child.wait() == -signal.SIGKILL
    for path in paths:
        header, arrays = read(path)
        assert (arrays["a"] == header["n"]).all()
        assert (arrays["b"] == header["n"]).all()
        interrupted += len(list(path.parent.iterdir())) - 1
        store.write(path, KIND, VERSION, HEADER, ARRAYS)
        assert_same(read(path))
        assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert interrupted > 0  # else the test has tested nothing


def test_a_missing_folder_is_made(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "f.swerve"
    store.write(path, KIND, VERSION, HEADER, ARRAYS)
    assert_same(read(path))


def test_a_folder_of_others_is_named_with_what_to_do() -> None:
    with without_privileges() as folder:
        theirs = folder / "theirs"
        message = f"in {theirs}: Permission denied; choose a folder that you can write"
        with pytest.raises(PermissionError, match=message):
            store.check_writable(theirs)
        with pytest.raises(PermissionError, match=f"in {theirs}/new: Permission denied; choose a"):
            store.check_writable(theirs / "new")
        with pytest.raises(PermissionError, match=f"cannot write f.swerve {message}"):
            store.write(theirs / "f.swerve", KIND, VERSION, {}, {})
        with pytest.raises(PermissionError, match=f"cannot write f.json {message}"):
            store.write_json(theirs / "f.json", {})
        assert list(theirs.iterdir()) == []

        store.check_writable(folder / "ours" / "new" / "deep")
        assert list((folder / "ours" / "new" / "deep").iterdir()) == []


def test_a_file_is_no_folder(path: Path) -> None:
    with pytest.raises(FileExistsError, match=f"cannot write in {path}: File exists; choose a"):
        store.check_writable(path)


@given(data=json_data)
def test_round_trip_of_records(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    path = tmp_path_factory.getbasetemp() / "record.json"
    store.write_json(path, data)
    back = store.read_json(path)
    assert back == data
    assert json.dumps(back) == json.dumps(data)  # 1 is not 1.0, nor True


def test_an_altered_or_cut_record_is_refused_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    data = {"rate": 15e99, "small": -1e-7, "text": "Swérve", "list": [1, True, None]}
    store.write_json(path, data)
    content = path.read_bytes()
    variants = [content[:length] for length in range(len(content) - 1)] + list(flips(content))

    def read_same(path: Path) -> None:
        assert json.dumps(store.read_json(path)) == json.dumps(data)

    refused = 0
    for variant in variants:
        path.write_bytes(variant)
        refused += refuses(read_same, path)
    assert refused > 0.8 * len(variants)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"record.json: cut short or altered, not JSON .*left as it was; copy it again"),
        ("[]", r"not a Swerve file: expected a JSON object.*give a file that swerve wrote"),
        ("{}", r"not a Swerve record, or altered: expected the keys crc32 and data"),
        ('{"crc32": "00000000", "data": 1}', r"its checksum does not match its data"),
        ('{"crc32": "00000000", "data": 1e999}', r"its checksum does not match its data"),
    ],
)
def test_refuses_other_records(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "record.json"
    path.write_text(content)
    with pytest.raises(store.StoreError, match=message):
        store.read_json(path)
    assert path.read_text() == content


def test_a_record_that_is_not_json_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    store.write_json(path, [1])
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.write_json(path, float("inf"))
    with pytest.raises(TypeError, match="not JSON serializable"):
        store.write_json(path, {1, 2})
    assert store.read_json(path) == [1]
