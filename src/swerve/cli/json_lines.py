"""Answer each state, a JSON line, with the belief after it, a JSON line: for `swerve watch`.

    {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "left arm"}
    {"id": "left arm", "t": 0.05, "struck_out": [57], "none": 0.49, "likely": [...], "flags": []}

A line in is an object with the states by name, or an array of the states in order. `t` [s] and `id`
may be left out; demonstrations with different ids (texts or whole numbers) are watched side by
side. {"end": true, "id": ...} ends a demonstration, after the state on that line if there is one;
its answer agrees with `infer`. A bad line is answered by {"error": ..., "line": its number} and
changes nothing.

At most MAX_OPEN demonstrations are watched at a time. One more takes the place of the one whose
last state came longest ago, and its answer names that one: {"id": ..., "dropped": "left arm", ...}.
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, BinaryIO

import numpy as np

from swerve.base.phrases import cut
from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.monitoring.foresight import Foreseer
from swerve.monitoring.monitor import Belief, Monitor

NUM_LIKELY = 3  # hypotheses that an answer names: the most probable ones
DIGITS = 6  # decimals of probabilities and nats in an answer: short lines
MAX_LINE = 2**16  # bytes of a line in: the rest of a longer line is read and forgotten
MAX_ID = 200  # characters of an id
HALVES = re.compile("[\ud800-\udfff]")  # halves of characters: JSON may hold one, no file may
MAX_OPEN = 256  # demonstrations watched at a time: each takes memory for all hypotheses
MAX_WHOLE = 20  # characters of a whole number that is kept as one: ids, and no number of a state
MAX_ERROR = 500  # characters of an error in an answer


class Watch:
    """Demonstrations that are watched side by side.

    Args:
      evidence: evidence of the tasks of all demonstrations.
      foresight: how likely each hypothesis is avoided from a state on, see `Monitor`.
      tasks: tasks by name; a demonstration's id names its task, unless there is only one task.
      options: options of `Monitor`.

    Raises:
      ValueError: if an option is of the wrong kind or range.
    """

    def __init__(
        self, evidence: Evidence, foresight: Foreseer, tasks: Mapping[str, Task], **options: Any
    ) -> None:
        self._evidence, self._foresight, self._tasks = evidence, foresight, dict(tasks)
        self._options = options
        self._names = evidence.problem.space.names
        self._monitors: dict[str, Monitor] = {}  # in the order of their last states
        self._new_monitor(next(iter(tasks.values())))  # raises now if an option is wrong

    def answer(self, line: str) -> dict[str, Any]:
        """Return the answer to one line, or an object whose "error" says what is wrong."""
        name = ""
        try:
            data = _parsed(line)
            if isinstance(data, list):
                if len(data) != len(self._names):
                    raise ValueError(f"expected {len(self._names)} numbers, got {_brief(data)}")
                data = dict(zip(self._names, data, strict=True))
            if not isinstance(data, dict):
                raise ValueError(f"expected an object or an array, got {_brief(data)}")
            name = _name(data.get("id"))
            self._check_keys(data)
            return self._ended(name, data) if data.get("end") else self._observed(name, data)
        except ValueError as error:
            return {"id": name, "error": cut(str(error), MAX_ERROR)}
        except Exception as error:  # code of a user, such as a predicate, may raise anything
            return {"id": name, "error": cut(f"{type(error).__name__}: {error}", MAX_ERROR)}

    def _check_keys(self, data: dict[str, Any]) -> None:
        """Raise ValueError if an object has a key that no line may have, or a wrong "end"."""
        strange = [key for key in data if key not in (*self._names, "t", "id", "end")]
        if strange:
            raise ValueError(
                f"expected {', '.join(self._names)}, t, id and end, got also {_brief(strange[0])}: "
                "the line is left out"
            )
        if not isinstance(data.get("end", False), bool):
            raise ValueError(f'expected true or false as "end", got {_brief(data["end"])}')

    def _observed(self, name: str, data: dict[str, Any]) -> dict[str, Any]:
        """Return the belief after a state of one demonstration."""
        missing = [state for state in self._names if state not in data]
        if missing:
            raise ValueError(f"expected the states {', '.join(self._names)}, got no {missing[0]}")
        state, time = [data[key] for key in self._names], data.get("t")
        if not all(_is_number(value) for value in (*state, 0.0 if time is None else time)):
            null = [key for key in self._names if data[key] is None]
            hint = f": {null[0]} is null; leave the line out if it was not measured" if null else ""
            raise ValueError(f"expected numbers, got {_brief(state)} at t = {_brief(time)}{hint}")
        monitor = self._monitors.get(name) or self._new_monitor(self._task_of(name))
        belief = monitor.observe(state, time)
        self._monitors.pop(name, None)
        self._monitors[name] = monitor  # only once a state of the demonstration was accepted
        dropped = {}
        if len(self._monitors) > MAX_OPEN:
            dropped["dropped"] = next(iter(self._monitors))  # its last state came longest ago
            del self._monitors[dropped["dropped"]]
        return {"id": name, "t": time, **dropped, **_shown(belief)}

    def _task_of(self, name: str) -> Task:
        """Return the task of a demonstration by the demonstration's id."""
        tasks = self._tasks
        task = tasks.get(name, tasks.get(name.removeprefix("demo_")))
        if len(tasks) == 1:
            (task,) = tasks.values()
        if task is None:
            raise ValueError(
                f"{f'id {name!r}' if name else 'no id'}: expected the id of one of {len(tasks)} "
                f"tasks, such as {next(iter(tasks))!r}"
            )
        return task

    def _new_monitor(self, task: Task) -> Monitor:
        """Return a monitor for a demonstration of a task that begins."""
        return Monitor(self._evidence, task, self._foresight, **self._options)

    def _ended(self, name: str, data: dict[str, Any]) -> dict[str, Any]:
        """Forget a demonstration that has ended, and return the belief from the whole of it.

        A state on the line of the end is its last state, which is taken in first.
        """
        has_state = any(state in data for state in self._names)
        last = self._observed(name, data) if has_state else {"struck_out": [], "flags": []}
        if name not in self._monitors:
            raise ValueError(
                f"{f'id {name!r}' if name else 'no id'}: ended, but no state of it has come"
            )
        ended = _shown(self._monitors.pop(name).finish())
        ended["flags"] = list(dict.fromkeys([*last["flags"], *ended["flags"]]))
        ended["struck_out"] = last["struck_out"]
        return {"id": name, "end": True, **last, **ended}


