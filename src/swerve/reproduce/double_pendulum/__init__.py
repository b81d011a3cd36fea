"""The double pendulum: a constraint in four dimensions, by networks and by tables."""
