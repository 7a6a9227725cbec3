"""`diffdrive bench`: the speed of the project's own scan, side by side with C and numba in one run."""
