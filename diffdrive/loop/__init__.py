"""The closed loop: its step, its roll-out, its linearisation, its convergence, and what is measured of it."""
