"""The work folder: the results of one problem, kept for the next call."""
