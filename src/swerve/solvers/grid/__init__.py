"""The grid solver: soft dynamic programming on a grid of states, for few state dimensions."""
