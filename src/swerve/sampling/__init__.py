"""Sample trajectories of the nominal distribution, and reduce them to evidence."""
