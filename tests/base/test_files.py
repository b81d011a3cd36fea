"""Files are written in one place: whole, under a random name first, never through a link."""

from __future__ import annotations

import ast
import fcntl
import os
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.stored_files import child_environment

import swerve
from swerve.base import files

SOURCE = Path(swerve.__file__).parent
LEFTOVER = ".swerve.0123456789abcdef.tmp"


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has cleared no folder of leftovers yet."""
    monkeypatch.setattr(files, "_SWEPT", set())


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize("planted", ["report.html", ".report.html.tmp", LEFTOVER])
def test_a_planted_link_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planted: str
) -> None:
    """Even where the random name is guessed."""
    victim, folder = tmp_path / "victim", tmp_path / "folder"
    victim.write_text("precious")
    folder.mkdir()
    (folder / planted).symlink_to(victim)
    guesses = [bytes.fromhex("0123456789abcdef"), b"another8"]
    monkeypatch.setattr(os, "urandom", lambda number: guesses.pop(0))
    if planted == LEFTOVER:
        with pytest.raises(FileExistsError, match=r"cannot write report\.html in"):
            files.write_text(folder / "report.html", "new")
    files.write_text(folder / "report.html", "new")
    assert victim.read_text() == "precious"
    assert (folder / "report.html").read_text() == "new"
    assert not (folder / "report.html").is_symlink()
    assert set(names(folder)) == {"report.html", planted}


def test_a_lock_is_no_link_and_no_pipe(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    (tmp_path / ".lock").symlink_to(victim)
    with pytest.raises(OSError, match=r"cannot write \.lock in"), files.locked(tmp_path):
        pass
    assert not victim.exists()
    (tmp_path / ".lock").unlink()
    os.mkfifo(tmp_path / ".lock")
    expected = r"\.lock: expected a file, got a pipe: name another file"
    with pytest.raises(OSError, match=expected), files.locked(tmp_path):
        pass


@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_file_is_neither_replaced_nor_read(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "report.html"
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "device":
            path.symlink_to("/dev/zero")
    before = path.lstat()
    message = f"report.html: expected a file, got a {kind}: name another file"
    for use in (lambda: files.write_text(path, ""), lambda: files.open_regular(path)):
        with pytest.raises(OSError, match=message):
            use()
    assert path.lstat().st_ino == before.st_ino
    assert names(tmp_path) == ["report.html"]


def test_a_link_to_a_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("content")
    (tmp_path / "link").symlink_to("target")
    with files.open_regular(tmp_path / "link") as file:
        assert file.read() == b"content"


def test_only_the_umask_says_who_may_read(tmp_path: Path) -> None:
    for umask, expected in ((0o022, 0o644), (0o077, 0o600), (0o002, 0o664)):
        previous = os.umask(umask)
        try:
            files.write_text(tmp_path / "f", "")
            with files.whole_folder(tmp_path / f"{umask}") as folder:
                files.write_text(folder / "g", "")
        finally:
            os.umask(previous)
        assert stat.S_IMODE((tmp_path / "f").stat().st_mode) == expected
        assert stat.S_IMODE((tmp_path / f"{umask}").stat().st_mode) == 0o777 & ~umask


def test_a_long_name_can_be_written(tmp_path: Path) -> None:
    """As long as a file system allows: the temporary name must not be longer."""
    files.write_text(tmp_path / ("x" * 255), "new")
    assert names(tmp_path) == ["x" * 255]


class TestLeftovers:
    def test_go_with_the_next_write(self, tmp_path: Path) -> None:
        (tmp_path / LEFTOVER).write_bytes(b"x" * 100_000)
        folder = tmp_path / LEFTOVER.replace("0", "f")
        folder.mkdir()
        (folder / "part").write_text("")
        others = [".swerve.tmp", ".f.tmp", ".swerve.0123456789abcdeg.tmp"]
        for name in others:
            (tmp_path / name).write_text("of somebody else")
        files.write_text(tmp_path / "f", "new")
        assert names(tmp_path) == sorted(["f", *others])

    def test_a_link_called_like_one_is_left_as_it_is(self, tmp_path: Path) -> None:
        victim, folder = tmp_path / "victim", tmp_path / "folder"
        victim.mkdir()
        (victim / "precious").write_text("")
        folder.mkdir()
        (folder / LEFTOVER).symlink_to(victim)
        files.write_text(folder / "f", "new")
        assert names(victim) == ["precious"]
        assert names(folder) == sorted(["f", LEFTOVER])

    def test_of_a_writer_that_is_alive_stay(self, tmp_path: Path) -> None:
        code = (
            "import sys, time; from pathlib import Path; from swerve.base import files\n"
            "def slow(file):\n"  # which is called once the file is locked
            "    Path(sys.argv[1], 'begun').touch()\n"
            "    while not Path(sys.argv[1], 'done').exists(): time.sleep(0.01)\n"
            "files.replace(Path(sys.argv[1], 'slow'), slow)"
        )
        command = [sys.executable, "-c", code, str(tmp_path)]
        with subprocess.Popen(command, env=child_environment()) as child:
            deadline = time.monotonic() + 60
            while "begun" not in names(tmp_path) and time.monotonic() < deadline:
                time.sleep(0.01)
            files.write_text(tmp_path / "quick", "")
            [temporary] = [name for name in names(tmp_path) if name.startswith(".")]
            (tmp_path / "done").touch()
            assert child.wait(60) == 0
        assert files.TEMPORARY.fullmatch(temporary)
        assert names(tmp_path) == ["begun", "done", "quick", "slow"]

    def test_taken_away_by_mistake_are_written_again(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Between creating a temporary file and locking it, another process may remove it."""
        lock_alone, tried = files._lock_alone, []

        def too_late(descriptor: int, path: Path) -> bool:
            tried.append(path)
            if len(tried) == 1:
                path.unlink()
            return lock_alone(descriptor, path)

        monkeypatch.setattr(files, "_lock_alone", too_late)
        files.write_text(tmp_path / "f", "new")
        assert len(tried) == 2
        assert names(tmp_path) == ["f"]


