"""Fuzz `swerve watch`: whatever a line holds, that line alone is answered by an error."""

from __future__ import annotations

import io
import json
from pathlib import Path
from random import Random

from fuzz.mutator import mutated
from fuzz.target import Target
from support.monitors import Known
from support.synthetic import TASKS, make_evidence, make_record

from swerve import Predicate, Task
from swerve.cli.json_lines import Watch, answer_lines
from swerve.hypotheses.base import ConstraintHypotheses

SEEDS = [
    b'{"theta": 0.1, "x": 1.0, "t": 0.0, "id": "a"}',
    b'{"theta": 0.1, "x": 1.0, "id": 7}',
    b"[0.1, 1.0]",
    b'{"end": true, "id": "a"}',
    b'{"end": false, "x": 1e0, "theta": 1, "t": null, "id": null}',
]


class Streams(Target):
    """Lines of a stream, among lines of a demonstration that nothing disturbs."""

    name, share = "watch", 25

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.task = {"only": Task(TASKS.start[0], TASKS.goal[0])}
        shapes = ConstraintHypotheses([Predicate("high", lambda s: s[..., 1] > 8.0)] * 12)
        self.evidences = [make_evidence(), make_evidence(make_record(hypotheses=shapes))]
        self.good = [
            json.dumps({"theta": 0.1, "x": 1.0 + k, "t": k / 10, "id": "good"}).encode()
            for k in range(4)
        ]
        self.expected = [self.answers(self.good, number) for number in range(2)]

    def answers(self, lines: list[bytes], number: int) -> list[dict]:
        """Return what a stream is answered."""
        evidence, out = self.evidences[number], io.StringIO()
        watched = Watch(evidence, Known(evidence), self.task)
        answer_lines(io.BytesIO(b"\n".join(lines)), watched.answer, out)
        return [json.loads(line) for line in out.getvalue().splitlines()]

    def run(self, random: Random) -> None:
        """Put eight lines between the good ones."""
        number = random.randrange(2)
        lines = list(self.good)
        for _ in range(8):
            line = mutated(random.choice(SEEDS), SEEDS, random)
            if b"good" not in line:
                lines.insert(random.randrange(len(lines) + 1), line)
        found = self.answers(lines, number)
        for answer in found:
            assert ("error" in answer) == ("line" in answer)
            assert len(json.dumps(answer)) < 5000
        good = [answer for answer in found if answer["id"] == "good" and "error" not in answer]
        assert good == self.expected[number], lines
