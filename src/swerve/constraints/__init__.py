"""Constraints: what may be forbidden, and the rule of what enters it."""
