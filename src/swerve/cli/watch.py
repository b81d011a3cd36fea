"""`swerve watch`: states in, one JSON line each, and what they tell out, one JSON line each.

    {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "left arm"}
    {"id": "left arm", "t": 0.05, "struck_out": [57], "none": 0.49, "likely": [...], "flags": []}

A line is an object with the states by name, or an array of them in order. `t` [s] and `id` may be
left out; demonstrations with different ids are watched side by side. {"end": true, "id": ...} ends
one and gives the answer of `infer`. A bad line is answered by {"error": ...,
"line": its number} and changes nothing.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from swerve.base.space import Task
from swerve.evidence.evidence import Evidence
from swerve.monitoring.foresight import Foreseer, Foresight
from swerve.monitoring.monitor import Belief, Monitor

if TYPE_CHECKING:
    from swerve.work.work import Work

NUM_LIKELY = 3  # hypotheses that a line names
DIGITS = 6


class Watch:
    """Demonstrations that are watched side by side.

    Args:
      evidence: what is known of their tasks.
      foresight: what `Monitor` needs.
      tasks: by name; the id of a demonstration names its task, unless there is only one.
      options: of `Monitor`.

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
        self._new(next(iter(tasks.values())))  # which says now what is wrong with the options

    def answer(self, line: str) -> dict[str, Any]:
        """Return what one line tells, or an object with an "error" that says what is wrong."""
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
        """Raise ValueError where an object holds what means nothing here."""
        strange = [key for key in data if key not in (*self._names, "t", "id", "end")]
        if strange:
            raise ValueError(
                f"expected {', '.join(self._names)}, t, id and end, got also {strange[0]!r}: the "
                "line is left out"
            )
        if not isinstance(data.get("end", False), bool):
            raise ValueError(f'expected true or false as "end", got {data["end"]!r}')

    def _observed(self, name: str, data: dict[str, Any]) -> dict[str, Any]:
        """Return what a state of one demonstration tells."""
        missing = [state for state in self._names if state not in data]
        if missing:
            raise ValueError(f"expected the states {', '.join(self._names)}, no {missing[0]} came")
        state, time = [data[key] for key in self._names], data.get("t")
        if not all(_is_number(value) for value in (*state, 0.0 if time is None else time)):
            raise ValueError(f"expected numbers, got {state} at t = {time}")
        monitor = self._monitors.get(name) or self._begun(name)
        belief = monitor.observe(state, time)
        self._monitors[name] = monitor  # after a state that it has taken
        return {"id": name, "t": time, **_shown(belief)}

    def _begun(self, name: str) -> Monitor:
        """Return a monitor for a demonstration that begins."""
        tasks = self._tasks
        task = tasks.get(name, tasks.get(name.removeprefix("demo_")))
        if len(tasks) == 1:
            (task,) = tasks.values()
        if task is None:
            raise ValueError(
                f"id {name!r}: expected that of one of {len(tasks)} tasks, such as "
                f"{next(iter(tasks))!r}"
            )
        return self._new(task)

    def _new(self, task: Task) -> Monitor:
        return Monitor(self._evidence, task, self._foresight, **self._options)

    def _ended(self, name: str) -> dict[str, Any]:
        """Forget a demonstration that has ended and return what it tells."""
        if name not in self._monitors:
            raise ValueError(f"id {name!r}: ended, but no state of it has come")
        return {"id": name, "end": True, **_shown(self._monitors.pop(name).finish())}


def watch(lines: Iterable[str], answer: Callable[[str], dict[str, Any]], out: Any) -> None:
    """Answer lines as they come, each at once; empty ones are passed over.

    What is wrong with a line is said with its number, from 1.
    """
    for number, line in enumerate(lines, 1):
        if not line.isspace():
            found = answer(line)
            if "error" in found:
                found["line"] = number
            out.write(json.dumps(found) + "\n")
            out.flush()


def foresight_of(work: Work, evidence: Evidence) -> Foresight:
    """Return the foresight for the tasks of evidence, learned if the work folder has none."""
    path = work.path("evidence")
    path = None if path is None else path.with_name(path.name.replace(".evidence", ".foresight"))
    if path is not None and path.exists():
        foresight = Foresight.load(path, evidence.problem)
        if foresight.learned_from == evidence.digest:
            return foresight
    from swerve.monitoring.foresee import foresee

    work.say("learning to look ahead, for the goals of the work folder's tasks")
    nominal = work.nominal(evidence.tasks)
    seed = work.settings.seed or 0
    foresight = foresee(nominal, evidence, seed=seed, progress=work.progress)
    if path is not None:
        foresight.save(path)
    return foresight


def _parsed(line: str) -> Any:
    """Return the JSON data of a line.

    Raises:
      ValueError: if it is none, cut short perhaps.
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
