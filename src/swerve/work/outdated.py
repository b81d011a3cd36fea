"""Move outdated results aside, all or none of them, even where the process is killed.

    1. outdating/        is made; the results move into it, one by one, beside a copy of the record
    2. outdated/         moves to outdating/older
    3. outdating/        is renamed to outdated/
    4. outdated/older    is removed

Step 3 is the one that counts. Until then, the next process takes everything back (`recover`) and
finds the folder as it was. From then on, the results are in `outdated`, complete.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from swerve.base import files

RECORD = "problem.json"
OUTDATED = "outdated"  # folder of the results of an older version of the problem
OUTDATING = "outdating"  # the same folder while it is being filled
OLDER = "older"  # in these: the results that were in `outdated` before


def set_aside(folder: Path, results: Iterable[Path]) -> Path:
    """Move results, and a copy of the record, into `outdated`, in place of what was there before.

    The folder is locked and has been recovered.

    Args:
      folder: the work folder.
      results: files in this folder.

    Returns:
      The folder that the results are in now.

    Raises:
      OSError: if the folder cannot be written.
    """
    going, aside = folder / OUTDATING, folder / OUTDATED
    files.new_folder(going)
    files.write_bytes(going / RECORD, (folder / RECORD).read_bytes())
    for path in results:
        files.move(path, going / path.name)
    if _is_there(aside):
        files.move(aside, going / OLDER)
    files.move(going, aside)
    recover(folder)
    return aside


def is_unfinished(folder: Path) -> bool:
    """Return whether `recover` has something to do: a process was killed, or is at work."""
    return _is_begun(folder) or _is_nearly_done(folder)


def recover(folder: Path) -> None:
    """Take back what `set_aside` has begun, or finish what it has nearly done.

    Raises:
      OSError: if the folder cannot be written.
    """
    going, aside = folder / OUTDATING, folder / OUTDATED
    if _is_begun(folder):
        if _is_there(going / OLDER):
            files.move(going / OLDER, aside)
        for path in sorted(going.iterdir()):
            if path.name != RECORD and not files.TEMPORARY.fullmatch(path.name):
                files.move(path, folder / path.name)
        files.remove(going)
    if _is_nearly_done(folder):
        files.remove(aside / OLDER)


def _is_begun(folder: Path) -> bool:
    going = folder / OUTDATING
    return going.is_dir() and not going.is_symlink()


def _is_nearly_done(folder: Path) -> bool:
    aside = folder / OUTDATED
    return _is_there(aside / OLDER) and not aside.is_symlink()


def _is_there(path: Path) -> bool:
    """Return whether there is a file, a folder, or a link, even one that leads nowhere."""
    return path.is_symlink() or path.exists()
