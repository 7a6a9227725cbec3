"""Mass, friction and offset of an axis from its logs by least squares on the inverse-dynamics model.

Write the force as it follows from the measured motion, with unknown parameters (tuning/identification/regressors.py):

    command + disturbance = M a + Fv v + Fc sign(v) - constant_force

It is linear in them. Velocity and acceleration come from the position, low-passed without phase at five times the
highest frequency of interest (`dynamics`) and differenced; all signals are then decimated to the band of the dynamics
(Gautier 1997; Janot, Vandanjon and Gautier 2014). On the EMPS data (docs/evidence/emps.md) `BENCHMARK_BORDERS` gives
the benchmark's own figures.

What it cannot know: a force that acts late. With a delay T between the command and the force, mass comes out heavier by
Fv T; the zero-order hold alone is half a control period. It is a start for a fit through the closed loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import minimum_filter1d

from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.model.quantity import Directional
from tuning.identification.determined import solve
from tuning.identification.regressors import SYMMETRIC, Kinematics, Regressors
from tuning.identification.stretches import Stretch, stretches
from tuning.identification.zero_phase import decimate, decimation_slice, differentiate

Signal = Float[np.ndarray, " n"]

DYNAMICS = 20.0  # Hz
MIN_SPEED = 1e-3  # m/s; below, the sign of the velocity says nothing about the direction of friction
BOTH_ENDS = (1.0, 1.0)
BENCHMARK_BORDERS = (1.0, 0.0)
LOAD_SPREAD = 0.05  # of the largest load: smaller differences say nothing about the slope


@dataclass(frozen=True)
class Piece:
    """One stretch of a log without a gap, decimated: arrays of shape [n].

    `force` is command + disturbance, `model` what the identified parameters make of the motion; `used` marks the
    samples at which the table was fast enough. All have passed the decimation filter.
    """

    log: str
    time: Signal  # s
    velocity: Signal  # m/s
    acceleration: Signal  # m/s2
    load: Signal  # N
    force: Signal  # N
    model: Signal  # N
    used: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class Evaluation:
    """The model beside the measured force on some logs; `error_percent` is 100 |force - model| / |force|, as used."""

    error_percent: float
    pieces: tuple[Piece, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class InverseDynamics:
    """What the inverse-dynamics model of some logs says about the axis.

    `values` and `standard_errors` hold each parameter of the regressors by name, in SI units; NaN where the data do not
    determine it, and `notes` say why. Standard errors are robust to coloured residuals and to residuals of changing
    size, but know nothing of what the model leaves out. `condition` is that of the columns scaled to unit length.
    `load` is the mean applied load, N. Where loads did not differ, the Coulomb friction is that at `load`; where they
    did, that at no load, beside its slope `load_coefficient`.
    """

    regressors: Regressors
    values: dict[str, float]
    standard_errors: dict[str, float]
    coefficients: Float[
        np.ndarray, " p"
    ]  # of least norm where some are not determined: what the model's force is made of
    condition: float
    load: float
    dynamics: float  # Hz
    min_speed: float  # m/s
    borders: tuple[float, float]
    fit: Evaluation
    notes: tuple[str, ...]

    @property
    def mass(self) -> float:
        """Moving mass, kg."""
        return self.values["mass"]

    @property
    def viscous(self) -> Directional:
        """Viscous friction and damping together, N s/m."""
        return self._directional("viscous")

    @property
    def coulomb(self) -> Directional:
        """Coulomb friction, N, at no load or at `load`."""
        return self._directional("coulomb")

    @property
    def load_coefficient(self) -> Directional | None:
        """Slope of the Coulomb friction over the applied load; None where the loads did not differ."""
        known = any(name.startswith("load_coefficient") for name in self.values)
        return self._directional("load_coefficient") if known else None

    @property
    def constant_force(self) -> float | None:
        """Constant force on the table, N; None where the regressors count it to the Coulomb friction."""
        return self.values.get("constant_force")

    def _directional(self, name: str) -> Directional:
        both = self.values.get(name, float("nan"))
        return Directional(self.values.get(f"{name}.positive", both), self.values.get(f"{name}.negative", both))


def identify(
    logs: Log | Sequence[Log],
    regressors: Regressors = SYMMETRIC,
    *,
    dynamics: float = DYNAMICS,
    min_speed: float = 0.0,
    borders: tuple[float, float] = BOTH_ENDS,
) -> InverseDynamics:
    """Identify mass, friction and offset from one or several logs, each under any applied load.

    `dynamics` (Hz): the highest frequency of the motion and of the control loop that is of interest. `min_speed`
    (m/s): samples at which the table, within the decimation filter's reach, moves slower than this are left out, since
    the sign of a resting table's velocity is noise and its friction anything up to the breakaway force; 0 leaves out
    none. `borders`: how much of the 0.98 / `dynamics` seconds that the filters spoil is cut from the beginning and the
    end of each piece. The benchmark's script keeps the end, which does no harm where the table rests there.

    Raises `LogError` where no piece of the logs is long enough, or the table nowhere faster than `min_speed`.
    """
    sources, notes = stretches(logs, dynamics)
    loads = np.concatenate([source.load for source in sources])
    if np.ptp(loads) > LOAD_SPREAD * np.max(np.abs(loads)):
        regressors = regressors.with_load()
    tables = [_table(source, regressors, dynamics, min_speed, borders) for source in sources]
    used = np.concatenate([table.used for table in tables])
    speed = max(float(np.max(np.abs(table.kinematics.velocity))) for table in tables)
    if not used.any() or speed <= 0:
        logs_used = ", ".join(dict.fromkeys(source.log for source in sources))
        raise LogError(
            f"{logs_used}: the table does not move faster than {min_speed:g} m/s for long enough (its peak is "
            f"{speed:.3g} m/s): nothing to identify; use a log of a motion"
        )
    columns = np.concatenate([table.columns for table in tables])
    force = np.concatenate([table.force for table in tables])
    found = solve(
        np.where(used[:, None], columns, 0.0), np.where(used, force, 0.0), [len(table.used) for table in tables]
    )
    names = list(tables[0].names)
    values = dict(zip(names, found.coefficients.tolist(), strict=True))
    errors = dict(zip(names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    for group in found.undetermined_groups:
        for k in group:
            values[names[k]] = errors[names[k]] = float("nan")
        notes = (*notes, _undetermined([names[k] for k in group]))
    load = np.concatenate([table.kinematics.load for table in tables])[used]
    return InverseDynamics(
        regressors=regressors,
        values=values,
        standard_errors=errors,
        coefficients=found.coefficients,
        condition=found.condition,
        load=float(load.mean()),
        dynamics=dynamics,
        min_speed=min_speed,
        borders=borders,
        fit=_evaluation(tables, found.coefficients, notes),
        notes=notes,
    )


def evaluate(result: InverseDynamics, logs: Log | Sequence[Log]) -> Evaluation:
    """How well the parameters of `result` foretell the force of other logs, in the same band and speeds."""
    sources, notes = stretches(logs, result.dynamics)
    tables = [
        _table(source, result.regressors, result.dynamics, result.min_speed, result.borders) for source in sources
    ]
    return _evaluation(tables, result.coefficients, notes)


class _RegressorTable(NamedTuple):
    """The decimated rows of one piece."""

    log: str
    time: Signal
    kinematics: Kinematics
    names: tuple[str, ...]
    columns: Float[np.ndarray, "n p"]
    force: Signal
    used: Bool[np.ndarray, " n"]


def _table(
    source: Stretch, regressors: Regressors, dynamics: float, min_speed: float, borders: tuple[float, float]
) -> _RegressorTable:
    """Differentiate, drop the border, form the columns at the full rate, and decimate them and the force alike."""
    velocity, acceleration = differentiate(source.position, source.rate, 5 * dynamics)
    begin, end = (round(share * source.border) for share in borders)
    border = slice(begin, len(velocity) - end)
    kinematics = Kinematics(velocity[border], acceleration[border], source.load[border])
    ratio = max(1, round(0.8 * source.rate / 2 / (2 * dynamics)))
    columns = regressors.columns(kinematics)
    slowest = minimum_filter1d(np.abs(kinematics.velocity), 2 * ratio + 1)
    return _RegressorTable(
        log=source.log,
        time=source.time[border][decimation_slice(len(kinematics.velocity), ratio)],
        kinematics=Kinematics(*(decimate(signal, ratio) for signal in kinematics)),
        names=tuple(columns),
        columns=np.stack([decimate(column, ratio) for column in columns.values()], axis=1),
        force=decimate(source.force[border], ratio),
        used=slowest[decimation_slice(len(kinematics.velocity), ratio)] >= min_speed,
    )


def _evaluation(
    tables: Sequence[_RegressorTable], coefficients: Float[np.ndarray, " p"], notes: tuple[str, ...]
) -> Evaluation:
    pieces = tuple(
        Piece(t.log, t.time, *t.kinematics, force=t.force, model=t.columns @ coefficients, used=t.used) for t in tables
    )
    miss = np.concatenate([(piece.force - piece.model)[piece.used] for piece in pieces])
    size = np.linalg.norm(np.concatenate([piece.force[piece.used] for piece in pieces]))
    percent = 100 * float(np.linalg.norm(miss) / size) if size > 0 else float("nan")
    return Evaluation(percent, pieces, notes)


def _undetermined(names: list[str]) -> str:
    if len(names) == 1:
        return f"{names[0]} is not determined: no sample depends on it (no motion that way, or no acceleration)"
    return (
        f"{', '.join(names[:-1])} and {names[-1]} cannot be distinguished by these data: they need motion in both "
        "directions, at several speeds, with acceleration between"
    )
