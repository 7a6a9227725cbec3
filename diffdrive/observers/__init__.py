"""Kalman observers of friction and load, and whether they converge."""
