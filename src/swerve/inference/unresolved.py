"""Say which open scores can change an answer, and which to work out first.

A score is open where hardly any nominal trajectory avoids the hypothesis (see `Scores.is_open`):
the true log Z_c / Z_0 may lie far below what the samples tell. With M nats for each demonstration
whose ratio is open, the log-likelihood of c is at most

    log L(c) <= sum_d log L_d(c; log Z_c / Z_0 = -M where it is open),

to which demonstrations that enter c still contribute log eps each. The hypothesis can change the
answer if this bound reaches the first of the ranking, or gives c a share of the posterior.

Shapes: K tasks, H hypotheses.
"""

from __future__ import annotations

import numpy as np

from swerve.inference import likelihood
from swerve.inference.ranking import Ranking

MOST_NATS = 50.0  # M: by chance one trajectory in 10^22 avoids the hypothesis, less than any found
MARGIN = 2.0  # times the largest known M: where known ratios are smaller, open ones may be too
LEAST_SHARE = 1e-3  # posterior probability: smaller ones change no answer


def worth_resolving(ranking: Ranking) -> np.ndarray:
    """Return the open hypotheses that can change the answer, best first.

    The best are those whose log-likelihood by the samples is largest.
    """
    is_open = ranking.is_open
    candidates = np.flatnonzero(is_open.any(axis=0))
    if not len(candidates):
        return candidates
    ratio = ranking.finite_log_ratio
    most = max(MOST_NATS, -MARGIN * float(ratio.min()))
    least_ratio = np.where(is_open, np.minimum(ratio, -most), ratio)
    highest = likelihood.log_likelihood(least_ratio, ranking.counts, ranking.tolerance)
    now = ranking.log_likelihood
    with np.errstate(divide="ignore"):
        log_prior = np.log(ranking.prior)
    in_all = np.logaddexp.reduce(np.concatenate([log_prior[:1], now + log_prior[1:]]))
    leads = highest >= now[~ranking.struck_out].max()
    has_share = highest + log_prior[1:] >= np.log(LEAST_SHARE) + in_all
    candidates = candidates[(leads | has_share)[candidates]]
    return candidates[np.argsort(-now[candidates], kind="stable")]
