"""An axis's loop with a measured frequency response in the place of the model's plant, and the two side by side."""

from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.frequency.resonances import Resonance, find_resonances
from diffdrive.frequency.response import FrequencyResponse, require_response
from diffdrive.linearisation import LinearLoop, StabilityMargins, linearise, stability_margins
from diffdrive.loop import measured as loop_measured
from diffdrive.loop.linearise import OperatingPoint
from diffdrive.numerics.arrays import Scalar, as_arrays
from diffdrive.results import Result, Status

# |L| below which a peak is not listed: |1 + L| stays above 0.9 there whatever its phase
LOWEST_PEAK = 0.1


class MeasuredLoop(eqx.Module):
    """The loop of an axis with a measured plant in the place of the model's, known within the measured band."""

    linear: LinearLoop  # of the model
    plant: loop_measured.MeasuredPlant

    def margins(self) -> StabilityMargins:
        """Gain and phase margins and peak sensitivity within the band; differentiable once, in the gains.

        A margin that lies outside the band does not exist here. `growth` is the model's, and infinite where the loop
        turns about -1 as the model's does not (Nyquist): it is unstable then.
        """
        return stability_margins(_margins(self.linear.open_loop, self.plant))

    def response(self, frequencies: Float[Array, " f"] | Float[np.ndarray, " f"]) -> Complex[Array, " f"]:
        """The open loop L at `frequencies` (Hz) within the band, as `LinearLoop.response` has it.

        Raises:
            ParameterError: A frequency is outside the measured band.

        """
        frequencies = jnp.asarray(frequencies, jnp.float64)
        if not isinstance(frequencies, jax.core.Tracer) and not isinstance(self.plant.grid, jax.core.Tracer):
            low, high = (float(one) for one in self.plant.band)
            outside = (frequencies < low * (1.0 - 1e-9)) | (frequencies > high * (1.0 + 1e-9))
            if bool(jnp.any(outside)):
                bad = float(frequencies[jnp.argmax(outside)])
                raise ParameterError(
                    f"frequencies: {bad:g} Hz is outside the measured band, {low:.4g} to {high:.4g} Hz"
                )
        return _response(self.linear.open_loop, self.plant, frequencies).loop

    def __repr__(self) -> str:
        return f"MeasuredLoop at {self.linear.velocity} m/s under {self.linear.load} N"


def measured_loop(
    axis: Axis,
    measured: FrequencyResponse,
    *,
    velocity: Scalar = 0.010,
    load: Scalar = 0.0,
    measured_with: Axis | None = None,
) -> MeasuredLoop:
    """The loop of an axis about a steady motion, with a measured response in the place of the model's plant.

    Pure and differentiable in the gains of `axis`: what was measured does not move with them. Where the response is
    not that of the plant itself, it is led back to it by the model of controller and amplifier.

    Args:
        axis: The drive and its controller.
        measured: The response, of any kind that `FrequencyResponse` knows.
        velocity: At which it was measured (m/s). A controller without observers does not notice.
        load: Force on the guides (N).
        measured_with: The axis with the gains at which it was measured, where these were others; of no account for a
            plant.

    Raises:
        ParameterError: As `linearise`; the band has too few values below half the control rate; the unit cannot be
            read by the axis's data sheet; or the controller has no such loop.

    Examples:
        >>> measured = read_frequency_response("speed_plant.csv", "plant", unit="(rad/s)/(N*m)")
        >>> measured_loop(axis, measured).margins()

    """
    require_response(measured)
    linear = linearise(axis, velocity=velocity, load=load)
    given = (axis if measured_with is None else measured_with).smooth()
    drive, controller = as_arrays((given.drive, given.controller))
    plant = loop_measured.measured_plant(
        drive, controller, axis.sampling, as_arrays(OperatingPoint(velocity, load)), measured.of, measured.frequency,
        measured.at_table(axis.sheet),
    )  # fmt: skip
    return MeasuredLoop(linear, lax.stop_gradient(plant))


