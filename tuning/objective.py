"""What a controller is tuned for: following the reference under every load, quietly, with a true load estimate."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.motion import Motion
from diffdrive.parameters import Drive, Sampling, Sensor, as_arrays
from diffdrive.simulate import Inputs, inputs_of, rollout
from diffdrive.smooth import smooth


class Scales(NamedTuple):
    """What counts as equally bad: one unit of cost each."""

    error: float = 2e-8  # m of RMS tracking error
    command_noise: float = 20.0  # N of RMS command noise
    load_error: float = 1000.0  # N of RMS load error


class Ensemble(eqx.Module):
    """Scenarios to tune on: one motion under several loads, each with its own noise."""

    drive: Drive
    inputs: Inputs
    sampling: Sampling = eqx.field(static=True)
    settled: int = eqx.field(static=True)
    scales: Scales = eqx.field(static=True)

    def residuals(self, controller: Controller) -> Float[Array, " m"]:
        """Residuals whose sum of squares is the mean over the loads of the squared costs.

        Per load and sample, after the first `settled` samples: tracking error, change of the command, load error.
        """

        def one_load(load: Float[Array, " n"], key: Array) -> Float[Array, " p"]:
            inputs = self.inputs._replace(load=load)
            frame = rollout(self.drive, controller, inputs, self.sampling, key)
            error = inputs.reference.position - frame.position
            parts = [
                error[self.settled :] / self.scales.error,
                jnp.diff(frame.command)[self.settled - 1 :] / (np.sqrt(2) * self.scales.command_noise),
            ]
            if frame.estimate is not None and frame.estimate.load is not None:
                parts.append((frame.estimate.load - load)[self.settled :] / self.scales.load_error)
            return jnp.concatenate(parts)

        lanes = len(self.inputs.load)
        stacked = jax.vmap(one_load)(self.inputs.load, jax.random.split(jax.random.key(0), lanes))
        samples = self.inputs.load.shape[1] - self.settled
        return (stacked / np.sqrt(lanes * samples)).ravel()


def ensemble(
    drive: Drive,
    motion: Motion,
    loads: Float[np.ndarray, "lanes n"],
    sampling: Sampling,
    *,
    settle: float,
    scales: Scales = Scales(),
) -> Ensemble:
    """An ensemble on the smooth variant of `drive`; costs count from `settle` (s) on.

    The scale's quantiser is replaced by the white noise of the same variance, resolution^2 / 12.
    """
    sensor = drive.sensor
    rounding = 0.0 if sensor.resolution is None else float(sensor.resolution) ** 2 / 12
    noise = float(np.sqrt(float(sensor.noise) ** 2 + rounding))
    noisy = eqx.tree_at(lambda d: d.sensor, drive, Sensor(None, noise), is_leaf=lambda leaf: leaf is sensor)
    inputs = inputs_of(motion, np.asarray(loads))
    return Ensemble(as_arrays(smooth(noisy)), inputs, sampling, max(1, round(settle * sampling.rate)), scales)
