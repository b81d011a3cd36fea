"""Say an inference in words: the sentences and names that pictures and reports share.

score ± standard error,    to the first digit of the error
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from swerve.base.phrases import counted, cut, measured, plural, probability, times
from swerve.evidence.estimators import LOW_ESS
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.grid import GridHypotheses
from swerve.inference.ranking import TIE_ERRORS, Ranking
from swerve.trust import doubts, verdicts

if TYPE_CHECKING:
    from swerve.inference.greedy import Picks

NUM_NAMED = 6  # hypotheses named in a list of hypotheses, before the others are counted
MAX_NAME = 120  # characters of a hypothesis and its name in a sentence
METHODS = {
    "smc": "sequential Monte Carlo",
    "tempered": "tempering",
    "importance": "importance weights",
    "plain": "plain weights",
}


def title(inference: Ranking) -> str:
    """Return the answer in one line: 'Cell 55: theta [3.14, 3.77) at 13.4 ± 0.1 nats'."""
    if not len(inference.ranking):
        return f"No hypothesis is left: demonstrations enter all {len(inference.struck_out)}"
    best = int(inference.leaders[0])
    what = short_hypothesis(inference, best)
    text = f"{what} at {score(inference, best)}{_tied(inference)}"
    if not inference.demonstrations:
        return f"No demonstrations yet. Prior ranking: {text}"
    return f"{text[0].upper()}{text[1:]}{_against_prior(inference, best)}"


def sentence(inference: Ranking) -> str:
    """Return the answer in a plain sentence or two."""
    if not len(inference.ranking):
        reason = "is entered by at least one demonstration"
        if inference.impossible.any():
            reason += ", or by every trajectory of a task"
        return f"No hypothesis is left: each of the {len(inference.struck_out)} {reason}."
    best = int(inference.leaders[0])
    answer = f"{short_hypothesis(inference, best)} ({score(inference, best)}{_tied(inference)})"
    if not inference.demonstrations:
        return _prior_sentence(inference, answer)
    basis = counted(len(inference.demonstrations), "demonstration")
    if inference.score[best] <= TIE_ERRORS * inference.score_error[best]:
        return (
            f"No hypothesis explains {basis} noticeably better than no constraint does; the first "
            f"is {answer}."
        )
    verb = "is" if len(inference.demonstrations) == 1 else "are"
    doubt = ", by samples that are not to be trusted" if verdicts.is_untrusted(inference) else ""
    unless = _against_prior(inference, best)
    return f"{basis} {verb} best explained by keeping out of {answer}{doubt}{unless}."


def _against_prior(inference: Ranking, index: int) -> str:
    """Return that the prior rules a hypothesis out; '' if the prior allows the hypothesis."""
    if inference.prior[1 + index]:
        return ""
    what = "this hypothesis" if inference.prior[1:].any() else "every constraint"
    return f", although the prior rules out {what}"


def _prior_sentence(inference: Ranking, answer: str) -> str:
    """Return the sentence that gives the best hypothesis before there are demonstrations."""
    tasks = counted(inference.evidence.num_tasks, "task")
    most = (
        "the hypothesis that a demonstrator under no constraint enters most often"
        if inference.score_name == "average"
        else "the hypothesis that one demonstration of every task would support most"
    )
    return (
        f"There are no demonstrations yet, so this is the prior ranking over {tasks}: {most} is "
        f"{answer}."
    )


def belief(inference: Ranking) -> str:
    """Return the posterior in a sentence.

    The sentence gives the probabilities of no constraint and of the best hypothesis, the Bayes
    factor of a constraint against no constraint, and the 95 % credible set.
    """
    if inference.is_ruled_out or (inference.demonstrations and not len(inference.ranking)):
        return (
            f"Posterior: none of these {len(inference.struck_out)}: no constraint at all, or a "
            f"constraint that is not among them{doubts.tolerable(inference)}."
        )
    found, credible = inference.posterior, inference.credible_set()
    parts = [f"Posterior: no constraint {probability(found.none, found.none_error)}"]
    if found.hypotheses.any():
        best = int(found.hypotheses.argmax())
        value = probability(found.hypotheses[best], found.error[best])
        parts.append(f"{noun(inference)} {best} {value}")
    if inference.demonstrations and inference.prior[1:].any():
        factor = times(inference.log_bayes_factor)
        parts[-1] += f"; Bayes factor of a constraint against none {factor}"
    elif inference.demonstrations:
        parts[-1] += "; no Bayes factor, since the prior rules out every constraint"
    names = ["no constraint"] * credible.has_none
    if len(credible.hypotheses):
        names.append(_numbered(inference, credible.hypotheses.tolist()))
    return f"{', '.join(parts)}; 95 % credible set: {' or '.join(names)}."


def ended(inference: Ranking, picks: Picks) -> str:
    """Return why greedy selection ended, what would have come next, and what to give to go on."""
    if picks.ended == "most":
        return f"as many as asked for: {len(picks)}"
    following, few = picks.following, ""
    if picks and picks.effective_samples < LOW_ESS:
        few = (
            f"; only some {picks.effective_samples:.0f} trajectories of a task avoid what is "
            "picked, too few to tell: raise --samples"
        )
    if following is None:
        other, more = ("other ", " more") if picks else ("", "")
        return f"no {other}hypothesis explains anything{more}{few}"
    one, other, than = ("one more", "other ", "no more") if picks else ("one", "", "none")
    if picks.ended == "odds":
        why = f"{one} constraint, whichever it is, is less probable than {than}"
    else:
        why = (
            f"no {other}constraint explains {picks.threshold:g} nats per demonstration, the "
            "threshold"
        )
    return (
        f"{why}; next would be {short_hypothesis(inference, following.hypothesis)}, for "
        f"{following.total_gain:.2f} nats, {following.gain:.3f} per demonstration, at log odds "
        f"{following.log_odds:.2f} (--threshold {_rounded_down(following.gain):g} picks it){few}"
    )


def _rounded_down(value: float) -> float:
    """Return a number above 0 rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return unit * math.floor(value / unit)


