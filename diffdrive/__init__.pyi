from . import controllers, effects, logs, motion
from .axis import Axis
from .axis_file.drive_file import read_axis
from .linearisation import LinearLoop, StabilityMargins, linearise
from .logs.encoders.comparison import compare_encoders
from .logs.encoders.result import EncoderComparison
from .logs.log import Log
from .logs.read import read_log, read_logs
from .loop.recording import Recording, record
from .loop.run import Run
from .model.data_sheet import DataSheet
from .model.trace import Trace
from .motion import load
from .paper import paper_axis
from .runtime import configure
from .simulation import Rollout, rollout, simulate

__all__ = [
    "Axis",
    "DataSheet",
    "EncoderComparison",
    "LinearLoop",
    "Log",
    "Recording",
    "Rollout",
    "Run",
    "StabilityMargins",
    "Trace",
    "compare_encoders",
    "configure",
    "controllers",
    "effects",
    "linearise",
    "load",
    "logs",
    "motion",
    "paper_axis",
    "read_axis",
    "read_log",
    "read_logs",
    "record",
    "rollout",
    "simulate",
]
