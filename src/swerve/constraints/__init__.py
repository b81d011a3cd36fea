"""Define constraints: forbidden sets of states and actions, and the rule of what enters a set."""
