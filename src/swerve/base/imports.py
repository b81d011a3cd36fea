"""Keep the user's folders out of the imports of libraries, and let a user's files see their folder.

Python looks for every module in the folder of the script first, or in the current folder. So a
script called `html.py`, or a file `jax.py` beside it, takes the place of the module that a library
means. The finder here stands in the place of Python's own and goes by who imports:

- A library, which is whatever lies elsewhere than the script, finds no module of these folders.
  Only a name that the library was given, as that of a pickled class, is looked for there too.
- A module of the user that `looking_in` has named, such as the file of a problem, finds installed
  modules, and the other files of its folder; a name that means both is refused. Nobody else looks
  there, but for names that such a module gives to a library, while it runs.

All other imports, such as those of the user's script, are Python's own. Folders of PYTHONPATH, of
`.pth` files, and those that the user adds to `sys.path`, are the user's choice, and searched as
Python does; the folder of the script and the current folder are not, wherever they stand.
"""

from __future__ import annotations

import os
import sys
from _collections_abc import Sequence  # which Python has loaded before it looks for files
from importlib import machinery
from importlib.machinery import ModuleSpec
from types import FrameType, ModuleType

PYTHON = os.path.dirname(os.__file__)
SWERVE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
MAIN = ("__main__", "__mp_main__")  # also cells of a notebook, and a script in a child process
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
    """Return the specification of a top-level module in a folder, or None.

    A folder without `__init__.py` is none where Python finds a module of its name elsewhere.
    """
    machinery.PathFinder.invalidate_caches()  # a file may be newer than the last look
    found = machinery.PathFinder.find_spec(name, [folder])
    return found if found is None or _is_whole(found) or not _is_elsewhere(name) else None


def find_installed(name: str) -> ModuleSpec | None:
    """Return the specification of a top-level module that is installed, or None."""
    path = [entry for entry in sys.path if is_installed(os.path.join(entry, ""))]
    found = machinery.PathFinder.find_spec(name, path)
    return found if _is_whole(found) else None


def check_names(file: str, folder: str) -> None:
    """Raise ValueError where a file of the user imports a name that means two modules.

    Args:
      file: the file, whose source is read.
      folder: the folder in which it finds its neighbours.
    """
    import ast  # not above: the finder has to be in its place before

    with open(file, "rb") as source:
        try:
            tree = ast.parse(source.read())
        except (SyntaxError, ValueError):  # which is told when the file is run
            return
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module]
        for name in names:
            _check_name(name.partition(".")[0], folder, file)


def _check_name(name: str, folder: str, file: str) -> None:
    """Raise ValueError where a name means an installed module and a neighbour of a file, too.

    The name `swerve` is that of Swerve.
    """
    if name == "swerve":
        return
    files = [os.path.join(folder, name, "__init__.py"), os.path.join(folder, f"{name}.py")]
    neighbours = [other for other in files if other != file and os.path.isfile(other)]
    if not neighbours or is_installed(neighbours[0]) or neighbours[0].startswith(SWERVE + os.sep):
        return
    if name in sys.stdlib_module_names or find_installed(name) is not None:
        raise ValueError(
            f"{file}: `import {name}` would not give its neighbour {neighbours[0]} but the "
            "installed module of this name: rename the neighbour"
        )


def _is_whole(found: ModuleSpec | None) -> bool:
    """Return whether a module was found that is more than a folder without `__init__.py`."""
    return found is not None and found.origin is not None


def _is_elsewhere(name: str) -> bool:
    """Return whether Python's own search finds a module that is more than a folder."""
    if getattr(sys.modules.get(name), "__file__", None) is not None:
        return True
    finders = (machinery.PathFinder if finder is PathFinder else finder for finder in sys.meta_path)
    return any(_is_whole(finder.find_spec(name, None)) for finder in finders)


