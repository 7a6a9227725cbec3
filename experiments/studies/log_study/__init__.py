"""The log checks on logs whose fault is known: drives, faults, how answers are scored, and the command's tables."""
