"""The hand-written step in numba: that of step.c, line for line.

Import it only where numba is installed (`pip install diffdrive[bench]`).
"""

import math

import numba
import numpy as np

(
    MASS, DAMPING_P, _, CONSTANT, SCREW_P, _, GUIDE_P, _, PRELOAD, GAP_P, _, STRIBECK_P, _, VISCOUS_P, _, S0_P, _,
    S1_P, _, MACHINE,
) = range(20)  # fmt: skip
(RESOLUTION, KP, KD, FF_MASS, FF_DAMPING_P, _, Q_X, Q_V, Q_Z, R, KW, MIN_SPEED, FLOOR, LOAD_AMPLITUDE) = range(
    2 * MACHINE, 2 * MACHINE + 14
)

_inline = numba.njit(inline="always", fastmath=False, error_model="numpy")


@_inline
def _side(p: np.ndarray, name: int, ahead: bool) -> float:
    return p[name] if ahead else p[name + 1]


@_inline
def _bristle_at(p: np.ndarray, v: float, z: float, load: float) -> tuple[float, float, float, float]:
    ahead = v >= 0.0
    coulomb = _side(p, SCREW_P, ahead) + _side(p, GUIDE_P, ahead) * (p[PRELOAD] + load)
    s0, s1, viscous = _side(p, S0_P, z >= 0.0), _side(p, S1_P, ahead), _side(p, VISCOUS_P, ahead)
    level = coulomb + _side(p, GAP_P, ahead) * math.exp(-abs(v) / _side(p, STRIBECK_P, ahead))
    return s0, s1, viscous, s0 * abs(v) / level


@_inline
def _friction_force(p: np.ndarray, v: float, z: float, load: float) -> float:
    s0, s1, viscous, rate = _bristle_at(p, v, z, load)
    return s0 * z + s1 * (v - rate * z) + viscous * v


@_inline
def _balance(p: np.ndarray, z: float, slip: float, load: float, h: float) -> tuple[float, float, float, float, float]:
    ahead, give = slip >= 0.0, 0.5 * h / p[MASS]
    coulomb = _side(p, SCREW_P, ahead) + _side(p, GUIDE_P, ahead) * (p[PRELOAD] + load)
    s0, s1, speed = _side(p, S0_P, z >= 0.0), _side(p, S1_P, ahead), abs(slip)
    g = coulomb + _side(p, GAP_P, ahead) * math.exp(-speed / _side(p, STRIBECK_P, ahead))
    q = s0 * h * speed
    first = ((q * (1 / 24) + g * (1 / 6)) * q + 0.5 * g * g) * q + g * g * g
    mean_of_mean = g * (((q * (1 / 24) + 0.125 * g) * q + (1 / 3) * g * g) * q + 0.5 * g * g * g)
    mean, end, gone = g * first, g * g * g * g, q * first
    common_denominator = end + gone
    resistance = 1.0 + (_side(p, VISCOUS_P, ahead) + _side(p, DAMPING_P, ahead)) * give
    per_resistance = 1.0 / (resistance * common_denominator + give * (s0 * h * mean_of_mean + s1 * mean))
    holding = give * (s0 * mean - s1 * gone / h)
    share = 1.0 / common_denominator
    return common_denominator, holding, per_resistance, end * share, h * mean * share


@_inline
def _mean_velocity(moving: float, holding: float, per_resistance: float, v: float, z: float, push: float) -> float:
    return (moving * (v + push) - holding * z) * per_resistance


@_inline
def _cosh_sinh(q: float, m: float, det: float, period: float) -> tuple[float, float]:
    if q > 0.25:
        root = math.sqrt(q)
        fast = m * period + root
        slow_end, fast_end = math.exp(-det * period * period / fast), math.exp(-fast)
        return 0.5 * (slow_end + fast_end), period * 0.5 * (slow_end - fast_end) / root
    end = math.exp(-m * period)
    if q < -0.25:
        root = math.sqrt(-q)
        return end * math.cos(root), period * end * math.sin(root) / root
    even, odd = 1.0, 1.0
    for n in range(6, 0, -1):
        even = 1.0 + q * even / (2 * n * (2 * n - 1))
        odd = 1.0 + q * odd / (2 * n * (2 * n + 1))
    return end * even, period * end * odd


