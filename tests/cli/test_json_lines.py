"""Lines of JSON about states, and their answers."""

from __future__ import annotations

import io
import itertools
import json
import sys
from typing import Any

import pytest
from support.monitors import Known
from support.synthetic import TASKS, make_evidence

from swerve import Task
from swerve.cli import json_lines
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


def test_a_state_on_the_line_of_the_end_is_taken_in_first() -> None:
    state = {"theta": START[0], "x": START[1], "t": 0.0, "id": "a"}
    apart, together = make_watch(), make_watch()
    struck_out = apart.answer(json.dumps(state))["struck_out"]
    expected = apart.answer('{"end": true, "id": "a"}')
    found = together.answer(json.dumps({**state, "end": True}))
    assert struck_out == [0]
    assert found["struck_out"] == struck_out
    assert found["end"]
    assert {**found, "struck_out": [], "t": None} == {**expected, "t": None}
    assert "no state of it" in together.answer('{"end": true, "id": "a"}')["error"]
    missing = together.answer('{"end": true, "theta": 1.0, "id": "a"}')
    assert missing["error"] == "expected the states theta, x, got no x"


def test_the_flags_of_the_last_state_are_told_at_the_end() -> None:
    watched = make_watch()
    state = {"theta": START[0], "x": START[1], "t": 0.0, "end": True}
    late = watched.answer(json.dumps({**state, "t": 0.3}))
    on_time = watched.answer(json.dumps(state))
    assert "late start" in late["flags"]
    assert "late start" not in on_time["flags"]


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
        ('{"theta": null, "x": 1.0}', "expected numbers, got .*: theta is null; leave the line"),
        ('{"end": true}', "no id: ended, but no state of it has come"),
        ('{"theta": true, "x": 1.0}', "expected numbers"),
        ('{"theta": 1.0, "x": 1.0, "t": "soon"}', "expected numbers"),
        ('{"theta": NaN, "x": 1.0}', "expected finite numbers, got theta = nan"),
        ('{"theta": 1.0, "x": 1.0, "t": -1}', "expected seconds since the start"),
        ('{"end": true, "id": "b"}', "id 'b': ended, but no state of it has come"),
        ('{"end": "false", "theta": 1.0, "x": 1.0}', "true or false as \"end\", got 'false'"),
        ('{"theta": 1.0, "x": 1.0, "time": 0.1}', "t, id and end, got also 'time': the line is le"),
        (f'{{"theta": 1{400 * "0"}, "x": 1.0}}', "expected finite numbers, got theta = inf"),
        ('{"theta": 1e400, "x": 1.0}', "expected finite numbers, got theta = inf"),
        ('{"theta": 1e308, "x": 1.0}', "theta: 1e\\+308 is an angle of more than 10 turns"),
        ('{"theta": 1.0, "x": 1e308}', "x: 1e\\+308 is more than 10 half-widths from the middle"),
        ('{"theta": 1.0, "x": 1.0, "t": 1e308}', "seconds since the start of the task, got 1e"),
        (f'{{"theta": 1.0, "x": 1.0, "t": 1{400 * "0"}}}', "expected seconds since the start"),
        (f'{{"theta": {5000 * "9"}, "x": 1.0}}', "expected finite numbers, got theta = inf"),
        (f'{{"theta": 1.0, "x": 1.0, "id": {30 * "9"}}}', "expected as id a text of at most 200"),
        ('{"theta": 1.0, "x": 1.0, "id": 1.5}', "or a whole number, got 1.5"),
        ('{"theta": 1.0, "x": 1.0, "id": true}', "or a whole number, got True"),
        ('{"theta": 1.0, "x": 1.0, "id": ["a"]}', r"or a whole number, got \['a'\]"),
        ('{"theta": 1.0, "x": 1.0, "id": {"a": 1}}', "or a whole number, got {'a': 1}"),
        (f'{{"theta": 1.0, "x": 1.0, "id": "{201 * "a"}"}}', r"at most 200 .* got 'a+\.\.\.a+'$"),
        ('{"theta": 1.0, "x": 1.0, "id": "\\ud800"}', r"or a whole number, got '\\ud800'"),
        ('{"theta": 1.0, "x": 1.0, "theta": 2.0}', "expected each name once, got one twice"),
        ('{"theta": 1.0, "x": 1.0, "id": "a", "id": "b"}', "expected each name once"),
        ('{"theta": {"a": 1, "a": 2}, "x": 1.0}', "expected each name once"),
        ('{"theta": [1.0], "x": 1.0}', r"expected numbers, got \[\[1.0\], 1.0\] at t = None"),
        ('{"theta": "1.0", "x": 1.0}', "expected numbers, got"),
        ('{"theta": 1_0, "x": 1.0}', "one JSON object or array a line"),
        ('{"theta": 0x1, "x": 1.0}', "one JSON object or array a line"),
        ('{"theta": 01, "x": 1.0}', "one JSON object or array a line"),
        ('{"theta": +1, "x": 1.0}', "one JSON object or array a line"),
        ('{"theta": 1.0, "x": 1.0}{"theta": 1.0, "x": 1.0}', "one JSON object or array a line"),
        ("\x00", "one JSON object or array a line, got '\\\\x00'"),
        ('"a"', "expected an object or an array, got 'a'"),
        ("null", "expected an object or an array, got None"),
        (60_000 * "[", "one JSON object or array a line, got one too deep"),
        (30_000 * "[" + 30_000 * "]", "one JSON object or array a line, got one too deep"),
        ('{"a":' * 10_000, "one JSON object or array a line, got one too deep"),
        (1_000_000 * "[", "expected at most 65,536 bytes: the line is left out"),
        (f'{{"{60_000 * "a"}": 1}}', r"t, id and end, got also 'a+\.\.\.a+': the line is left out"),
        ('{"theta": 1.0, "x": 1.0, "\x1b": 1.0}', "one JSON object or array a line"),
    ],
)
def test_a_bad_line_is_answered_and_the_stream_goes_on(line: str, message: str) -> None:
    bad, good = answers([line.encode(), b"", json.dumps(START).encode()])
    with pytest.raises(ValueError, match=message):
        raise ValueError(bad["error"])
    assert bad["line"] == 1
    assert len(bad["error"]) <= 500
    assert "error" not in good


