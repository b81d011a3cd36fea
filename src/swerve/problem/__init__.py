"""Define the problem to solve: the MDP, its tasks, the hypotheses and the known constraints."""
