"""Checks of a log, one kind of trap per file; `diffdrive.logs.checks.examine` runs them all."""
