"""The closed loop: its step, its roll-out, its linearisation, and what is measured of it."""
