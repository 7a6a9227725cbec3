"""Checks of a log, one kind of trap per file; `diffdrive.logs.plausibility` runs them all."""
