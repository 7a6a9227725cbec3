"""Gradient search against a genetic one."""
