"""Learn: ways to the nominal distribution pi_0, one file a solver, and the table-driven `learn`."""
