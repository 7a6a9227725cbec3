from .checks.examine import examine, examine_together, register_check
from .checks.finding import Finding
from .checks.repair import (
    AddToChannel,
    Repair,
    RepairStep,
    ScaleChannel,
    ShiftChannel,
    SwapChannels,
    UnwrapChannel,
)
from .formats.registry import register_format
from .formats.table import Table
from .log import Log
from .mapping import ColumnMapping
from .read import read_log, read_logs
from .write import write_log

__all__ = [
    "AddToChannel",
    "ColumnMapping",
    "Finding",
    "Log",
    "Repair",
    "RepairStep",
    "ScaleChannel",
    "ShiftChannel",
    "SwapChannels",
    "Table",
    "UnwrapChannel",
    "examine",
    "examine_together",
    "read_log",
    "read_logs",
    "register_check",
    "register_format",
    "write_log",
]
