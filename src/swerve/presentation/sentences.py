"""The words of an inference that pictures and reports share.

score ± standard error,    to the first digit of the error
"""

from __future__ import annotations

import math
import re
import textwrap

import numpy as np

from swerve.evidence.evidence import Evidence
from swerve.hypotheses.grid import GridHypotheses
from swerve.inference.ranking import TIE_ERRORS, Inference
from swerve.trust import verdicts as trust

NUM_NAMED = 6  # hypotheses tied with the first that are named
LEAST_PERCENT = 5e-4  # probability: less is given as it is
MAX_NAME = 120  # characters of a hypothesis in a sentence


def title(inference: Inference) -> str:
    """Return the answer in one line: 'Cell 55: theta [3.14, 3.77) at 13.4 ± 0.1 nats'."""
    if not len(inference.ranking):
        return f"No hypothesis is left: demonstrations enter all {len(inference.struck_out)}"
    best = int(inference.leaders[0])
    what = short_hypothesis(inference, best)
    text = f"{what} at {score(inference, best)}{_tied(inference)}"
    if not inference.demonstrations:
        return f"No demonstrations yet. Prior ranking: {text}"
    return text[0].upper() + text[1:]


def sentence(inference: Inference) -> str:
    """Return the answer in a plain sentence or two."""
    if not len(inference.ranking):
        reason = "is entered by at least one demonstration"
        if inference.impossible.any():
            reason += ", or by every trajectory of a task"
        return f"No hypothesis is left: each of the {len(inference.struck_out)} {reason}."
    best = int(inference.leaders[0])
    what, value = short_hypothesis(inference, best), score(inference, best)
    value += _tied(inference)
    if not inference.demonstrations:
        tasks = counted(inference.evidence.num_tasks, "task")
        most = (
            "what someone under no constraint enters most often is"
            if inference.score_name == "average"
            else "the one that a demonstration of every task would speak for most is"
        )
        return (
            f"There are no demonstrations yet, so this is the prior ranking over {tasks}: {most} "
            f"{what} ({value})."
        )
    basis = counted(len(inference.demonstrations), "demonstration")
    if inference.score[best] <= TIE_ERRORS * inference.score_error[best]:
        return (
            f"No hypothesis explains {basis} noticeably better than no constraint does; the first "
            f"is {what} ({value})."
        )
    verb = "is" if len(inference.demonstrations) == 1 else "are"
    doubt = ", by samples that are not to be trusted" if trust.is_untrusted(inference) else ""
    return f"{basis} {verb} best explained by keeping out of {what} ({value}){doubt}."


def belief(inference: Inference) -> str:
    """Return the posterior in a sentence: of none, of the best, Bayes factor, credible set."""
    if inference.is_ruled_out or (inference.demonstrations and not len(inference.ranking)):
        return (
            f"Posterior: none of these {len(inference.struck_out)}: no constraint at all, or one "
            f"that is not among them{tolerable(inference)}."
        )
    found, credible = inference.posterior, inference.credible_set()
    parts = [f"Posterior: no constraint {probability(found.none, found.none_error)}"]
    if found.hypotheses.any():
        best = int(found.hypotheses.argmax())
        value = probability(found.hypotheses[best], found.error[best])
        parts.append(f"{noun(inference)} {best} {value}")
    if inference.demonstrations:
        factor = times(inference.log_bayes_factor)
        parts[-1] += f"; Bayes factor of a constraint against none {factor}"
    names = ["no constraint"] * credible.has_none
    if len(credible.hypotheses):
        names.append(_numbered(inference, credible.hypotheses.tolist()))
    return f"{', '.join(parts)}; 95 % credible set: {' or '.join(names)}."


def tolerable(inference: Inference) -> str:
    """Return with which tolerance something would be left where all is struck out."""
    tolerance = inference.least_tolerance
    if tolerance is None:
        return "; no tolerance makes any of them more probable than no constraint"
    return (
        f"; with a tolerance of about {tolerance:.2g} or more, some demonstrations ignoring it, "
        "one would be more probable than no constraint"
    )


def times(nats: float) -> str:
    """Return e^nats to two digits, a power of ten where it is large or small."""
    if not -math.log(1e4) < nats <= math.log(1e9):
        return f"10^{nats / math.log(10):.0f}" if math.isfinite(nats) else "0"
    value = float(f"{math.exp(nats):.1e}")
    return f"{value:,.0f}" if value >= 10 else f"{value:g}"


def probability(value: float, error: float) -> str:
    """Return for example '97.2 ± 0.4 %', '2e-06' where it is far below that."""
    if value + error < LEAST_PERCENT:
        return f"{value:.0e}" if value > 0.0 else "0"
    if error < LEAST_PERCENT:
        return f"{100.0 * value:.3g} %"
    return f"{measured(100.0 * value, 100.0 * error)} %"


