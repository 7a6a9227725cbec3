"""Which effects explain the logs: screening, fits, one effect after the other."""
