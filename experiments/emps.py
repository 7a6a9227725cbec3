"""A real axis: the EMPS benchmark (Janot et al. 2019), replayed in closed loop and fitted by gradient."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.io

from diffdrive.controllers import Cascade
from diffdrive.controllers.cascade import CascadeState
from diffdrive.friction import stribeck_level
from diffdrive.motion import Motion, from_array
from diffdrive.parameters import Drive, Friction, Plant, Sampling, as_arrays
from diffdrive.plant import PlantState
from diffdrive.simulate import inputs_of, rollout, start
from tuning.least_squares import Progress, Search, levenberg_marquardt, silent
from tuning.space import Free, space_of

FILES = {"estimation": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
PULSE_GAIN = 1.0139  # V per unit of pulses_N, see docs/emps.md
SAMPLING = Sampling(rate=1_000.0, substeps=20)


@dataclass(frozen=True)
class Record:
    """One EMPS file in SI units: motion, measured position (m), total force command and the pulses within it (N)."""

    motion: Motion
    position: np.ndarray
    command: np.ndarray
    added: np.ndarray
    position_gain: float  # 1/s
    velocity_gain: float  # N s/m


def find_folder() -> Path | None:
    """The EMPS data beside this checkout or the working folder, or None."""
    for beside in (Path.cwd(), Path(__file__).resolve().parent.parent):
        folder = beside.parent / "shared" / "data" / "emps"
        if (folder / FILES["estimation"]).is_file():
            return folder
    return None


def read(path: Path) -> Record:
    """Read one file. Its `vir` and `pulses_N` are volts, whatever their names say; gtau turns them into newtons."""
    data = scipy.io.loadmat(path)
    force_per_volt = float(data["gtau"].item())
    command = force_per_volt * data["vir"].ravel()
    pulses = data["pulses_N"].ravel() if "pulses_N" in data else np.zeros_like(command)
    time = np.arange(len(command)) / SAMPLING.rate  # its own time stamps are rounded
    return Record(
        motion=from_array(time, data["qg"].ravel(), name=path.name),
        position=data["qm"].ravel(),
        command=command,
        added=force_per_volt * PULSE_GAIN * pulses,
        position_gain=float(data["kp"].item()),
        velocity_gain=float(data["kv"].item()) * force_per_volt,
    )


def reference_drive() -> Drive:
    """The benchmark's own parameters (inverse-dynamics least squares), with a stiff bristle under them."""
    return Drive(
        plant=Plant(mass=95.1089, damping=0.0, constant_force=3.1648),
        friction=Friction(
            coulomb_screw=20.3935,
            load_coefficient=0.0,
            initial_load=0.0,
            breakaway_gap=1e-3,
            stribeck_velocity=1e-3,
            viscous=203.5034,
            bristle_stiffness=1e6,
            bristle_damping=3e3,
        ),
    )


def controller(record: Record) -> Cascade:
    """The benchmark's controller: kp kv e - kv dq/dt, dq/dt the backward difference of the two-sample mean."""
    return Cascade(kp=record.position_gain, kv=record.velocity_gain, velocity_samples=2)


def replay(drive: Drive, cascade: Cascade, given: Any) -> tuple[Any, Any]:
    """Simulated position (m) and force command (N), the pulses not included, in closed loop."""
    inputs, position, velocity = given
    travel = velocity * SAMPLING.period
    past = (position - travel, position - 2 * travel)
    deflection = jnp.sign(velocity) * stribeck_level(drive.friction, velocity, 0.0)
    moving = start(drive, cascade, position)._replace(
        plant=PlantState(position, velocity, deflection / drive.friction.bristle_stiffness.towards(velocity)),
        controller=CascadeState(past, jnp.zeros(()), jnp.ones(())),
    )
    frame = rollout(drive, cascade, inputs, SAMPLING, begin=moving)
    return frame.position, frame.command


def inputs(record: Record) -> Any:
    """What the simulation is given: reference, pulses as a disturbing force, and where the log begins, in motion."""
    velocity = (record.position[2] - record.position[0]) / (2 * SAMPLING.period)
    given = inputs_of(record.motion, np.zeros(len(record.position)), record.added)
    return as_arrays((given, record.position[0], velocity))


@dataclass(frozen=True)
class Gap:
    """How far the simulation is from the log."""

    force_percent: float  # 100 |F_sim - F_log| / |F_log|
    position_rms: float  # m
    position: np.ndarray
    command: np.ndarray


_replay = jax.jit(replay)


def gap(drive: Drive, record: Record) -> Gap:
    """Simulate `record` in closed loop and compare force and position with the log."""
    position, command = (np.asarray(s) for s in _replay(*as_arrays((drive, controller(record))), inputs(record)))
    total = command + record.added
    miss = np.linalg.norm(total - record.command) / np.linalg.norm(record.command)
    rms = float(np.sqrt(np.mean((position - record.position) ** 2)))
    return Gap(100 * float(miss), rms, position, total)


FREE = (
    Free("plant.mass", 50.0, 200.0),
    Free("plant.constant_force", -20.0, 20.0),
    Free("friction.viscous", 50.0, 800.0),
    Free("friction.coulomb_screw", 5.0, 80.0),
    Free("friction.bristle_stiffness", 1e5, 1e7),
    Free("friction.bristle_damping", 1e2, 1e5),
)


def fit(drive: Drive, record: Record, *, max_steps: int = 12, progress: Progress = silent) -> tuple[Drive, Search]:
    """Fit mass, offset and friction to the force of one record by gradient through the closed loop."""
    space = space_of(drive, FREE)
    norm = float(np.linalg.norm(record.command))
    given = as_arrays((drive, controller(record), inputs(record), record.command - record.added))

    def residuals(y: Any, args: Any) -> Any:
        before, cascade, at, logged = args
        return 100 * (replay(space.insert(before, y), cascade, at)[1] - logged) / norm

    search = levenberg_marquardt(
        residuals, np.zeros(len(FREE)), given, max_steps=max_steps, tolerance=1e-3, progress=progress
    )
    return jax.tree.map(float, space.insert(as_arrays(drive), search.y)), search
