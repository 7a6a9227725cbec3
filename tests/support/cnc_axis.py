"""A CNC axis with a motor encoder and a scale: two masses, a backlash, an elastic screw, a cascade, a slow trace.

Independent of the package's simulator: explicit steps of 25 us, friction of either mass by Dahl's model.
"""

from dataclasses import dataclass

import numba
import numpy as np

from diffdrive.logs.log import Log

STEP = 25e-6  # s, of the integration
CONTROL = 8  # steps of one control period


@dataclass(frozen=True)
class CncAxis:
    """SI units; `wind_up` is the reversal error that friction makes in the screw, 2 F / k."""

    backlash: float = 0.0
    wind_up: float = 10e-6
    mass: float = 500.0
    table_share: float = 0.5  # of the mass
    friction: float = 600.0
    table_friction: float = 0.6  # share of the friction
    presliding: float = 10e-6  # travel over which friction builds up
    lead: float = 10e-3
    per_turn: float = 0.0  # amplitude
    linear: float = 0.0
    drift: float = 0.0  # m/s
    scatter: float = 0.0  # of the backlash from reversal to reversal
    motor_step: float = 10e-9
    scale_step: float = 0.5e-6
    motor_noise: float = 10e-9
    delay: float = 0.0  # s, by which the scale is read earlier than the motor
    trace: float = 2e-3  # s
    gain: float = 40.0  # 1/s, of the position loop
    ripple: float = 0.01  # of the friction: noise of the force

    @property
    def stiffness(self) -> float:
        if self.wind_up == 0.0:
            return 2e9
        return 2.0 * self.table_friction * self.friction / self.wind_up

    @property
    def reversal_error(self) -> float:
        return self.backlash + 2.0 * self.table_friction * self.friction / self.stiffness


@numba.njit
def _run(reference, backlashes, force_noise, numbers):
    (m_m, m_t, f_m, f_t, slip, k, c, kv, kp, ki, lag, h, control) = numbers
    n = len(reference)
    motor, table, command = np.zeros(n), np.zeros(n), np.zeros(n)
    x_m = x_t = v_m = v_t = b_m = b_t = u = force = integral = 0.0
    x_m = x_t = reference[0]
    for i in range(n):
        if i % int(control) == 0:
            feed = (reference[min(i + int(control), n - 1)] - reference[i]) / (control * h)
            error = kv * (reference[i] - x_m) + feed - v_m
            integral += ki * control * h * error
            u = kp * error + integral + force_noise[i]
        force += h / lag * (u - force)
        q = x_m - x_t
        half = 0.5 * backlashes[i]
        screw = 0.0
        if q > half:
            screw = max(0.0, k * (q - half) + c * (v_m - v_t))
        elif q < -half:
            screw = min(0.0, k * (q + half) + c * (v_m - v_t))
        b_m = min(1.0, max(-1.0, b_m + h * v_m / slip))
        b_t = min(1.0, max(-1.0, b_t + h * v_t / slip))
        v_m += h * (force - screw - f_m * b_m - 0.5 * f_m * v_m) / m_m
        v_t += h * (screw - f_t * b_t - 0.5 * f_t * v_t - 2e3 * (1 - abs(b_t)) * v_t) / m_t
        x_m += h * v_m
        x_t += h * v_t
        motor[i], table[i], command[i] = x_m, x_t, u
    return motor, table, command


def strokes(rng: np.random.Generator, seconds: float, *, stroke=(0.05, 0.3), speed=(0.02, 0.3), rest=0.1) -> np.ndarray:
    """To and fro between varying ends at varying speeds; ramps of smoothed acceleration. [n] at `STEP`."""
    velocity, side, at = [], 1.0, 0.0
    total = 0
    while total * STEP < seconds:
        fastest = rng.uniform(*speed)
        end = side * 0.5 * rng.uniform(*stroke)
        length = abs(end - at)
        ramp = rng.uniform(0.05, 0.2)
        fastest = min(fastest, 0.5 * length / ramp)
        slow = np.sin(0.5 * np.pi * np.linspace(0, 1, round(ramp / STEP))) ** 2
        cruise = max(0.0, length - fastest * ramp) / fastest
        shape = np.concatenate(
            [slow, np.ones(round(cruise / STEP)), slow[::-1], np.zeros(round(rest * rng.random() / STEP))]
        )
        shape *= (end - at) / (np.sum(shape) * STEP)
        velocity.append(shape)
        total += len(shape)
        at, side = end, -side
    return np.cumsum(np.concatenate(velocity)) * STEP


def log_of(axis: CncAxis, seed: int = 0, seconds: float = 20.0, reference: np.ndarray | None = None, **motion) -> Log:
    """The trace of an axis on strokes drawn by `seed`."""
    rng = np.random.default_rng(seed)
    reference = strokes(rng, seconds, **motion) if reference is None else reference
    n = len(reference)
    m_t, m_m = axis.table_share * axis.mass, (1 - axis.table_share) * axis.mass
    f_t, f_m = axis.table_friction * axis.friction, (1 - axis.table_friction) * axis.friction
    k = axis.stiffness
    damping = 0.1 * np.sqrt(k * m_t * m_m / axis.mass)
    speed_gain, reset = 250.0 * axis.mass, 250.0 * axis.mass * 20.0  # N s/m, N/m
    turns = np.concatenate([[0.0], np.diff(np.sign(np.diff(reference)), prepend=0.0) != 0])
    number = np.cumsum(turns).astype(int)
    backlashes = np.maximum(axis.backlash + axis.scatter * rng.standard_normal(number[-1] + 1), 0.0)[number]
    noise = axis.ripple * axis.friction * rng.standard_normal(n)
    numbers = (m_m, m_t, f_m, f_t, axis.presliding, k, damping, axis.gain, speed_gain, reset, 0.5e-3, STEP)
    motor, table, command = _run(reference, backlashes, noise, (*numbers, float(CONTROL)))
    time = np.arange(n) * STEP
    wave = axis.per_turn * np.sin(2 * np.pi * table / axis.lead + 1.0)
    scale = table - axis.linear * table - wave - axis.drift * time + 0.0123
    rows = np.arange(0.02, time[-1] - 0.02, axis.trace)
    phase = STEP * rng.random()
    motor_rows, scale_rows = np.interp(rows + phase, time, motor), np.interp(rows + phase - axis.delay, time, scale)
    command_rows = command[np.minimum((rows / STEP).astype(int), n - 1)]
    motor_rows = motor_rows + axis.motor_noise * rng.standard_normal(len(rows))
    scale_rows = scale_rows + 0.3 * axis.scale_step * rng.standard_normal(len(rows))
    return Log(
        "cnc",
        time=rows,
        position=axis.scale_step * np.round(scale_rows / axis.scale_step),
        command=command_rows,
        reference=np.interp(rows, time, reference) + 0.0123,
        motor_position=axis.motor_step * np.round(motor_rows / axis.motor_step),
    )
