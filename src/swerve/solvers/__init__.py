"""Ways to the nominal distribution pi_0, one file each."""
