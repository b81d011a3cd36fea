"""Write one HTML page that says and shows the answer, and tells how far to trust the answer.

The page is complete in itself: style and pictures are inside, and nothing outside is referred to.
Names of files, states and hypotheses are escaped.

Shapes: H hypotheses, K tasks.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from swerve.base import files
from swerve.base.phrases import counted, cut, ended, probability, times
from swerve.base.version import VERSION
from swerve.constraints.boxes import interval_name
from swerve.hypotheses.grid import GridHypotheses
from swerve.inference.greedy import Pick, Picks
from swerve.inference.ranking import TIE_ERRORS, Ranking
from swerve.presentation import html, plots, sentences
from swerve.presentation.html import escape
from swerve.trust import doubts, verdicts

MAX_HYPOTHESES = 50  # rows of the ranking
MAX_TASKS = 100  # rows of the diagnostics
MAX_NAME = 300  # characters of a hypothesis's name
MAX_NAMES = 8  # demonstrations named in a row
PHONE = 3.9  # in, the width of pictures for a phone


def write_report(inference: Ranking, path: str | Path, picks: Sequence[Pick] | None = None) -> None:
    """Write the page atomically, and its folder if there is none.

    Args:
      inference: the answer to report.
      path: the file.
      picks: what `greedy` picked from the inference; None to leave that section out.

    Raises:
      OSError: if the file cannot be written; an older file at that place is left as it was.
    """
    files.write_text(path, page(inference, picks))


def page(inference: Ranking, picks: Sequence[Pick] | None = None) -> str:
    """Return the page as HTML."""
    parts = [
        '<p class="faint">Swerve: which constraint is this demonstrator obeying?</p>',
        f"<h1>{escape(sentences.sentence(inference))}</h1>",
        _meaning(inference),
        f"<p>{escape(sentences.belief(inference))}</p>",
        _warnings(inference),
        _main_picture(inference),
        _ranking(inference),
        "" if picks is None else _several(inference, picks),
        _how_to_read(),
        _tasks(inference),
        _settings(inference),
        f"<footer><p>Made by swerve {escape(VERSION)}.</p></footer>",
    ]
    return html.document(sentences.title(inference), "\n".join(parts))


def _meaning(inference: Ranking) -> str:
    """Return the meaning of the best score in plain numbers, and the next hypothesis's score."""
    ranking, score = inference.ranking, inference.score
    if not len(ranking) or not inference.demonstrations or verdicts.is_untrusted(inference):
        return ""
    first = ranking[0]
    if inference.score_name == "average":
        text = (
            "A demonstrator under no constraint would have entered this region with probability "
            f"{score[first]:.2g} on average; no demonstration did."
        )
    else:
        least = "at least " if inference.is_lower_bound[first] else ""
        text = (
            f"The demonstrations are {least}{times(float(score[first]))} times as likely under "
            "this constraint as under none."
        )
    behind = ranking[len(inference.leaders) :]
    if len(behind):
        following = int(behind[0])
        text += (
            f" Next is {sentences.short_hypothesis(inference, following)}, at "
            f"{sentences.score(inference, following)}."
        )
    return f"<p>{escape(text)}</p>"


def _warnings(inference: Ranking) -> str:
    """Return the warnings in a box; nothing where there are none."""
    found = doubts.warnings(inference)
    if not found:
        return ""
    items = "".join(f"<p><strong>Warning:</strong> {escape(ended(text))}</p>" for text in found)
    return f'<div class="alarm" role="alert">{items}</div>'


def _main_picture(inference: Ranking) -> str:
    """Return the picture of the hypotheses with its caption."""
    wide = plots.plot_inference(inference, has_header=False)
    narrow = plots.plot_inference(inference, width=PHONE, has_header=False)
    caption = "Shaded: how well each hypothesis explains the demonstrations."
    if inference.struck_out.any():
        caption += " Hatched: hypotheses struck out, since a demonstration enters them."
    if not inference.demonstrations:
        caption = (
            "Shaded: the score that each hypothesis would have if one demonstration of every task "
            "avoided it."
        )
    caption += " Grey lines: nominal trajectories, sampled with no hypothesis in force."
    return html.picture(wide, narrow, sentences.title(inference), caption)