@numba.njit(error_model="numpy")
def _roll(
    p: np.ndarray,
    reference: np.ndarray,
    load: np.ndarray,
    period: float,
    substeps: int,
    costs: np.ndarray,
    position: np.ndarray,
) -> None:
    machine, model, n = p[:MACHINE], p[MACHINE : 2 * MACHINE], load.size
    h = period / substeps
    x, v, z, applied, last_error = reference[0, 0], 0.0, 0.0, 0.0, 0.0
    e0, e1, e2, estimate = x, 0.0, 0.0, 0.0
    o00, o01, o02, o11, o12, o22 = p[Q_X], 0.0, 0.0, p[Q_V], 0.0, p[Q_Z]
    square, peak, load_square = 0.0, 0.0, 0.0
    for k in range(n):
        true_load = p[LOAD_AMPLITUDE] * load[k]
        measured = p[RESOLUTION] * np.rint(x / p[RESOLUTION]) if p[RESOLUTION] > 0.0 else x

        speed, force = e1, applied + model[CONSTANT]
        s0, s1, viscous, rate = _bristle_at(model, speed, e2, estimate)
        mass, drag = model[MASS], viscous + _side(model, DAMPING_P, speed >= 0.0)
        a, b, det = (s1 + drag) / mass, (s0 - s1 * rate) / mass, (s0 + drag * rate) / mass
        m, half = 0.5 * (a + rate), 0.5 * (a - rate)
        c, s = _cosh_sinh((half * half - b) * period * period, m, det, period)
        int_s = (1.0 - c - m * s) / det
        int_c = s + m * int_s
        int2_s = (period - int_c - m * int_s) / det
        int2_c = int_s + m * int2_s
        a01, a02 = int_c - int_s * half, -int_s * b
        a11, a12, a21, a22 = c - s * half, -s * b, s, c + s * half
        x0 = e0 + a01 * e1 + a02 * e2 + (int2_c - int2_s * half) / mass * force
        x1 = a11 * e1 + a12 * e2 + a01 / mass * force
        x2 = a21 * e1 + a22 * e2 + int_s / mass * force
        m00, m01, m02 = o00 + a01 * o01 + a02 * o02, o01 + a01 * o11 + a02 * o12, o02 + a01 * o12 + a02 * o22
        m11, m12 = a11 * o11 + a12 * o12, a11 * o12 + a12 * o22
        m21, m22 = a21 * o11 + a22 * o12, a21 * o12 + a22 * o22
        w00 = m00 + m01 * a01 + m02 * a02 + p[Q_X]
        w01, w02 = m01 * a11 + m02 * a12, m01 * a21 + m02 * a22
        w11, w12 = m11 * a11 + m12 * a12 + p[Q_V], m11 * a21 + m12 * a22
        w22 = m21 * a21 + m22 * a22 + p[Q_Z]
        var, innovation = w00 + p[R], measured - x0
        g0, g1, g2 = w00 / var, w01 / var, w02 / var
        e0, e1, e2 = x0 + g0 * innovation, x1 + g1 * innovation, x2 + g2 * innovation
        o00 = w00 - 2.0 * g0 * w00 + g0 * g0 * var
        o01 = w01 - g0 * w01 - g1 * w00 + g0 * g1 * var
        o02 = w02 - g0 * w02 - g2 * w00 + g0 * g2 * var
        o11 = w11 - 2.0 * g1 * w01 + g1 * g1 * var
        o12 = w12 - g1 * w02 - g2 * w01 + g1 * g2 * var
        o22 = w22 - 2.0 * g2 * w02 + g2 * g2 * var
        prior = _friction_force(model, x1, x2, estimate)
        posterior = _friction_force(model, e1, e2, estimate)
        if abs(speed) > p[MIN_SPEED]:
            estimate += math.copysign(1.0, speed) * p[KW] * (posterior - prior)
        estimate = max(estimate, p[FLOOR])

        error = reference[0, k] - measured
        change = (error - last_error) / period if k else 0.0
        feedforward = p[FF_MASS] * reference[2, k] + _side(p, FF_DAMPING_P, reference[1, k] >= 0.0) * reference[1, k]
        applied = p[KP] * error + p[KD] * change + feedforward + posterior
        last_error = error

        table_error = reference[0, k] - x
        square += table_error * table_error
        peak = max(peak, abs(table_error))
        load_square += (estimate - true_load) ** 2
        if position.size:
            position[k] = x

        push = (applied + machine[CONSTANT]) * 0.5 * h / machine[MASS]
        moving, holding, per_resistance, stays, drawn = _balance(machine, z, v, true_load, h)
        slip = expected = _mean_velocity(moving, holding, per_resistance, v, z, push)
        for _ in range(substeps):
            moving, holding, per_resistance, stays, drawn = _balance(machine, z, slip, true_load, h)
            mean = _mean_velocity(moving, holding, per_resistance, v, z, push)
            x, v, z = x + h * mean, 2.0 * mean - v, stays * z + drawn * mean
            further = _mean_velocity(moving, holding, per_resistance, v, z, push)
            slip, expected = further + mean - expected, further
    costs[0], costs[1], costs[2] = math.sqrt(square / n), peak, math.sqrt(load_square / n)


@numba.njit(error_model="numpy")
def _one_by_one(
    rows: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int, costs: np.ndarray
) -> None:
    for k in range(len(rows)):
        _roll(rows[k], reference, load, period, substeps, costs[k], np.empty(0))


@numba.njit(error_model="numpy", parallel=True)
def _side_by_side(
    rows: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int, costs: np.ndarray
) -> None:
    for k in numba.prange(len(rows)):
        _roll(rows[k], reference, load, period, substeps, costs[k], np.empty(0))


def roll(
    row: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """As `HandWrittenStep.roll`."""
    costs, position = np.zeros(3), np.zeros(load.size)
    _roll(row, reference, load, period, substeps, costs, position)
    return costs, position


def sweep(
    rows: np.ndarray, reference: np.ndarray, load: np.ndarray, period: float, substeps: int, threads: int = 1
) -> np.ndarray:
    """As `HandWrittenStep.sweep`; by prange with more than one thread."""
    costs = np.zeros((len(rows), 3))
    if threads > 1:
        numba.set_num_threads(threads)
    (_side_by_side if threads > 1 else _one_by_one)(rows, reference, load, period, substeps, costs)
    return costs
