"""The pendulum: the rank of the true constraint, by every way to infer."""
