"""List an inference, and the picks of greedy selection, as text and as JSON data, row by row.

Shapes: K tasks, H hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from swerve.base.phrases import shown
from swerve.inference.ranking import Ranking
from swerve.presentation import sentences
from swerve.trust import verdicts

if TYPE_CHECKING:
    from swerve.inference.greedy import Pick, Picks
    from swerve.inference.posterior import Posterior


def table(inference: Ranking, num_rows: int) -> str:
    """Return the head of the ranking as text."""
    columns = f"{'nats':>8} {'+-':>6}  {'posterior':>9}  {'violated':>8}"
    lines = [f"{'rank':>5} {'index':>6}  {columns}  hypothesis"]
    ranking, ranks = inference.ranking, inference.rank
    for index, rank in list(zip(ranking, ranks, strict=True))[:num_rows]:
        tied = "=" if np.count_nonzero(ranks == rank) > 1 else " "
        least = "≥" if inference.is_lower_bound[index] else " "
        lines.append(
            f"{rank:>4}{tied} {index:>6} {least}{inference.log_likelihood[index]:>8.2f} "
            f"{inference.standard_error[index]:>6.2f}  "
            f"{inference.posterior.hypotheses[index]:>9.4f}  "
            f"{inference.average_violation[index]:>8.3f}  {shown(inference.hypothesis_name(index))}"
        )
    if len(ranking) > num_rows:
        lines.append(f"      ... {len(ranking) - num_rows} more")
    return "\n".join(lines)


def to_json(inference: Ranking, warnings: Sequence[str]) -> dict[str, Any]:
    """Return the ranking, best first, the posterior and diagnostics of each task used.

    Values of the posterior are null where every answer that the prior allows is ruled out.

    Args:
      inference: the inference to list.
      warnings: warnings of the inference.
    """
    evidence = inference.evidence
    posterior = None if inference.is_ruled_out else inference.posterior
    used = inference.task_of.tolist() if inference.demonstrations else range(evidence.num_tasks)
    tasks = list(dict.fromkeys(used))
    verdicts_of = zip(tasks, verdicts.verdicts(inference, tasks), strict=True)
    return {
        "headline": sentences.sentence(inference),
        "problem": evidence.problem.summary,
        "score": inference.score_name,
        "tolerance": inference.tolerance,
        "num_demonstrations": len(inference.demonstrations),
        "none": _none(inference, posterior),
        "credible_set": posterior and _credible_set(inference),
        "ranking": [
            {
                "index": int(index),
                "name": inference.hypothesis_name(index),
                "log_likelihood": float(inference.log_likelihood[index]),
                "standard_error": _finite(float(inference.standard_error[index])),
                "is_lower_bound": bool(inference.is_lower_bound[index]),
                "average_violation": float(inference.average_violation[index]),
                "posterior": posterior and float(posterior.hypotheses[index]),
                "posterior_error": posterior and float(posterior.error[index]),
                "rank": int(rank),
            }
            for index, rank in zip(inference.ranking, inference.rank, strict=True)
        ],
        "struck_out": _struck_out(inference),
        "warnings": list(warnings),
        "diagnostics": [_task_diagnostics(inference, *pair) for pair in verdicts_of],
    }


def picks_table(inference: Ranking, picks: Picks) -> str:
    """Return the picks of greedy selection in order, and why it ended, as text."""
    ended = sentences.ended(inference, picks)
    if not picks:
        return f"nothing picked: {ended}"
    columns = f"{'nats':>8} {'per demo':>8} {'+-':>6}  {'log odds':>8}"
    lines = [f"{'pick':>5} {'index':>6}  {columns}  hypothesis"]
    for number, pick in enumerate(picks, 1):
        lines.append(
            f"{number:>5} {pick.hypothesis:>6}  {pick.total_gain:>8.2f} {pick.gain:>8.3f} "
            f"{pick.standard_error:>6.3f}  {pick.log_odds:>8.2f}  "
            f"{shown(inference.hypothesis_name(pick.hypothesis))}"
        )
    return "\n".join([*lines, f"      {ended}"])


def picks_to_json(inference: Ranking, picks: Picks) -> dict[str, Any]:
    """Return the picks of greedy selection in order, and why it ended; null for infinite numbers.

    After "odds" and "threshold", the entry "next" is the pick that would have followed.
    """
    following = picks.following and _pick_to_json(inference, picks.following)
    ended = {
        "why": picks.ended,
        "threshold": picks.threshold,
        "effective_samples": _finite(picks.effective_samples),
        "next": following,
    }
    return {"greedy": [_pick_to_json(inference, pick) for pick in picks], "greedy_ended": ended}


def _pick_to_json(inference: Ranking, pick: Pick) -> dict[str, Any]:
    """Return one pick as JSON data; infinite numbers become null."""
    return {
        "index": pick.hypothesis,
        "name": inference.hypothesis_name(pick.hypothesis),
        "total_gain": pick.total_gain,
        "gain": pick.gain,
        "standard_error": _finite(pick.standard_error),
        "log_odds": _finite(pick.log_odds),
    }


def _finite(value: float) -> float | None:
    """Return a number, or None where it is infinite or NaN: JSON has neither."""
    return value if math.isfinite(value) else None


def _none(inference: Ranking, posterior: Posterior | None) -> dict[str, Any]:
    """Return how probable no constraint is, and the evidence against it.

    The log Bayes factor is null where there is none, since the prior rules out every constraint,
    and where the factor is 0, since all hypotheses that the prior allows are ruled out.
    """
    return {
        "prior": float(inference.prior[0]),
        "posterior": posterior and posterior.none,
        "posterior_error": posterior and posterior.none_error,
        "log_bayes_factor": _finite(inference.log_bayes_factor),
        "least_tolerance": inference.least_tolerance,
    }


def _credible_set(inference: Ranking) -> dict[str, Any]:
    """Return the answers of the 95 % credible set and their probability together."""
    credible = inference.credible_set()
    return {
        "has_none": credible.has_none,
        "hypotheses": credible.hypotheses.tolist(),
        "probability": credible.probability,
    }


def _struck_out(inference: Ranking) -> list[dict[str, Any]]:
    """Return the hypotheses struck out, and the demonstrations that enter each of them."""
    against = inference.entered & inference.is_counted[inference.task_of]
    return [
        {
            "index": index,
            "name": inference.hypothesis_name(index),
            "impossible": bool(inference.impossible[index]),
            "entered_by": [
                inference.demonstrations[d].name for d in np.flatnonzero(against[:, index])
            ],
        }
        for index in np.flatnonzero(inference.struck_out).tolist()
    ]


def _task_diagnostics(inference: Ranking, task: int, verdict: str) -> dict[str, Any]:
    """Return how well a task was sampled, and the given verdict on its samples."""
    evidence = inference.evidence
    return {
        "task": task,
        "demonstrations": inference.demonstrations_of(task),
        "start": evidence.tasks.start[task].tolist(),
        "goal": evidence.tasks.goal[task].tolist(),
        "solver": evidence.solver,
        "method": evidence.method,
        "num_trajectories": evidence.num_trajectories,
        "effective_sample_size": float(evidence.effective_sample_size[task]),
        "log_partition": float(evidence.log_partition[task]),
        "kl": float(evidence.kl[task]),
        "island_spread": float(evidence.island_spread[task]),
        "distinct_share": float(evidence.distinct_share[task]),
        "verdict": verdict,
    }
