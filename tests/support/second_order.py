"""A two-mass plant whose frequency response is known: motor and table on a spring, force on the motor to its speed."""

import numpy as np


def two_mass_speed(frequency, mass=100.0, resonance=300.0, damping=0.02, motor_share=0.5):
    """Speed of the motor per force on it, (m/s)/N, at frequencies in Hz; `resonance` (Hz) is the free one."""
    s = 2j * np.pi * np.asarray(frequency)
    w = 2.0 * np.pi * resonance
    locked = w * np.sqrt(motor_share)  # of the table on the spring, the motor held
    top = s**2 + 2.0 * damping * w * motor_share * s + locked**2
    bottom = s**2 + 2.0 * damping * w * s + w**2
    return top / bottom / (s * motor_share * mass)
