"""Fit what demonstrators want: the rewards that they earned, and their beta."""
