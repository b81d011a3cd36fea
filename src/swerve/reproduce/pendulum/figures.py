"""Figures, tables and files of the pendulum's result. They compute only errors."""

from __future__ import annotations

import numpy as np

from swerve.reproduce.files import Part, markdown, time_table
from swerve.reproduce.pendulum.measure import FOLLOWED, REAL, Exact, Result, model
from swerve.reproduce.rank_figures import (
    EXACT,
    Line,
    Panel,
    draw_ranks,
    lines_of,
    rank_rows,
    rank_table,
    rank_text,
    way_name,
)
from swerve.reproduce.ways import DISCRETE, Answer, answers_of

TITLES = {
    "C1": "C1, near hanging",
    "C2": "C2, where it falls",
    REAL: "C1, the authors' demonstrations",
}


def parts(result: Result) -> list[Part]:
    """Return the figures."""
    shown = panels(result)
    groups = {
        f"pendulum_rank_torque{max_torque:g}": [
            one for one in shown if one.source != REAL and one.model == model(max_torque)
        ]
        for max_torque in result.scale.ways
    }
    groups["pendulum_rank_real"] = [one for one in shown if one.source == REAL]
    return [Part(name, draw_ranks(some), rank_rows(some)) for name, some in groups.items() if some]


def tables(result: Result) -> dict[str, str]:
    """Return tables as Markdown."""
    found = {
        "pendulum_ranks": rank_table(panels(result)),
        "pendulum_times": time_table(result.seconds),
    }
    return found | ({"pendulum_nats": _nats_table(result)} if result.exact else {})


def panels(result: Result) -> list[Panel]:
    """Return a panel for each model and set of demonstrations."""
    found = []
    for max_torque in result.scale.ways:
        for source in result.sources:
            lines = lines_of(answers_of(result.answers, source.name, model(max_torque)))
            if source.name == REAL:
                exact = [one for one in result.exact if one.max_torque == max_torque]
                lines += [Line(EXACT, EXACT, one.curve) for one in exact]
            title = f"{TITLES[source.name]}; torques to {max_torque:g}"
            found.append(Panel(source.name, model(max_torque), title, lines))
    return found


def text(result: Result) -> str:
    """Return the average ranks as text for the terminal."""
    return rank_text(panels(result))


def _nats_table(result: Result) -> str:
    """Return a table of nats and errors for the demonstrations in a folder, as Markdown."""
    rows = []
    for exact in result.exact:
        nats = [f"{exact.nats[cell]:.2f}" for cell in FOLLOWED]
        rows.append([f"{exact.max_torque:g}", EXACT, *nats, "", ""])
        answers = answers_of(result.answers, REAL, model(exact.max_torque))
        rows += [[f"{exact.max_torque:g}", *_nats_row(one, exact)] for one in answers]
    cells = [f"cell {cell} [nats]" for cell in FOLLOWED]
    titles = ["torques to", "way", *cells, "error, median task", "error, worst task"]
    return markdown(titles, rows)


def _nats_row(answer: Answer, exact: Exact) -> list[str]:
    """Return one row: nats of all demonstrations, and errors of violation probabilities."""
    found = answer.result
    violation = found.evidence.violation_probability[found.task_of]
    error = np.abs(violation - exact.violation).max(axis=1)
    nats = []
    for cell in FOLLOWED:
        spread = "" if answer.way.name == DISCRETE else f" ± {found.standard_error[cell]:.2f}"
        value = f"{found.log_likelihood[cell]:.2f}{spread}"
        nats.append("struck out" if found.struck_out[cell] else value)
    return [way_name(answer), *nats, f"{np.median(error):.3f}", f"{error.max():.3f}"]
