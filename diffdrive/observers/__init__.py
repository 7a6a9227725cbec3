"""Kalman observers of friction and load."""
