"""Run a policy, from the start of a task or onwards from any state."""
