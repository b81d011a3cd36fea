"""State what is asked: the MDP, its tasks, its hypotheses and the constraints already known."""
