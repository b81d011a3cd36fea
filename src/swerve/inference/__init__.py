"""Numbers from evidence and demonstrations: scores, rankings, posteriors, picks, pairs."""
