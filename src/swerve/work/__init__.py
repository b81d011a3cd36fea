"""The work folder: what one problem has cost so far, kept for the next call."""
