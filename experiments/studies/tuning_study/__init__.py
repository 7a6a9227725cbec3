"""The gradient tuner against derivative-free searches."""
