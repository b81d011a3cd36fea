"""Hold the results of sampling: weighted trajectories, estimates of Z_c / Z_0, exact answers."""
