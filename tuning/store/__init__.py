"""Finished parts of long computations, kept so that they continue after an interruption."""
