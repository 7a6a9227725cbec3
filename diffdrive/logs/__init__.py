"""Logs of machines and of simulations: one type, its files, and what is wrong with them."""

from diffdrive.logs.log import Log
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.logs.read import read_log, read_logs
from diffdrive.logs.write import write_log

__all__ = ["ColumnMapping", "Log", "read_log", "read_logs", "write_log"]
