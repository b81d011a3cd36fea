"""Writing a stored file leaves the old content or the new one, whatever happens."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support.stored_files import ARRAYS, HEADER, KIND, VERSION, assert_same, child_environment, read

from swerve.base import files, store

NOBODY = 65534


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


def test_a_killed_writer_leaves_the_old_or_the_new_content(tmp_path: Path) -> None:
    code = (
        "import itertools, sys, numpy as np; from swerve.base import store\n"
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
            files.check_writable(theirs)
        with pytest.raises(PermissionError, match=f"in {theirs}/new: Permission denied; choose a"):
            files.check_writable(theirs / "new")
        with pytest.raises(PermissionError, match=f"cannot write f.swerve {message}"):
            store.write(theirs / "f.swerve", KIND, VERSION, {}, {})
        with pytest.raises(PermissionError, match=f"cannot write f.json {message}"):
            store.write_json(theirs / "f.json", {})
        assert list(theirs.iterdir()) == []

        files.check_writable(folder / "ours" / "new" / "deep")
        assert list((folder / "ours" / "new" / "deep").iterdir()) == []


def test_a_file_is_no_folder(path: Path) -> None:
    message = f"cannot write in {{}}: {path} is a file, no folder; choose a folder"
    with pytest.raises(FileExistsError, match=message.format(path)):
        files.check_writable(path)
    with pytest.raises(NotADirectoryError, match=message.format(path / "a" / "b")):
        files.check_writable(path / "a" / "b")
