"""Zero-phase low-pass, differences and decimation: what inverse dynamics needs of a measured position.

The filters are those of the EMPS benchmark (Janot et al. 2019) and of MATLAB's `decimate`, in second-order sections: as
a ratio of polynomials the Chebyshev filter of a 20 kHz log loses all its digits. They are padded over the same time at
every rate, and at 1 kHz by as many samples as MATLAB's `filtfilt`.
"""

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, cheby1, sosfiltfilt

Signal = Float[np.ndarray, " n"]

LOWPASS_ORDER = 4
CHEBYSHEV_ORDER, CHEBYSHEV_RIPPLE, CHEBYSHEV_CORNER = 8, 0.05, 0.8  # dB; share of the decimated Nyquist frequency


def lowpass(signal: Signal, rate: float, cutoff: float) -> Signal:
    """`signal` through a Butterworth low-pass forward and backward: -6 dB at `cutoff` (Hz), no delay.

    The signal must be longer than 1.2 / `cutoff` seconds. Where its origin lies does not matter, to rounding.
    """
    padding = max(1, round(1.2 * rate / cutoff))
    sections = butter(LOWPASS_ORDER, cutoff, fs=rate, output="sos")
    origin = signal[0]  # so a resting table has no velocity at all
    return origin + sosfiltfilt(sections, signal - origin, padlen=padding)


def difference(signal: Signal, rate: float) -> Signal:
    """Derivative of `signal` per second by central differences, one-sided at the ends."""
    return np.gradient(signal, 1.0 / rate)


def differentiate(position: Signal, rate: float, cutoff: float) -> tuple[Signal, Signal]:
    """Velocity and acceleration of `position`, low-passed at `cutoff` (Hz)."""
    velocity = difference(lowpass(position, rate, cutoff), rate)
    return velocity, difference(velocity, rate)


def decimate(signal: Signal, ratio: int) -> Signal:
    """Each `ratio`-th sample of the low-passed `signal`, the last one included, without delay."""
    if ratio == 1:
        return signal
    corner = CHEBYSHEV_CORNER / ratio
    sections = cheby1(CHEBYSHEV_ORDER, CHEBYSHEV_RIPPLE, corner, output="sos")
    slow_gain = 10 ** (-2 * CHEBYSHEV_RIPPLE / 20)  # of an even order, passed twice; MATLAB leaves it in
    return sosfiltfilt(sections, signal, padlen=round(2.4 * ratio))[decimation_slice(len(signal), ratio)] / slow_gain


def decimation_slice(count: int, ratio: int) -> slice:
    """Which of `count` samples `decimate` keeps."""
    return slice((count - 1) % ratio, None, ratio)
