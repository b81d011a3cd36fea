"""Hypotheses: suspected constraints, judged in bulk and step by step, as packed bits."""