class TestWholeFolder:
    @pytest.mark.parametrize("moment", ["before it is open", "before the lock", "under a lock"])
    def test_taken_away_by_mistake_is_made_again(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
    ) -> None:
        """Another process sweeps leftovers between making the folder and locking it."""
        opened, locked, taken, others = os.open, fcntl.flock, [], []

        def open_late(path: files.AnyPath, flags: int, *mode: int) -> int:
            if taken or not files.TEMPORARY.fullmatch(Path(path).name):
                return opened(path, flags, *mode)
            taken.append(Path(path))
            if moment == "before it is open":
                taken[0].rmdir()
            descriptor = opened(path, flags, *mode)
            if moment == "under a lock":
                others.append(opened(path, flags))
                locked(others[0], fcntl.LOCK_EX)
                taken[0].rmdir()
            return descriptor

        def lock_late(descriptor: int, operation: int) -> None:
            if moment == "before the lock" and taken[0].exists():
                taken[0].rmdir()
            locked(descriptor, operation | fcntl.LOCK_NB)  # to wait would take for ever here

        monkeypatch.setattr(os, "open", open_late)
        monkeypatch.setattr(fcntl, "flock", lock_late)
        with files.whole_folder(tmp_path / "b") as folder:
            (folder / "f").write_text("")
        for descriptor in others:
            os.close(descriptor)
        assert folder != taken[0]
        assert names(tmp_path) == ["b"]
        assert names(tmp_path / "b") == ["f"]

    def test_is_there_when_it_is_complete(self, tmp_path: Path) -> None:
        with files.whole_folder(tmp_path / "a" / "b") as folder:
            (folder / "f").write_text("")
            assert not (tmp_path / "a" / "b").exists()
        assert names(tmp_path / "a") == ["b"]
        assert names(tmp_path / "a" / "b") == ["f"]

    def test_is_not_there_after_an_error(self, tmp_path: Path) -> None:
        def fill() -> None:
            with files.whole_folder(tmp_path / "b") as folder:
                (folder / "f").write_text("")
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fill()
        assert names(tmp_path) == []

    def test_replaces_no_other(self, tmp_path: Path) -> None:
        (tmp_path / "b").mkdir()
        (tmp_path / "b" / "precious").touch()
        line = f"cannot write b in {tmp_path}: Directory not empty; choose a folder"
        with pytest.raises(OSError, match=line), files.whole_folder(tmp_path / "b"):
            pass
        assert names(tmp_path / "b") == ["precious"]
        assert names(tmp_path) == ["b"]

    def test_begins_in_no_place_of_a_link_that_leads_nowhere(self, tmp_path: Path) -> None:
        (tmp_path / "b").symlink_to(tmp_path / "gone")
        line = f"{tmp_path}/b is a link that leads nowhere; remove it or choose another"
        with pytest.raises(FileExistsError, match=line), files.whole_folder(tmp_path / "b"):
            pytest.fail("began")
        assert names(tmp_path) == ["b"]


