"""The gridworld: greedy inference from tables, compared with another implementation."""
