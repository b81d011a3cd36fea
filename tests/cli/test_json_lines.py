"""Lines of JSON about states, and their answers."""

from __future__ import annotations

import io
import json

import pytest
from support.monitors import Known
from support.synthetic import TASKS, make_evidence

from swerve import Task
from swerve.cli.json_lines import Watch, answer_lines

START = TASKS.start[0].tolist()
NAMED = {f"demo_{k}": Task(TASKS.start[k], TASKS.goal[k]) for k in range(3)}


def make_watch(tasks: dict[str, Task] | None = None) -> Watch:
    evidence = make_evidence()
    return Watch(evidence, Known(evidence), tasks or {"only": NAMED["demo_0"]})


def test_a_state_is_answered_by_what_it_tells() -> None:
    watched = make_watch()
    state = {"theta": START[0], "x": START[1], "t": 0.0, "id": "a"}
    first = watched.answer(json.dumps(state))
    assert first.keys() == {"id", "t", "struck_out", "none", "likely", "flags"}
    assert first["id"] == "a"
    assert first["struck_out"] == [0]
    assert 0.0 < first["none"] < 1.0
    probabilities = [row["probability"] for row in first["likely"]]
    assert probabilities == sorted(probabilities, reverse=True)
    again = watched.answer(json.dumps(state))
    assert again["flags"] == ["repeated"]
    assert again["struck_out"] == []
    assert watched.answer(json.dumps({"end": True, "id": "a"}))["end"]


def test_an_array_is_a_state_too() -> None:
    watched = make_watch()
    as_array = watched.answer(json.dumps(START))
    as_object = make_watch().answer(json.dumps({"theta": START[0], "x": START[1]}))
    assert as_array == as_object


def test_demonstrations_are_watched_side_by_side() -> None:
    watched = make_watch(NAMED)
    for k in range(3):
        theta, x = TASKS.start[k].tolist()
        answer = watched.answer(json.dumps({"theta": theta, "x": x, "id": f"demo_{k}"}))
        assert answer["flags"] == []
        assert len(answer["struck_out"]) == (k < 3 and x < 9.0)
    assert watched.answer('{"end": true, "id": "demo_1"}')["id"] == "demo_1"
    assert "no state of it" in watched.answer('{"end": true, "id": "demo_1"}')["error"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", r"one JSON object or array a line, got '{' \(Expecting property name"),
        ('{"theta": 1', "one JSON object or array a line"),
        ("3", "expected an object or an array, got 3"),
        ("[1.0]", r"expected 2 numbers, got \[1.0\]"),
        ('{"theta": 1.0}', "expected the states theta, x, got no x"),
        ('{"theta": "a", "x": 1.0}', r"expected numbers, got \['a', 1.0\]"),
        ('{"theta": null, "x": 1.0}', "expected numbers"),
        ('{"theta": true, "x": 1.0}', "expected numbers"),
        ('{"theta": 1.0, "x": 1.0, "t": "soon"}', "expected numbers"),
        ('{"theta": NaN, "x": 1.0}', "expected finite numbers, got theta = nan"),
        ('{"theta": 1.0, "x": 1.0, "t": -1}', "expected seconds since the start"),
        ('{"end": true, "id": "b"}', "id 'b': ended, but no state of it has come"),
        ('{"end": "false", "theta": 1.0, "x": 1.0}', "true or false as \"end\", got 'false'"),
        ('{"theta": 1.0, "x": 1.0, "time": 0.1}', "t, id and end, got also 'time': the line is le"),
        (f'{{"theta": 1{400 * "0"}, "x": 1.0}}', "expected 2 numbers"),
        (f'{{"theta": 1.0, "x": 1.0, "t": 1{400 * "0"}}}', "expected seconds since the start"),
        (100_000 * "[", "one JSON object or array a line, got one too deep"),
    ],
)
def test_a_bad_line_is_answered_and_the_stream_goes_on(line: str, message: str) -> None:
    out = io.StringIO()
    answer_lines([line + "\n", "\n", json.dumps(START) + "\n"], make_watch().answer, out)
    bad, good = map(json.loads, out.getvalue().splitlines())
    with pytest.raises(ValueError, match=message):
        raise ValueError(bad["error"])
    assert "error" not in good


def test_a_null_id_is_none() -> None:
    watched = make_watch()
    assert watched.answer(json.dumps({"theta": START[0], "x": START[1], "id": None}))["id"] == ""
    assert watched.answer('{"end": true}')["id"] == ""


def test_bad_options_are_refused_before_the_first_line() -> None:
    evidence = make_evidence()
    with pytest.raises(ValueError, match="tolerance: expected the probability"):
        Watch(evidence, Known(evidence), NAMED, tolerance=2.0)


def test_an_unknown_id_is_refused_where_there_are_several_tasks() -> None:
    answer = make_watch(NAMED).answer(json.dumps(START))
    assert answer["error"] == "id '': expected the id of one of 3 tasks, such as 'demo_0'"