def _ranking(inference: Ranking) -> str:
    """Return the head of the ranking as bars and as a table."""
    num_struck_out, num_left = int(inference.struck_out.sum()), len(inference.ranking)
    noun = sentences.noun(inference)
    counts = f"{counted(num_left, noun)} left, {num_struck_out:,} struck out."
    if not num_left:
        return f"<h2>Ranking</h2><p>{counts} There is nothing to rank.</p>"
    rows = [
        ("first" if inference.rank[row] == 1 else "", _hypothesis_cells(inference, row, index))
        for row, index in enumerate(inference.ranking[:MAX_HYPOTHESES].tolist())
    ]
    head = (
        "rank",
        noun,
        "region",
        "score [nats]",
        "standard error",
        "posterior",
        "average violation",
    )
    bars = html.picture(
        plots.plot_ranking(inference),
        plots.plot_ranking(inference, width=PHONE),
        "The best hypotheses of the ranking as bars; the table below has the same numbers.",
    )
    return "".join(
        [
            f"<h2>Ranking</h2><p>{counts} “=” marks ties.</p>{bars}",
            html.table(head, rows, {0: "", 2: "name"}),
            html.more(num_left - len(rows), noun),
        ]
    )


def _hypothesis_cells(inference: Ranking, row: int, index: int) -> tuple[str, ...]:
    """Return the cells of entry `row` of the ranking, which is the hypothesis `index`."""
    posterior = inference.posterior
    bound = "≥ " if inference.is_lower_bound[index] else ""
    return (
        sentences.rank(inference, row),
        f"{index}",
        cut(inference.hypothesis_name(index), MAX_NAME),
        f"{bound}{inference.log_likelihood[index]:.3f}",
        f"{inference.standard_error[index]:.3f}",
        probability(float(posterior.hypotheses[index]), float(posterior.error[index])),
        f"{inference.average_violation[index]:.4f}",
    )


def _several(inference: Ranking, picks: Sequence[Pick]) -> str:
    """Return what greedy selection picked, in order."""
    ended = ""
    if isinstance(picks, Picks):
        ended = escape(f" Picking ended: {sentences.ended(inference, picks)}.")
    if not picks:
        return f"<h2>Several constraints</h2><p>No constraint was picked.{ended}</p>"
    rows = [
        (
            "",
            (
                f"{number}",
                f"{pick.hypothesis}",
                cut(inference.hypothesis_name(pick.hypothesis), MAX_NAME),
                f"{pick.total_gain:.2f}",
                f"{pick.gain:.3f}",
                f"{pick.standard_error:.3f}",
                f"{pick.log_odds:.2f}",
            ),
        )
        for number, pick in enumerate(picks, 1)
    ]
    head = (
        "pick",
        sentences.noun(inference),
        "region",
        "gain [nats]",
        "per demonstration [nats]",
        "standard error",
        "log odds [nats]",
    )
    text = (
        "Constraints are picked one after another: each is the one that explains most while all "
        "earlier picks are in force. Log odds compare one more constraint, whichever it is, with "
        f"no more constraint, just before the pick.{ended}"
    )
    table = html.table(head, rows, {0: "", 2: "name"})
    return f"<h2>Several constraints</h2><p>{text}</p>{table}"


def _tasks(inference: Ranking) -> str:
    """Return the diagnostics of every task used; where there are many, of the worst tasks."""
    evidence, problem = inference.evidence, inference.evidence.problem
    used = np.flatnonzero(inference.task_counts)
    shown, ess = used, evidence.effective_sample_size
    if len(used) > MAX_TASKS:
        shown = np.sort(used[np.argsort(ess[used], kind="stable")[:MAX_TASKS]])
    tasks = shown.tolist()
    rows = [
        ("low" if evidence.has_too_few[task] else "", _task_cells(inference, task, verdict))
        for task, verdict in zip(tasks, verdicts.verdicts(inference, tasks), strict=True)
    ]
    head = (
        "demonstrations" if inference.demonstrations else "task",
        "verdict",
        f"start ({', '.join(problem.space.names)})",
        f"goal ({', '.join(problem.goal_names)})",
        "effective sample size",
        "KL [nats]",
        "log Z_0 [nats]",
        "spread [nats]",
        "ancestors",
    )
    more = html.more(len(used) - len(rows), "task", " with a larger effective sample size")
    table = html.table(head, rows, {0: "name", 1: "verdict", 2: "vector", 3: "vector"})
    return f"<h2>Tasks</h2>{table}{more}"


