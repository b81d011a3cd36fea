"""The ground of all packages: modules that know no constraint, problem or trajectory."""
