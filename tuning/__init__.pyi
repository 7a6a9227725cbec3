from .accuracy.result import SeverityResult
from .accuracy.severity import severity
from .comparison.result import ComparisonResult
from .comparison.workflow import compare
from .diagnosis.selection.stages import Stage
from .diagnosis.workflow import Cause, DiagnosisResult, diagnose
from .gains.notch import propose_notch
from .gains.objective import Objective, register_aggregation
from .gains.pareto import ParetoFront, ParetoPoint, pareto_front
from .gains.requirements import AsGiven, Requirements
from .gains.result import TuningResult
from .gains.workflow import tune
from .identification.controller.workflow import ControllerEstimate, identify_controller
from .identification.workflow import IdentificationResult, identify
from .sweeps.result import SweepResult
from .sweeps.workflow import sweep
from .unknown_trace.workflow import StartResult, start

__all__ = [
    "AsGiven",
    "Cause",
    "ComparisonResult",
    "ControllerEstimate",
    "DiagnosisResult",
    "IdentificationResult",
    "Objective",
    "ParetoFront",
    "ParetoPoint",
    "Requirements",
    "SeverityResult",
    "Stage",
    "StartResult",
    "SweepResult",
    "TuningResult",
    "compare",
    "diagnose",
    "identify",
    "identify_controller",
    "pareto_front",
    "propose_notch",
    "register_aggregation",
    "severity",
    "start",
    "sweep",
    "tune",
]
