"""A notch on the resonance that the linearised loop shows, as a start from which `tune` moves it."""

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.controllers import Notch
from diffdrive.errors import ParameterError
from diffdrive.frequency.resonances import find_resonances
from diffdrive.linearisation import linearise
from diffdrive.loop.margins import LOWEST_FREQUENCY
from diffdrive.numerics.arrays import Scalar

# The peak of a damping E is 2 E wide, in the logarithm of frequency: of 0.5 % damping there are four points in it.
POINTS_PER_DECADE = 1_000
# Damping of the notch's denominator. Far below its frequency f the notch lags by 2 D times the share of f: at a
# crossover of a third of f by 12 degrees, which leaves a loop of the usual 45 degrees its 30.
NOTCH_DAMPING = 0.3


def propose_notch(axis: Axis, *, velocity: Scalar = 0.010, load: Scalar = 0.0, machine: Axis | None = None) -> Axis:
    """The axis with a notch on its resonance: the highest peak of the loop's gain above the crossover.

    The notch is as deep as the resonance is high: its numerator has the damping of the peak, from its width at -3 dB,
    its denominator one of 0.3. It is a start: `tune` moves its frequency, width and depth together with the gains.
    The loop need not be stable. Asked again, it finds the next resonance.

    Args:
        axis: With a controller that has filters, such as a cascade, and a resonance, such as the effect `compliance`.
        velocity: At which the loop is linearised (m/s).
        load: Force on the guides (N).
        machine: An axis whose drive replaces the axis's own, as in `simulate`.

    Raises:
        ParameterError: The controller has no filters, or the loop no such peak.

    Examples:
        >>> best = tune(propose_notch(axis), requirements=Requirements(command_noise=None))
        >>> best.gains["filter1_frequency"]

    """
    require_axis(axis)
    highest = 0.499 * axis.rate
    count = int(POINTS_PER_DECADE * np.log10(highest / LOWEST_FREQUENCY))
    frequency = np.geomspace(LOWEST_FREQUENCY, highest, count)
    loop = linearise(axis, velocity=velocity, load=load, machine=machine)
    found = next(iter(find_resonances(frequency, np.asarray(loop.response(frequency)))), None)
    if found is None or found.damping >= NOTCH_DAMPING:
        raise ParameterError(
            f"no resonance: above the crossover the loop's gain has no peak with a damping below {NOTCH_DAMPING:g}; "
            "state that of the machine, as in [effects.compliance]"
        )
    depth = 20.0 * float(np.log10(NOTCH_DAMPING / found.damping))
    notch = Notch(frequency=found.frequency, width=2.0 * NOTCH_DAMPING * found.frequency, depth=depth)
    return axis.with_controller(axis.controller.with_filter(notch))
