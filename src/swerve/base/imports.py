"""Keep the user's folders out of the imports of libraries, and let a user's files see their folder.

Python looks for every module in the folder of the script first, or in the current folder. So a
script called `html.py`, or a file `jax.py` beside it, takes the place of the module that a library
means. The finder here comes before Python's own search and goes by who imports:

- A library, which is whatever lies elsewhere than the script, finds other modules first.
- A module of the user that `looking_in` has named, such as the file of a problem, finds installed
  modules first, then the other files of its folder. Nobody else looks there.

All other imports, such as those of the user's script, are Python's own. Folders of PYTHONPATH, and
those that the user adds to `sys.path`, are the user's choice, and searched as Python does.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import ModuleSpec, PathFinder
from types import FrameType

PYTHON = os.path.dirname(os.__file__)
SWERVE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
IMPORTING = ("<frozen importlib", os.path.join(PYTHON, "importlib", ""))

_folders: dict[str, str] = {}  # folder of each module of the user, by its top-level name


def is_installed(file: str) -> bool:
    """Return whether a file is part of Python or of an installed package."""
    if file.startswith(("<frozen ", PYTHON + os.sep)):
        return True
    return bool({"site-packages", "dist-packages"} & set(file.split(os.sep)))  # of pip, of Debian


def looking_in(folder: str, module: str) -> None:
    """Let a module, and what it imports from a folder, find the other modules of the folder."""
    _folders[module.partition(".")[0]] = folder


def find_in(folder: str, name: str) -> ModuleSpec | None:
    """Return the specification of a top-level module in a folder, or None."""
    PathFinder.invalidate_caches()  # a file may be newer than the last look
    return PathFinder.find_spec(name, [folder])


def find_installed(name: str) -> ModuleSpec | None:
    """Return the specification of a top-level module that is installed, or None."""
    path = [entry for entry in sys.path if is_installed(os.path.join(entry, ""))]
    found = PathFinder.find_spec(name, path)
    return found if found is not None and found.origin is not None else None


class _Finder:
    """The finder of modules; the module docstring says what it finds."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a module, or None to leave it to Python."""
        if path is not None:  # part of a package, which says where to look
            return None
        frame = _importer()
        folder = None if frame is None else _folder_of(frame)
        if folder is not None:
            found = find_installed(name)
            if found is None:
                found = PathFinder.find_spec(name, [folder])
                if found is not None:
                    _folders[name] = folder
            return found
        if frame is None or not _is_library(frame.f_code.co_filename):
            return None
        return PathFinder.find_spec(name, [entry for entry in sys.path if entry not in _OWN])


def _folder_of(frame: FrameType) -> str | None:
    """Return the folder in which a module of the user may find its neighbours, or None."""
    name, file = (str(frame.f_globals.get(key)) for key in ("__name__", "__file__"))
    folder = _folders.get(name.partition(".")[0])
    return folder if folder is not None and file.startswith(folder) else None


def _is_library(file: str) -> bool:
    """Return whether a file is of no folder that Python added for the user."""
    if is_installed(file) or file.startswith(SWERVE + os.sep):
        return True
    return os.path.isabs(file) and not file.startswith(tuple(f"{x}{os.sep}" for x in _OWN if x))


def _importer() -> FrameType | None:
    """Return the frame of the code that imports, below the frames of importing itself."""
    frame = sys._getframe(2)
    while frame is not None and frame.f_code.co_filename.startswith(IMPORTING):
        frame = frame.f_back
    return frame


def _own_entries() -> tuple[str, ...]:
    """Return the entries of `sys.path` that Python itself added for the user.

    They are the folder of the script, or the current folder (`python -m`, `python -c`).
    """
    if sys.flags.safe_path or not sys.path:
        return ("",)
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    own = {"", os.getcwd(), os.path.dirname(os.path.realpath(script)) if script else ""}
    chosen = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return tuple({"", sys.path[0]} if sys.path[0] in own - set(chosen) else {""})


_OWN = _own_entries()
sys.meta_path.insert(sys.meta_path.index(PathFinder), _Finder)
