"""The second design of the diagnosis: every hypothesis beside free functions of what a missing force may depend on."""
