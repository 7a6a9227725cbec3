from . import controllers, effects, logs, motion
from .axis import Axis
from .axis_file.drive_file import read_axis
from .frequency.read import read_frequency_response
from .frequency.response import FrequencyResponse
from .library.listing import LibraryAxis, axes
from .library.provenance import Provenance
from .linearisation import LinearLoop, StabilityMargins, linearise
from .logs.encoders.comparison import compare_encoders
from .logs.encoders.result import EncoderComparison
from .logs.log import Log
from .logs.read import read_log, read_logs
from .loop.recording import Recording, record
from .loop.run import Run
from .measured_loop import FrequencyComparison, MeasuredLoop, compare_frequency_response, measured_loop
from .model.data_sheet import DataSheet
from .model.trace import Trace
from .model.uncertainty import Deviation, Uncertainty
from .motion import load
from .paper import paper_axis
from .runtime import configure
from .simulation import Rollout, rollout, simulate

__all__ = [
    "Axis",
    "DataSheet",
    "Deviation",
    "EncoderComparison",
    "FrequencyComparison",
    "FrequencyResponse",
    "LibraryAxis",
    "LinearLoop",
    "Log",
    "MeasuredLoop",
    "Provenance",
    "Recording",
    "Rollout",
    "Run",
    "StabilityMargins",
    "Trace",
    "Uncertainty",
    "axes",
    "compare_encoders",
    "compare_frequency_response",
    "configure",
    "controllers",
    "effects",
    "linearise",
    "load",
    "logs",
    "measured_loop",
    "motion",
    "paper_axis",
    "read_axis",
    "read_frequency_response",
    "read_log",
    "read_logs",
    "record",
    "rollout",
    "simulate",
]
