"""What sampling tells: weighed trajectories, estimates of Z_c / Z_0, exact answers, files."""
