"""Solvers and search spaces."""
