"""Answer each state, a JSON line, with the belief after it, a JSON line: for `swerve watch`.

    {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "left arm"}
    {"id": "left arm", "t": 0.05, "struck_out": [57], "none": 0.49, "likely": [...], "flags": []}

A line in is an object with the states by name, or an array of the states in order. `t` [s] and `id`
may be left out; demonstrations with different ids are watched side by side. {"end": true, "id":
...} ends a demonstration; its answer agrees with `infer`. A bad line is answered by {"error": ...,
"line": its number} and changes nothing.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.monitoring.foresight import Foreseer
from swerve.monitoring.monitor import Belief, Monitor

NUM_LIKELY = 3  # hypotheses that an answer names: the most probable ones
DIGITS = 6  # decimals of probabilities and nats in an answer: short lines


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
        self._monitors: dict[str, Monitor] = {}
        self._new_monitor(next(iter(tasks.values())))  # raises now if an option is wrong

    def answer(self, line: str) -> dict[str, Any]:
        """Return the answer to one line, or an object whose "error" says what is wrong."""
        name = ""
        try:
            data = _parsed(line)
            if isinstance(data, list):
                if len(data) != len(self._names):
                    raise ValueError(f"expected {len(self._names)} numbers, got {line.strip()}")
                data = dict(zip(self._names, data, strict=True))
            if not isinstance(data, dict):
                raise ValueError(f"expected an object or an array, got {line.strip()}")
            name = "" if data.get("id") is None else str(data["id"])
            self._check_keys(data)
            return self._ended(name) if data.get("end") else self._observed(name, data)
        except ValueError as error:
            return {"id": name, "error": str(error)}

    def _check_keys(self, data: dict[str, Any]) -> None:
        """Raise ValueError if an object has a key that no line may have, or a wrong "end"."""
        strange = [key for key in data if key not in (*self._names, "t", "id", "end")]
        if strange:
            raise ValueError(
                f"expected {', '.join(self._names)}, t, id and end, got also {strange[0]!r}: the "
                "line is left out"
            )
        if not isinstance(data.get("end", False), bool):
            raise ValueError(f'expected true or false as "end", got {data["end"]!r}')

    def _observed(self, name: str, data: dict[str, Any]) -> dict[str, Any]:
        """Return the belief after a state of one demonstration."""
        missing = [state for state in self._names if state not in data]
        if missing:
            raise ValueError(f"expected the states {', '.join(self._names)}, got no {missing[0]}")
        state, time = [data[key] for key in self._names], data.get("t")
        if not all(_is_number(value) for value in (*state, 0.0 if time is None else time)):
            raise ValueError(f"expected numbers, got {state} at t = {time}")
        monitor = self._monitors.get(name) or self._new_monitor(self._task_of(name))
        belief = monitor.observe(state, time)
        self._monitors[name] = monitor  # only once a state of the demonstration was accepted
        return {"id": name, "t": time, **_shown(belief)}

    def _task_of(self, name: str) -> Task:
        """Return the task of a demonstration by the demonstration's id."""
        tasks = self._tasks
        task = tasks.get(name, tasks.get(name.removeprefix("demo_")))
        if len(tasks) == 1:
            (task,) = tasks.values()
        if task is None:
            raise ValueError(
                f"id {name!r}: expected the id of one of {len(tasks)} tasks, such as "
                f"{next(iter(tasks))!r}"
            )
        return task

    def _new_monitor(self, task: Task) -> Monitor:
        """Return a monitor for a demonstration of a task that begins."""
        return Monitor(self._evidence, task, self._foresight, **self._options)

    def _ended(self, name: str) -> dict[str, Any]:
        """Forget a demonstration that has ended, and return the belief from the whole of it."""
        if name not in self._monitors:
            raise ValueError(f"id {name!r}: ended, but no state of it has come")
        return {"id": name, "end": True, **_shown(self._monitors.pop(name).finish())}


def answer_lines(lines: Iterable[str], answer: Callable[[str], dict[str, Any]], out: Any) -> None:
    """Answer each line as soon as it comes; pass over empty lines.

    An error is answered with the number of its line, from 1.

    Args:
      lines: states and ends of demonstrations, as they come.
      answer: returns the answer to a line, such as `Watch.answer`.
      out: file to write answers to.
    """
    for number, line in enumerate(lines, 1):
        if not line.isspace():
            found = answer(line)
            if "error" in found:
                found["line"] = number
            out.write(json.dumps(found) + "\n")
            out.flush()


def _parsed(line: str) -> Any:
    """Return the JSON data of a line.

    Raises:
      ValueError: if the line is no JSON; perhaps it is cut short.
    """
    try:
        return json.loads(line)
    except RecursionError:
        raise ValueError("expected one JSON object or array a line, got one too deep") from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"expected one JSON object or array a line, got {reprlib.repr(line.strip())} "
            f"({error.msg} at character {error.pos + 1}): the line is left out"
        ) from error


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