@dataclass(frozen=True, repr=False, eq=False)
class FrequencyComparison(Result):
    """A measured loop beside the model's.

    `status.ok`: the measured loop is stable as far as the band shows it. `margins` and `model_margins` are those of the
    two loops, `resonances` and `model_resonances` the peaks of |L| above a tenth, the highest first. `frequency` (Hz),
    `loop` and `model_loop` are the two responses within the band. `departure` says how far the measured loop is from
    the model's, as a share of the model's distance to -1: |L' - L| / |1 + L|. Where it stays below one everywhere, the
    measured loop is stable if the model's is.
    """

    measured: FrequencyResponse
    frequency: Float[np.ndarray, " f"]
    loop: Complex[np.ndarray, " f"]
    model_loop: Complex[np.ndarray, " f"]
    margins: StabilityMargins
    model_margins: StabilityMargins
    resonances: tuple[Resonance, ...]
    model_resonances: tuple[Resonance, ...]
    notes: tuple[str, ...]
    status: Status

    schema: ClassVar[str] = "frequency_comparison/1"

    @property
    def departure(self) -> Float[np.ndarray, " f"]:
        """|L' - L| / |1 + L|, [f]."""
        found: Float[np.ndarray, " f"] = np.abs(self.loop - self.model_loop) / np.abs(1.0 + self.model_loop)
        return found

    @property
    def largest_departure(self) -> tuple[float, float]:
        """The largest share of the distance to -1, and its frequency (Hz)."""
        at = int(np.argmax(self.departure))
        return float(self.departure[at]), float(self.frequency[at])

    def headline(self) -> str:
        departure, at = self.largest_departure
        return (
            f"measured: {self.margins!r}; parts from the model by {departure:.2g} of its distance to -1 at {at:.4g} Hz"
        )

    def summary(self) -> str:
        rows = [f"measured  {self.margins!r}", f"model     {self.model_margins!r}"]
        departure, at = self.largest_departure
        rows.append(f"the loops part most at {at:.4g} Hz, by {departure:.2g} of the model's distance to -1")
        for name, found in (("measured", self.resonances), ("model", self.model_resonances)):
            peaks = [f"{one.frequency:.4g} Hz (damping {one.damping:.2g}, |L| {one.gain:.2g})" for one in found]
            rows.append(f"resonances {name}: {', '.join(peaks) or 'none'}")
        return "\n".join([*rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        departure, at = self.largest_departure
        return {
            "of": self.measured.of,
            "band_Hz": [float(self.frequency[0]), float(self.frequency[-1])],
            "margins": margins_as_dict(self.margins),
            "model_margins": margins_as_dict(self.model_margins),
            "resonances": [_resonance_as_dict(one) for one in self.resonances],
            "model_resonances": [_resonance_as_dict(one) for one in self.model_resonances],
            "largest_departure": departure,
            "largest_departure_Hz": at,
        }


def compare_frequency_response(
    axis: Axis, measured: FrequencyResponse, *, velocity: float = 0.010, load: float = 0.0
) -> FrequencyComparison:
    """Compare a measured frequency response with the model: both open loops, their margins, their resonances.

    Args:
        axis: The drive, and the controller with the gains at which the response was measured.
        measured: The response.
        velocity: At which it was measured (m/s).
        load: Force on the guides (N).

    Raises:
        ParameterError: As `measured_loop`.

    Examples:
        >>> comparison = compare_frequency_response(axis, read_frequency_response("AST_X1.xml"))
        >>> print(comparison)

    """
    both = measured_loop(axis, measured, velocity=velocity, load=load)
    frequency = np.asarray(both.plant.grid)
    loop, model_loop = np.asarray(both.response(frequency)), np.asarray(both.linear.response(frequency))
    margins, model_margins = both.margins(), both.linear.margins()
    peaks, model_peaks = (
        tuple(one for one in find_resonances(frequency, found) if one.gain > LOWEST_PEAK)
        for found in (loop, model_loop)
    )
    stable = bool(margins.stable)
    if stable:
        message = "ok"
    elif bool(model_margins.stable):
        message = "with the measured plant the loop is unstable: it turns about -1 as the model's does not"
    else:
        message = "the model's loop is unstable, so that nothing can be said of the measured one"
    notes = (*measured.notes, *_outside(axis, both, frequency))
    status = Status(stable, message, code="ok" if stable else "unstable")
    return FrequencyComparison(
        measured, frequency, loop, model_loop, margins, model_margins, peaks, model_peaks, notes, status
    )


def _outside(axis: Axis, both: MeasuredLoop, frequency: Float[np.ndarray, " f"]) -> list[str]:
    """What lies outside the band, and so is not judged by the measurement."""
    low, high = frequency[[0, -1]]
    model = both.linear.margins()
    notes = [f"measured from {low:.3g} to {high:.4g} Hz; nothing is known of the loop outside"]
    if not low < float(model.crossover) < high:
        notes.append(f"the model's crossover, {float(model.crossover):.3g} Hz, is outside the band: no phase margin")
    above = np.geomspace(high, 0.4999 * axis.rate, 200)[1:] if high < 0.49 * axis.rate else np.zeros(0)
    if above.size and (peak := float(np.max(np.abs(both.linear.response(above))))) > LOWEST_PEAK:
        notes.append(f"above the band the model's |L| still reaches {peak:.2g}: measure further up")
    return notes


def margins_as_dict(margins: StabilityMargins) -> dict[str, object]:
    """Margins by names that carry their unit."""
    return {
        "stable": bool(margins.stable),
        "gain_margin_up_dB": float(margins.gain_margin_up),
        "gain_margin_down_dB": float(margins.gain_margin_down),
        "phase_margin_deg": float(margins.phase_margin),
        "peak_sensitivity": float(margins.peak_sensitivity),
        "crossover_Hz": float(margins.crossover),
    }


def _resonance_as_dict(one: Resonance) -> dict[str, float]:
    return {"frequency_Hz": one.frequency, "damping": one.damping, "gain": one.gain}


_response = eqx.filter_jit(loop_measured.measured_response)
_margins = eqx.filter_jit(loop_measured.measured_margins)