_METHODS = {
    "smc": "sequential Monte Carlo",
    "tempered": "tempering",
    "importance": "importance weights",
    "plain": "plain weights",
}


def settings(inference: Inference) -> str:
    """Return what the answer depends on, in one line."""
    evidence = inference.evidence
    return (
        f"{evidence.problem.summary}; {counted(len(inference.demonstrations), 'demonstration')}, "
        f"{counted(int(np.count_nonzero(inference.task_counts)), 'task')}, {samples(evidence)}"
    )


def samples(evidence: Evidence) -> str:
    """Return where the numbers come from."""
    if evidence.is_exact:
        return f"exact answers from {evidence.solver}"
    drawn = f", drawn for beta {evidence.sampling_beta:g}" if evidence.is_of_other_beta else ""
    return (
        f"{evidence.num_trajectories:,} trajectories a task from {evidence.solver}{drawn}, "
        f"{_METHODS[evidence.method]}, seed {evidence.seed}"
    )


def counted(number: int, noun: str) -> str:
    """Return for example '1 task' or '1,200 tasks'."""
    return f"{number:,} {noun if number == 1 else _plural(noun)}"


def cut(text: str, length: int) -> str:
    """Return text on one line of at most so many characters."""
    text = " ".join(text.split())
    return text if len(text) <= length else f"{text[: length - 1]}…"


def ended(text: str) -> str:
    """Return text with a full stop, unless it ends in a question mark or was cut."""
    return text if text.endswith(("?", "…")) else f"{text}."


def wrapped(text: str, width: float, size: float) -> str:
    """Return text of a size [pt] in lines of a width [in], with no break inside a value."""
    text = re.sub(r"(?<=,) (?=[^\s,]+\))| (?=±)|(?<=±) | (?=nats)", "\N{NO-BREAK SPACE}", text)
    return textwrap.fill(text, int(width * 72 / (0.6 * size)))


def noun(inference: Inference) -> str:
    """Return what one hypothesis is called: 'cell' or 'hypothesis'."""
    is_grid = isinstance(inference.evidence.problem.hypotheses, GridHypotheses)
    return "cell" if is_grid else "hypothesis"


def hypothesis(inference: Inference, index: int) -> str:
    """Return for example 'cell 55: theta [3.14, 3.77)', the index and the name of a hypothesis."""
    return f"{noun(inference)} {index}: {inference.hypothesis_name(index)}"


def short_hypothesis(inference: Inference, index: int) -> str:
    """Return the same with a long name cut, for use in a sentence."""
    return cut(hypothesis(inference, index), MAX_NAME)


def rank(inference: Inference, row: int) -> str:
    """Return the rank of entry `row` of the ranking, for example '5=' where it is shared."""
    number = inference.rank[row]
    return f"{number}=" if np.count_nonzero(inference.rank == number) > 1 else f"{number}"


def score(inference: Inference, index: int) -> str:
    """Return for example '13.4 ± 0.1 nats', '≥ 7.2 nats' or 'average violation 0.274 ± 0.001'."""
    if inference.score_name == "average":
        return f"average violation {number(inference, index)}"
    return f"{number(inference, index)} nats"


def number(inference: Inference, index: int) -> str:
    """Return for example '13.4 ± 0.1', or '≥ 7.2' where the samples tell a lower bound alone."""
    if inference.score_name == "likelihood" and inference.is_lower_bound[index]:
        return f"≥ {inference.score[index]:.1f}"
    return measured(inference.score[index], inference.score_error[index])


def measured(value: float, error: float) -> str:
    """Return for example '13.4 ± 0.1', to the first digit of the error; '13.42' if it has none."""
    if error == 0.0:
        return f"{value:.2f}"
    digits = 4 if error < 1e-4 else max(0, -math.floor(math.log10(float(f"{error:.0e}"))))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def score_label(inference: Inference) -> str:
    """Return what colours and bars mean, with the unit."""
    if inference.score_name == "average":
        return "average violation probability"
    if not inference.demonstrations:
        return "log-likelihood ratio, were every task shown once [nats]"
    return "log-likelihood ratio to no constraint [nats]"


def _tied(inference: Inference) -> str:
    tied = inference.leaders[1:].tolist()
    return f", tied with {_numbered(inference, tied)}" if tied else ""


def _numbered(inference: Inference, indices: list[int]) -> str:
    """Return for example 'cells 3, 4, 5, 6, 7, 8 and 2 more'."""
    more = f" and {len(indices) - NUM_NAMED:,} more" if len(indices) > NUM_NAMED else ""
    what = noun(inference) if len(indices) == 1 else _plural(noun(inference))
    return f"{what} {', '.join(map(str, indices[:NUM_NAMED]))}{more}"


def _plural(noun: str) -> str:
    return f"{noun[:-2]}es" if noun.endswith("is") else f"{noun}s"
