from .diagnosis.workflow import Cause, DiagnosisResult, diagnose
from .identification.workflow import IdentificationResult, identify

__all__ = ["Cause", "DiagnosisResult", "IdentificationResult", "diagnose", "identify"]