class PathFinder(machinery.PathFinder):
    """The finder of modules; the module docstring says what it finds.

    It has the name of Python's own since packages that change imports look for this name.
    """

    @classmethod
    def find_spec(
        cls, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module, or None where there is none."""
        frame = _importer() if path is None else None  # a package says where to look in it
        folder = None if frame is None else _folder_of(frame)
        if frame is not None and folder is not None:
            return _find_for_user(fullname, folder, frame.f_code.co_filename)
        if frame is None or not _is_library(frame):
            return machinery.PathFinder.find_spec(fullname, path, target)
        others = [entry for entry in sys.path if not _is_own(entry)]
        found = machinery.PathFinder.find_spec(fullname, others, target)
        if found is not None and not _is_whole(found):  # a list, or Python looks again everywhere
            found.submodule_search_locations = list(found.submodule_search_locations or ())
        return _find_given(fullname, frame) if found is None else found


def _find_for_user(name: str, folder: str, file: str) -> ModuleSpec | None:
    """Return the module that a file of the user in a folder means by a name, or None."""
    found = find_installed(name)
    if found is not None:
        _check_name(name, folder, file)
        return found
    found = find_in(folder, name)
    if found is None:
        return machinery.PathFinder.find_spec(name)
    if found.origin is not None and found.origin.endswith(".py"):
        check_names(found.origin, folder)
    _folders[name] = folder
    return found


def _find_given(name: str, frame: FrameType) -> ModuleSpec | None:
    """Return a module of the user's folders whose name was given to a library, or None."""
    found = machinery.PathFinder.find_spec(name)
    user, folder = frame.f_back, None
    while user is not None and folder is None:
        user, folder = user.f_back, _folder_of(user)
    if found is None and folder is None:
        return None
    if _names(frame, name):
        return None
    file = frame.f_code.co_filename
    return _find_for_user(name, folder, file) if folder is not None else found


def _names(frame: FrameType, name: str) -> bool:
    """Return whether the code that imports a module holds its name.

    That is an `import` statement, or a call such as `import_module("name")`.
    """
    from opcode import opmap  # not above: the finder has to be in its place before

    code = frame.f_code
    if code.co_code[frame.f_lasti] == opmap["IMPORT_NAME"]:
        return True
    try:
        with open(code.co_filename, encoding="utf-8", errors="replace") as file:
            source = file.read()
    except OSError:  # no file, as for a frozen module
        return False
    return any(f"{quote}{name}{end}" in source for quote in "\"'" for end in "\"'.")


def _folder_of(frame: FrameType) -> str | None:
    """Return the folder in which a module of the user may find its neighbours, or None."""
    name, file = (str(frame.f_globals.get(key)) for key in ("__name__", "__file__"))
    folder = _folders.get(name.partition(".")[0])
    return folder if folder is not None and file.startswith(folder) else None


def _is_library(frame: FrameType) -> bool:
    """Return whether code is of no folder that Python added for the user."""
    file = frame.f_code.co_filename
    if is_installed(file) or file.startswith(SWERVE + os.sep):
        return True
    if frame.f_globals.get("__name__") in MAIN or not os.path.isabs(file):
        return False
    searched = {os.path.abspath(entry) for entry in sys.path if _is_own(entry)}
    return not file.startswith(tuple(os.path.join(folder, "") for folder in searched))


def _is_own(entry: str) -> bool:
    """Return whether an entry of `sys.path` is the script's folder or the current folder."""
    return os.path.normpath(entry) == "." or os.path.abspath(entry) in _OWN


def _importer() -> FrameType | None:
    """Return the frame of the code that imports, below the frames of importing itself."""
    frame = sys._getframe(2)
    while frame is not None and frame.f_code.co_filename.startswith(IMPORTING):
        frame = frame.f_back
    return frame


def _own_folders() -> set[str]:
    """Return the folder of the script and the current folder, unless the user has chosen them."""
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    own = {os.getcwd()}
    if script:
        own |= {os.path.dirname(os.path.abspath(script)), os.path.dirname(os.path.realpath(script))}
    return own - {os.path.abspath(entry) for entry in _chosen_entries()}


def _chosen_entries() -> list[str]:
    """Return the entries of PYTHONPATH and of the `.pth` files of installed packages."""
    chosen = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    for entry in sys.path:
        names = os.listdir(entry) if os.path.isdir(entry) and is_installed(entry) else []
        for name in (name for name in names if name.endswith(".pth")):
            with open(os.path.join(entry, name), encoding="utf-8", errors="replace") as file:
                chosen += [os.path.join(entry, line.strip()) for line in file if line.strip()]
    return [entry for entry in chosen if entry]


def _take_place() -> None:
    """Put the finder in the place of Python's own, or of an earlier one of this module."""
    names = [getattr(finder, "__name__", "") for finder in sys.meta_path]
    place = names.index("PathFinder") if "PathFinder" in names else len(names)
    sys.meta_path[place : place + 1] = [PathFinder]


_OWN = _own_folders()
_take_place()