def answer_lines(source: BinaryIO, answer: Callable[[str], dict[str, Any]], out: Any) -> None:
    """Answer each line as soon as it comes; pass over empty lines.

    An error is answered with the number of its line, from 1.

    Args:
      source: states and ends of demonstrations, as they come.
      answer: returns the answer to a line, such as `Watch.answer`.
      out: file to write answers to; None where standard output is closed.
    """
    for number, line in enumerate(_lines(source), 1):
        if not line.isspace():
            found = _answered(line, answer)
            if "error" in found:
                found["line"] = number
            print(json.dumps(found).replace("\x7f", "\\u007f"), file=out, flush=True)


def _answered(line: bytes, answer: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    """Return the answer to a line, which may be too long, or no text."""
    if len(line) > MAX_LINE:
        return {"id": "", "error": f"expected at most {MAX_LINE:,} bytes: the line is left out"}
    try:
        return answer(line.decode())
    except UnicodeDecodeError as error:
        return {"id": "", "error": f"expected UTF-8 text ({error.reason}): the line is left out"}


def _lines(source: BinaryIO) -> Iterator[bytes]:
    """Yield lines as they come, each cut after MAX_LINE + 1 bytes."""
    while line := source.readline(MAX_LINE + 1):
        part = line
        while len(part) > MAX_LINE and not part.endswith(b"\n"):
            part = source.readline(MAX_LINE + 1)
        yield line


def _parsed(line: str) -> Any:
    """Return the JSON data of a line.

    Raises:
      ValueError: if the line is no JSON, perhaps because it is cut short, or a name comes twice.
    """
    try:
        return _DECODER.decode(line)
    except RecursionError:
        raise ValueError("expected one JSON object or array a line, got one too deep") from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"expected one JSON object or array a line, got {_brief(line.strip())} "
            f"({error.msg} at character {error.pos + 1}): the line is left out"
        ) from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the members of a JSON object; raise ValueError if two have the same name."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("expected each name once, got one twice: the line is left out")
    return found


def _whole(text: str) -> int | float:
    """Return a whole number; as a float where it is so long that reading it takes time."""
    return int(text) if len(text) <= MAX_WHOLE else float(text)


_DECODER = json.JSONDecoder(object_pairs_hook=_object, parse_int=_whole)


def _name(value: Any) -> str:
    """Return the id of a demonstration as a text; empty where there is none."""
    if value is None:
        return ""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if isinstance(value, str) and len(value) <= MAX_ID and not HALVES.search(value):
        return value
    raise ValueError(
        f"expected as id a text of at most {MAX_ID} characters or a whole number, got "
        f"{_brief(value)}"
    )


def _brief(value: Any) -> str:
    """Return a value for a message, cut where it is long."""
    return reprlib.repr(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(belief: Belief) -> dict[str, Any]:
    """Return a belief as JSON data."""
    probability = belief.hypotheses
    num = min(NUM_LIKELY, len(probability))
    likely = np.argpartition(probability, -num)[-num:]
    likely = likely[np.argsort(-probability[likely])]
    return {
        "struck_out": list(belief.entered),
        "none": round(belief.none, DIGITS),
        "likely": [
            {
                "index": index,
                "probability": round(float(probability[index]), DIGITS),
                "nats": round(float(belief.log_likelihood[index]), DIGITS),
            }
            for index in likely.tolist()
            if belief.log_likelihood[index] > -np.inf
        ],
        "flags": list(belief.flags),
    }