WRITES = {  # methods and functions that write, make, move or remove files
    *("write_text", "write_bytes", "mkdir", "makedirs", "touch", "symlink_to", "hardlink_to"),
    *("rename", "rmdir", "mkfifo", "savez", "savez_compressed", "savetxt", "tofile", "memmap"),
    *("savefig", "imsave", "dump", "write_csv", "write_parquet", "sink_parquet", "FileIO"),
}
ALLOWED = {  # calls outside base/files.py that open no file by themselves
    ("base/store.py", "archive.open"),  # a member, in a file that is open
    ("base/figure_style.py", "figure.savefig"),  # to an open file
    ("presentation/html.py", "figure.savefig"),  # to memory
    ("reproduce/files.py", "figure.savefig"),  # to memory
}


def calls(path: Path) -> Iterator[tuple[str, ast.Call | None]]:
    """Yield the text of what is called in a module with each call, and of what is imported."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield ast.unparse(node), None


def writes(text: str, call: ast.Call | None) -> bool:
    """Return whether a call may write, other than through `files`; or an import is for that."""
    if call is None:
        return bool({"shutil", "tempfile"} & set(text.replace(".", " ").split()))
    owner, _, name = text.rpartition(".")
    if name == "open" and owner != "store":
        mode = call.args[0 if owner else 1 :][:1]
        return not all(isinstance(x, ast.Constant) and x.value in ("r", "rb") for x in mode)
    if name == "replace":  # of paths; that of texts has two arguments, that of records a keyword
        return len(call.args) == 1 and not call.keywords
    return text == "np.save" or (name in WRITES and owner not in ("", "files"))


def test_nothing_else_opens_files_for_writing() -> None:
    """So that every file is written whole, under a random name first, never through a link."""
    found = {
        (str(path.relative_to(SOURCE)), text)
        for path in sorted(SOURCE.rglob("*.py"))
        if path != SOURCE / "base" / "files.py"
        for text, call in calls(path)
        if writes(text, call)
    }
    assert found <= ALLOWED, found - ALLOWED


@pytest.mark.parametrize(
    "line",
    [
        *("open(path, 'w')", "path.open('ab')", "path.open(mode)", "os.open(path, flags)"),
        *("path.write_text('')", "path.replace(other)", "np.save(path, a)", "import shutil"),
        *("figure.savefig(path)", "from tempfile import mkdtemp", "folder.mkdir()"),
    ],
)
def test_an_opened_file_would_be_found(tmp_path: Path, line: str) -> None:
    (tmp_path / "module.py").write_text(line)
    assert any(writes(text, call) for text, call in calls(tmp_path / "module.py"))
