"""Read recorded demonstrations from files, and check them before anything is computed."""