def _task_cells(inference: Ranking, task: int, verdict: str) -> tuple[str, ...]:
    """Return the cells of a task: its demonstrations, its verdict and its diagnostics."""
    evidence = inference.evidence
    ess, low = evidence.effective_sample_size[task], ", low" * bool(evidence.has_too_few[task])
    return (
        _demonstration_names(inference, task),
        verdict,
        html.vector(evidence.tasks.start[task]),
        html.vector(evidence.tasks.goal[task]),
        "exact" if evidence.is_exact else f"{ess:,.0f} of {evidence.num_trajectories:,}{low}",
        f"{evidence.kl[task]:.2f}",
        f"{evidence.log_partition[task]:.2f}",
        f"{evidence.island_spread[task]:.3f}",
        f"{evidence.distinct_share[task]:.0%}",
    )


def _demonstration_names(inference: Ranking, task: int) -> str:
    """Return the names of the first demonstrations of a task; its number if it has none."""
    of_task = np.flatnonzero(inference.task_of == task)
    if not len(of_task):
        return f"task {task}"
    names = ", ".join(inference.demonstrations[k].name for k in of_task[:MAX_NAMES])
    more = len(of_task) - MAX_NAMES
    return f"{names} and {more:,} more" if more > 0 else names


def _settings(inference: Ranking) -> str:
    """Return the problem, the hypotheses and how the samples were made, as a list."""
    evidence, problem = inference.evidence, inference.evidence.problem
    judged = "states and the segments between them" if problem.between_states else "states alone"
    score = "log-likelihood" if inference.score_name == "likelihood" else "average violation"
    items = {
        "Problem": problem.name,
        "Hypotheses": _hypotheses(inference),
        "Violation judged at": judged,
        "Known constraints": "; ".join(c.name for c in problem.known) or "none",
        "beta": f"{problem.beta:g} nats per unit of reward",
        "Measure": problem.measure,
        "Horizon": f"{problem.num_steps} steps of {problem.dt:.4g} s",
        "Demonstrations": f"{len(inference.demonstrations):,}",
        "Ranked by": score,
        "Nominal distribution": evidence.solver,
        "Samples": "none, answers are exact"
        if evidence.is_exact
        else f"{evidence.num_trajectories:,} trajectories a task, {evidence.method} weights, "
        f"seed {evidence.seed}",
        "Fingerprint": problem.fingerprint[:16],
    }
    entries = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in items.items())
    return f"<h2>Settings</h2><dl>{entries}</dl>"


def _hypotheses(inference: Ranking) -> str:
    """Return the number of hypotheses, and the axes of a grid."""
    hypotheses = inference.evidence.problem.hypotheses
    if not isinstance(hypotheses, GridHypotheses):
        return f"{len(hypotheses):,}"
    axes = (
        f"{counted(count, 'cell')} of {interval_name(name, low, high)}"
        for name, (low, high, count) in hypotheses.axes.items()
    )
    return f"{len(hypotheses):,}: {' × '.join(axes)}"


def _how_to_read() -> str:
    """Return the section that explains the words and numbers of the page."""
    return f"""<h2>How to read this</h2>
<p><strong>Nats</strong> measure evidence on a logarithmic scale: under a constraint with s nats the
demonstrations are e<sup>s</sup> times as likely as under no constraint; 1 nat is 2.7 times, 3 nats
are 20 times, 7 nats 1,100 times. 0 means that the hypothesis explains nothing: a demonstrator under
no constraint would not have entered the region either. The <strong>average violation</strong> is
the probability that a demonstrator under no constraint enters the region, averaged over the
demonstrations. “≥” marks a lower bound: hardly any sampled trajectory avoids the region.</p>
<p><strong>Struck out</strong> are hypotheses that at least one demonstration enters: none of them
can be a constraint that all demonstrations obey. <strong>Tied</strong> are hypotheses whose scores
differ by at most {TIE_ERRORS:g} times the sum of their standard errors: the order among them says
nothing.</p>
<p>The <strong>effective sample size</strong> and the <strong>KL</strong> divergence (0 at best)
tell how well the policy that was sampled matches the nominal distribution. Both numbers are alarms,
not proof: they cannot show a way of reaching the goal that was never sampled. The
<strong>spread</strong> is the standard deviation of log Z_0 between independent parts of the
samples. <strong>Ancestors</strong> are the trajectories from which the samples descend, as a share
of all trajectories that were begun.</p>"""
