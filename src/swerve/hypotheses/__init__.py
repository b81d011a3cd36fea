"""Hypotheses: constraints that are suspected, judged in bulk and step by step."""
