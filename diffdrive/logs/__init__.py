"""Logs of machines and of simulations: one type, its files, and what is wrong with them."""

from diffdrive.logs.log import Log

__all__ = ["Log"]
