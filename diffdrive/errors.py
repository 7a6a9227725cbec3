"""The errors and warnings that diffdrive raises; each message says what, where, and what to do."""

from typing import Any

from diffdrive.support.messages import printable


class DiffdriveError(Exception):
    """Base of every error that diffdrive raises on purpose: one line, with control characters written out."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*(printable(argument) if isinstance(argument, str) else argument for argument in arguments))


class ParameterError(DiffdriveError, ValueError):
    """A parameter is missing, not finite, out of its range, or in the wrong unit."""


class MotionError(DiffdriveError, ValueError):
    """A motion or load profile cannot be run: beyond the limits, not uniform in time, not finite."""


class DriveFileError(DiffdriveError, ValueError):
    """A drive file cannot be read: it names the file, the key and the remedy."""


class PrecisionError(DiffdriveError, RuntimeError):
    """JAX runs in single precision, in which the observer's covariance is rounding noise."""


class ResultError(DiffdriveError, RuntimeError):
    """A result is not ok, and the caller asked for an error in the place of a status: `result` is the result itself."""

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


class DivergenceError(ResultError):
    """A simulation diverged and the caller asked for an error instead of a status."""


class LoadEstimatorError(DiffdriveError, ValueError):
    """An eq. (20) load estimator does not converge at a speed where it must."""


class LoadEstimatorWarning(UserWarning):
    """An eq. (20) load estimator does not converge at a speed where it is about to be used."""


class LogError(DiffdriveError, ValueError):
    """A log cannot be read, written or used: it names the file, the row or column, and the remedy."""


class CheckpointError(DiffdriveError, ValueError):
    """A checkpoint is damaged, or of another problem than the one to go on with."""