def settings(inference: Ranking) -> str:
    """Return the problem, the numbers of demonstrations and tasks, and the samples, in one line."""
    evidence = inference.evidence
    return (
        f"{evidence.problem.summary}; {counted(len(inference.demonstrations), 'demonstration')}, "
        f"{counted(int(np.count_nonzero(inference.task_counts)), 'task')}, {samples(evidence)}"
    )


def samples(evidence: Evidence) -> str:
    """Return how many samples there are, from which solver, and how they are weighed."""
    if evidence.is_exact:
        return f"exact answers from {evidence.solver}"
    beta = f", sampled for beta {evidence.sampling_beta:g}" if evidence.is_of_other_beta else ""
    return (
        f"{evidence.num_trajectories:,} trajectories a task from {evidence.solver}{beta}, "
        f"{METHODS[evidence.method]}, seed {evidence.seed}"
    )


def noun(inference: Ranking) -> str:
    """Return the word for one hypothesis: 'cell' for a grid, else 'hypothesis'."""
    is_grid = isinstance(inference.evidence.problem.hypotheses, GridHypotheses)
    return "cell" if is_grid else "hypothesis"


def hypothesis(inference: Ranking, index: int) -> str:
    """Return the index and the name of a hypothesis: 'cell 55: theta [3.14, 3.77)'."""
    return f"{noun(inference)} {index}: {inference.hypothesis_name(index)}"


def short_hypothesis(inference: Ranking, index: int) -> str:
    """Return the index and the name of a hypothesis, cut to the length that suits a sentence."""
    return cut(hypothesis(inference, index), MAX_NAME)


def rank(inference: Ranking, row: int) -> str:
    """Return the rank of entry `row` of the ranking; '5=' where other entries share rank 5."""
    number = inference.rank[row]
    return f"{number}=" if np.count_nonzero(inference.rank == number) > 1 else f"{number}"


def score(inference: Ranking, index: int) -> str:
    """Return a score with its unit: '13.4 ± 0.1 nats' or 'average violation 0.274 ± 0.001'."""
    if inference.score_name == "average":
        return f"average violation {number(inference, index)}"
    return f"{number(inference, index)} nats"


def number(inference: Ranking, index: int) -> str:
    """Return a score: '13.4 ± 0.1', or '≥ 7.2' where the samples tell only a lower bound."""
    if inference.score_name == "likelihood" and inference.is_lower_bound[index]:
        return f"≥ {inference.score[index]:.1f}"
    return measured(inference.score[index], inference.score_error[index])


def score_label(inference: Ranking) -> str:
    """Return the name of the score and its unit, for colour bars and axes."""
    if inference.score_name == "average":
        return "average violation probability"
    if not inference.demonstrations:
        return "log-likelihood ratio if each task is shown once [nats]"
    return "log-likelihood ratio to no constraint [nats]"


def _tied(inference: Ranking) -> str:
    """Return which hypotheses share the first rank with the first; nothing if none does."""
    tied = inference.leaders[1:].tolist()
    return f", tied with {_numbered(inference, tied)}" if tied else ""


def _numbered(inference: Ranking, indices: list[int]) -> str:
    """Return a list of hypotheses by their indices: 'cells 3, 4, 5, 6, 7, 8 and 2 more'."""
    more = f" and {len(indices) - NUM_NAMED:,} more" if len(indices) > NUM_NAMED else ""
    what = noun(inference) if len(indices) == 1 else plural(noun(inference))
    return f"{what} {', '.join(map(str, indices[:NUM_NAMED]))}{more}"
