"""Making demonstrations: samples of pi_c, optimal control, and human-like drivers of the car."""
