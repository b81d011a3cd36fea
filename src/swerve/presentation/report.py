"""One HTML page that says what was inferred, shows it, and tells how far to trust it.

The page is complete in itself: style and pictures are inside, and it refers to nothing outside.
What comes from names of files, states and hypotheses is escaped.

Shapes: H hypotheses, K tasks.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import swerve
from swerve.base import store
from swerve.constraints.boxes import interval_name
from swerve.hypotheses.grid import GridHypotheses
from swerve.inference.greedy import Pick
from swerve.inference.ranking import TIE_ERRORS, Inference
from swerve.presentation import plots
from swerve.presentation import sentences as wording
from swerve.trust.verdicts import is_untrusted

MAX_HYPOTHESES = 50  # rows of the ranking
MAX_TASKS = 100  # rows of the diagnostics
MAX_NAME = 300  # characters of a hypothesis
MAX_NAMES = 8  # demonstrations named in a row
PHONE = 3.9  # in, the width of pictures for a phone
DPI = 180

STYLE = """
:root { color-scheme: light dark; --ink: #1c1c1e; --faint: #5f6066; --paper: #fff;
  --line: #d9d9de; --band: #f4f4f6; --alarm: #8a2c00; --alarm-paper: #fff1e8; }
@media (prefers-color-scheme: dark) { :root { --ink: #ececf0; --faint: #a5a5ad; --paper: #17171a;
  --line: #3b3b42; --band: #212126; --alarm: #ffb38a; --alarm-paper: #3a2010; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1.2rem 1rem 3rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.55 system-ui, sans-serif; overflow-wrap: break-word;
  -webkit-text-size-adjust: 100%; }
h1 { font-size: 1.45rem; line-height: 1.35; margin: .3rem 0 .6rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p, dd, li { max-width: 46rem; }
.faint, figcaption, footer { color: var(--faint); font-size: .9rem; }
.alarm { background: var(--alarm-paper); color: var(--alarm); border-left: .3rem solid var(--alarm);
  padding: .7rem 1rem; margin: 1rem 0; border-radius: .2rem; }
.alarm p { margin: .3rem 0; }
figure { margin: 1rem 0; }
figcaption { margin-top: .4rem; }
img { display: block; width: 100%; height: auto; background: #fff; border-radius: .3rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem .3rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 600; vertical-align: bottom; }
td.name { min-width: 11rem; max-width: 30rem; overflow-wrap: anywhere; }
.number { text-align: right; }
td.number, td.vector { white-space: nowrap; }
td.verdict { min-width: 7rem; }
tr.first td { background: var(--band); font-weight: 600; }
tr.low td { color: var(--alarm); font-weight: 600; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1.2rem; margin: 0; }
dt { color: var(--faint); }
dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 700px) {
  dl { grid-template-columns: 1fr; gap: 0; } dd { margin-bottom: .5rem; } }
"""


def write_report(
    inference: Inference, path: str | Path, picks: Sequence[Pick] | None = None
) -> None:
    """Write the page, atomically; its folder is created if need be.

    Args:
      inference: what to report.
      path: the file.
      picks: what `greedy` picked from it, if that is to be reported as well.

    Raises:
      OSError: if it cannot be written; then the file that was there is still there.
    """
    store.write_text(path, page(inference, picks))


def page(inference: Inference, picks: Sequence[Pick] | None = None) -> str:
    """Return the page as HTML."""
    title = escape(wording.title(inference))
    body = "\n".join(
        [
            '<p class="faint">Swerve: which constraint is this demonstrator obeying?</p>',
            f"<h1>{escape(wording.sentence(inference))}</h1>",
            _meaning(inference),
            f"<p>{escape(wording.belief(inference))}</p>",
            _warnings(inference),
            _main_picture(inference),
            _ranking(inference),
            "" if picks is None else _several(inference, picks),
            _how_to_read(inference),
            _tasks(inference),
            _settings(inference),
            f"<footer><p>Made by swerve {escape(swerve.__version__)}.</p></footer>",
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _meaning(inference: Inference) -> str:
    """Say in plain numbers what the score means and how far behind the next one is."""
    ranking, score = inference.ranking, inference.score
    if not len(ranking) or not inference.demonstrations or is_untrusted(inference):
        return ""
    first = ranking[0]
    if inference.score_name == "average":
        text = (
            f"A demonstrator under no constraint would have entered it with probability "
            f"{score[first]:.2g} on average; no demonstration did."
        )
    else:
        least = "at least " if inference.is_lower_bound[first] else ""
        ratio = wording.times(float(score[first]))
        text = (
            f"The demonstrations are {least}{ratio} times as likely under this constraint as "
            "under none."
        )
    behind = ranking[len(inference.leaders) :]
    if len(behind):
        text += (
            f" Next is {wording.short_hypothesis(inference, int(behind[0]))}, at "
            f"{wording.score(inference, int(behind[0]))}."
        )
    return f"<p>{escape(text)}</p>"


def _warnings(inference: Inference) -> str:
    if not inference.warnings:
        return ""
    items = "".join(
        f"<p><strong>Warning:</strong> {escape(wording.ended(w))}</p>" for w in inference.warnings
    )
    return f'<div class="alarm" role="alert">{items}</div>'


def _main_picture(inference: Inference) -> str:
    wide = plots.plot_inference(inference, has_header=False)
    narrow = plots.plot_inference(inference, width=PHONE, has_header=False)
    caption = "Shaded: how well each hypothesis explains the demonstrations."
    if inference.struck_out.any():
        caption += " Hatched: struck out, since a demonstration enters it."
    if not inference.demonstrations:
        caption = "Shaded: how much a demonstration of every task that kept out would say."
    caption += " Grey lines: what would be done without any constraint."
    return _picture(wide, narrow, wording.title(inference), caption)


def _picture(wide: Figure, narrow: Figure, description: str, caption: str = "") -> str:
    """Return a picture in two layouts, of which the browser shows the one that fits."""
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><picture><source media="(max-width: 700px)" srcset="{_data(narrow)}">'
        f'<img src="{_data(wide)}" alt="{escape(description)}"></picture>{text}</figure>'
    )


def _data(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _ranking(inference: Inference) -> str:
    num_struck_out, num_left = int(inference.struck_out.sum()), len(inference.ranking)
    noun = wording.noun(inference)
    counts = f"{wording.counted(num_left, noun)} left, {num_struck_out:,} struck out."
    if not num_left:
        return f"<h2>Ranking</h2><p>{counts} There is nothing to rank.</p>"
    posterior = inference.posterior
    rows = []
    for row, index in enumerate(inference.ranking[:MAX_HYPOTHESES].tolist()):
        bound = "≥ " if inference.is_lower_bound[index] else ""
        cells = (
            wording.rank(inference, row),
            f"{index}",
            wording.cut(inference.hypothesis_name(index), MAX_NAME),
            f"{bound}{inference.log_likelihood[index]:.3f}",
            f"{inference.standard_error[index]:.3f}",
            wording.probability(float(posterior.hypotheses[index]), float(posterior.error[index])),
            f"{inference.average_violation[index]:.4f}",
        )
        rows.append(("first" if inference.rank[row] == 1 else "", cells))
    head = (
        "rank",
        noun,
        "region",
        "score [nats]",
        "standard error",
        "posterior",
        "average violation",
    )
    picture = _picture(
        plots.plot_ranking(inference),
        plots.plot_ranking(inference, width=PHONE),
        "The first of the ranking as bars; the table below has the same numbers.",
    )
    return "".join(
        [
            f"<h2>Ranking</h2><p>{counts} “=” marks ties.</p>{picture}",
            _table(head, rows, {0: "", 2: "name"}),
            _more(num_left - len(rows), noun),
        ]
    )


def _several(inference: Inference, picks: Sequence[Pick]) -> str:
    """Return what greedy selection picked, in order."""
    rows = [
        (
            "",
            (
                f"{number}",
                f"{pick.hypothesis}",
                wording.cut(inference.hypothesis_name(pick.hypothesis), MAX_NAME),
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
        wording.noun(inference),
        "region",
        "gain [nats]",
        "a demonstration [nats]",
        "standard error",
        "log odds [nats]",
    )
    text = (
        "Picked one after another, each for what it explains while those before it are in force. "
        "Log odds: one more constraint, whichever, against no more, before it was picked."
    )
    if not picks:
        text = "No constraint explains enough to be picked."
    table = _table(head, rows, {0: "", 2: "name"}) if picks else ""
    return f"<h2>Several constraints</h2><p>{text}</p>{table}"


def _tasks(inference: Inference) -> str:
    """Return the diagnostics of every task used; where there are many, of the worst ones."""
    evidence, problem = inference.evidence, inference.evidence.problem
    used = np.flatnonzero(inference.task_counts)
    shown, ess = used, evidence.effective_sample_size
    if len(used) > MAX_TASKS:
        shown = np.sort(used[np.argsort(ess[used], kind="stable")[:MAX_TASKS]])
    low = evidence.has_too_few
    rows = []
    for task in shown.tolist():
        cells = (
            _demonstration_names(inference, task),
            inference.verdict(task),
            _vector(evidence.tasks.start[task]),
            _vector(evidence.tasks.goal[task]),
            "exact"
            if evidence.is_exact
            else f"{ess[task]:,.0f} of {evidence.num_trajectories:,}{', low' * bool(low[task])}",
            f"{evidence.kl[task]:.2f}",
            f"{evidence.log_partition[task]:.2f}",
            f"{evidence.island_spread[task]:.3f}",
            f"{evidence.distinct_share[task]:.0%}",
        )
        rows.append(("low" if low[task] else "", cells))
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
    more = _more(len(used) - len(rows), "task", " with a larger effective sample size")
    table = _table(head, rows, {0: "name", 1: "verdict", 2: "vector", 3: "vector"})
    return f"<h2>Tasks</h2>{table}{more}"


def _demonstration_names(inference: Inference, task: int) -> str:
    of_task = np.flatnonzero(inference.task_of == task)
    if not len(of_task):
        return f"task {task}"
    names = ", ".join(inference.demonstrations[k].name for k in of_task[:MAX_NAMES])
    more = len(of_task) - MAX_NAMES
    return f"{names} and {more:,} more" if more > 0 else names


def _settings(inference: Inference) -> str:
    evidence, problem = inference.evidence, inference.evidence.problem
    hypotheses = problem.hypotheses
    what = f"{len(hypotheses):,}"
    if isinstance(hypotheses, GridHypotheses):
        axes = (
            f"{wording.counted(count, 'cell')} of {interval_name(name, low, high)}"
            for name, (low, high, count) in hypotheses.axes.items()
        )
        what += f": {' × '.join(axes)}"
    judged = "states and the segments between them" if problem.between_states else "states alone"
    score = "log-likelihood" if inference.score_name == "likelihood" else "average violation"
    items = {
        "Problem": problem.name,
        "Hypotheses": what,
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


def _how_to_read(inference: Inference) -> str:
    return f"""<h2>How to read this</h2>
<p><strong>Nats</strong> measure evidence on a logarithmic scale: under a constraint with s nats the
demonstrations are e<sup>s</sup> times as likely as under no constraint; 1 nat is 2.7 times, 3 nats
are 20 times, 7 nats 1,100 times. 0 means that the hypothesis explains nothing: nobody would have
gone there anyway. The <strong>average violation</strong> is the probability that a demonstrator
under no constraint enters the region, averaged over the demonstrations. “≥” marks a lower bound:
hardly any sampled trajectory avoids the region.</p>
<p><strong>Struck out</strong> is what at least one demonstration enters: a constraint that all of
them obey it cannot be. <strong>Tied</strong> are hypotheses whose scores differ by at most
{TIE_ERRORS:g} times the sum of their standard errors: the order among them says nothing.</p>
<p>The <strong>effective sample size</strong> and the <strong>KL</strong> divergence (0 at best)
tell how well the policy that was sampled matches the nominal distribution. They are alarms, not
proof: they cannot see a way of reaching the goal that was never sampled. The
<strong>spread</strong> is the standard deviation of log Z_0 between independent parts of the
samples, and <strong>ancestors</strong> are the trajectories, of those begun, that any of the
samples goes back to.</p>"""


def _table(
    head: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], columns: dict[int, str]
) -> str:
    """Return a table of text, escaped.

    Args:
      head: of the columns.
      rows: each its class and its cells.
      columns: class of each column that does not hold numbers.
    """
    kinds = [columns.get(k, "number") for k in range(len(head))]
    lines = [_row("th", "", kinds, head), *(_row("td", kind, kinds, row) for kind, row in rows)]
    return f'<div class="scroll"><table>{"".join(lines)}</table></div>'


def _row(tag: str, kind: str, kinds: Sequence[str], cells: Sequence[str]) -> str:
    pairs = zip(kinds, cells, strict=True)
    inside = "".join(f'<{tag} class="{k}">{escape(cell)}</{tag}>' for k, cell in pairs)
    return f'<tr class="{kind}">{inside}</tr>\n'


def _more(number: int, noun: str, which: str = "") -> str:
    more = wording.counted(number, f"more {noun}")
    return f'<p class="faint">and {more}{which}.</p>' if number > 0 else ""


def _vector(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
