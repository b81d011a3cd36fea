"""Ground of all packages: what knows no constraint, no problem and no trajectory."""