def answers(lines: list[bytes], watched: Watch | None = None) -> list[dict[str, Any]]:
    """Return the answers to lines of a stream."""
    out = io.StringIO()
    answer_lines(io.BytesIO(b"\n".join(lines)), (watched or make_watch()).answer, out)
    return [json.loads(line) for line in out.getvalue().splitlines()]


def test_without_standard_output_the_lines_are_taken_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)  # closed, as by >&-
    watched, lines = make_watch(), [json.dumps({"end": True}), json.dumps(START)]
    answer_lines(io.BytesIO("\n".join(lines).encode()), watched.answer, sys.stdout)


@pytest.mark.parametrize(
    "line", [b"\xff", b'{"id": "\xc3"}', "é".encode("utf-16"), b"\xed\xa0\x80"]
)
def test_a_line_that_is_no_text_is_answered(line: bytes) -> None:
    bad, good = answers([line, json.dumps(START).encode()])
    assert bad["error"].startswith("expected UTF-8 text (")
    assert bad["line"] == 1
    assert "error" not in good


def test_a_long_line_takes_no_memory_and_is_one_line() -> None:
    """Its rest is forgotten, even where it looks like lines that can be answered."""
    state = json.dumps(START).encode()
    long = b"[" + b" " * 65_535 + state + b" " * 2**20 + state
    found = answers([state, long, state, long])
    assert ["error" in answer for answer in found] == [False, True, False, True]
    assert [answer.get("line") for answer in found] == [None, 2, None, 4]


def test_other_demonstrations_are_as_if_a_bad_line_had_not_been_there() -> None:
    """Nor does a bad line change its own demonstration."""
    good = [
        json.dumps({"theta": START[0], "x": START[1] + k, "t": k / 10, "id": name}).encode()
        for k in range(5)
        for name in ("a", "b")
    ]
    bad = [b'{"theta": 1.0, "x": 1.0, "t": 1e308, "id": "a"}',
           b'{"theta": 1e300, "x": 1, "id": "a"}',
           b'{"theta": 1.0, "x": 1.0, "t": 0.0, "id": "\\udfff"}', b"\xff", b"[1, 2", b"\x00",
           b'{"theta": 1.0, "x": 1.0, "id": "a"}', b'{"end": 1, "id": "b"}']  # fmt: skip
    mixed = [line for pair in zip(good, [*bad, *bad[:2]], strict=True) for line in pair]
    found = answers(mixed)
    assert [answer for answer in found if "error" not in answer] == answers(good)
    assert sum("error" in answer for answer in found) == len(good)


def test_code_of_a_user_may_fail_at_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = make_watch()
    watched.answer(json.dumps(START))
    monitor = watched._monitors[""]
    with monkeypatch.context() as patch:
        patch.setattr(monitor, "observe", lambda *_: {}["no key"])
        assert watched.answer(json.dumps(START)) == {"id": "", "error": "KeyError: 'no key'"}
    assert "error" not in watched.answer(json.dumps(START))


def test_the_demonstration_that_was_still_for_longest_is_dropped_and_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(json_lines, "MAX_OPEN", 2)
    watched, count = make_watch(), itertools.count()

    def told(name: str) -> tuple[Any, list[str]]:
        state = {"theta": START[0], "x": START[1] + next(count) / 100, "id": name}
        answer = watched.answer(json.dumps(state))
        return answer.get("dropped"), answer["flags"]

    assert [told(name)[0] for name in ("a", "b", "a", "c", "c", "a")] == [None] * 3 + [
        "b",
        None,
        None,
    ]
    assert told("b") == ("c", ["late start"])
    assert len(watched._monitors) == 2
    watched.answer('{"end": true, "id": "a"}')
    assert told("d")[0] is None


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
    assert answer["error"] == "no id: expected the id of one of 3 tasks, such as 'demo_0'"
