"""Compute scores, rankings, posteriors, picks and pairs from evidence and demonstrations."""
