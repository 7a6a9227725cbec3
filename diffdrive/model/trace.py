"""The trace of a control: how often it writes a row of a log, and how the values of a row come about."""

import equinox as eqx
import jax
import numpy as np

from diffdrive.errors import ParameterError
from diffdrive.model.quantity import check, quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.messages import short_repr
from diffdrive.support.rates import RATE_TOLERANCE

CHOICES = {  # of the fields that are words
    "sample": ("snapshot", "mean"),
    "command": ("set-point", "force"),
    "encoders": ("all", "scale", "motor"),
}


class Trace(eqx.Module):
    """What a control writes into a log of the signals that its loops have. By default each control sample, as it is.

    A row is a `sample` of the control: a snapshot of its values at one control step, or their mean over the steps since
    the row before. Its position is that of the scale, and the motor's stands beside it; with `encoders` "motor" its
    position is the motor's, with "scale" there is no other.

    The command column holds the set-point of the force, which is held from one control step to the next, or the force
    that acts, as a measured current times its nominal constant. It may be of another instant than the rest of its row:
    `command_offset` is positive where it is later, and at most one row. At whole control steps that is exact; in
    between, the column is the mean of the held command over one control step, which is linear in the offset.
    """

    rate: float | None = eqx.field(static=True, default=None)  # Hz, of rows; None: of the control
    sample: str = eqx.field(static=True, default="snapshot")
    command: str = eqx.field(static=True, default="set-point")
    encoders: str = eqx.field(static=True, default="all")
    command_noise: Scalar | None = quantity(
        "N", "standard deviation of the white noise of the command column; absent: none", at_least=0.0, default=None
    )
    command_offset: Scalar | None = quantity(
        "s", "instant of the command column after that of its row; absent: the same", default=None
    )

    def __check_init__(self) -> None:
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                words = " or ".join(f'"{word}"' for word in known)
                raise ParameterError(f"trace.{name} must be {words}, got {short_repr(getattr(self, name))}")
        is_rate = isinstance(self.rate, int | float | np.number) and not isinstance(self.rate, bool)
        if self.rate is not None and not (is_rate and np.isfinite(self.rate) and self.rate > 0):
            raise ParameterError(f"trace.rate must be a positive number in Hz, got {short_repr(self.rate)}")

    def stride(self, rate: float) -> int:
        """Samples at `rate` (Hz) from one row to the next; raises `ParameterError` where they are no whole number."""
        if self.rate is None:
            return 1
        ratio = rate / self.rate
        count = round(ratio)
        if count < 1 or abs(ratio / count - 1.0) > RATE_TOLERANCE:
            raise ParameterError(
                f"trace.rate of {self.rate:g} Hz is {ratio:.6g} samples of {rate:g} Hz: a row is written each so many "
                "whole samples of the control"
            )
        return count

    def rows(self, count: int, rate: float) -> slice:
        """The samples, of `count` at `rate` (Hz), at which rows are written: means have seen a whole row before."""
        stride = self.stride(rate)
        first = stride - 1 if self.sample == "mean" else 0
        return slice(first, first + (count - first - 1) // stride * stride + 1, stride)

    @property
    def position_encoder(self) -> str:
        """Whose reading the log's position is."""
        return "motor" if self.encoders == "motor" else "scale"


def check_trace(trace: Trace, rate: float, has_motor_encoder: bool) -> None:
    """Raise `ParameterError` where a control at `rate` (Hz) cannot write this trace."""
    check(trace, "trace")
    row = trace.stride(rate) / rate
    offset = trace.command_offset
    if offset is not None and not isinstance(offset, jax.core.Tracer) and np.any(np.abs(np.asarray(offset)) > row):
        raise ParameterError(f"trace.command_offset must be within one row, {row:g} s early or late, got {offset:g}")
    if trace.encoders == "motor" and not has_motor_encoder:
        raise ParameterError(
            'trace.encoders is "motor", and the drive has no motor_encoder: give it one, or trace "all"'
        )
