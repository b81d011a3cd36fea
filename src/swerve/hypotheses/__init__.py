"""Define hypotheses, the suspected constraints, and judge which ones trajectories enter."""
