"""A sound simulated log, and what can be done to it."""

import dataclasses
import re

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import parse_axis
from diffdrive.logs.checks.examine import Finding
from diffdrive.logs.log import Log
from diffdrive.loop.simulate import simulate_loop
from diffdrive.motion.builders import from_array
from diffdrive.motion.motion import Motion
from diffdrive.runtime import configure

configure()

RATE = 2_000.0
FORCE_PER_VOLT = 159.593


def axis_of(
    kind="pd", kp=3.99e6, kd=12_170.0, *, mass=100.0, noise=3e-8, resolution=1e-7, delay=0, rate=RATE, **more
) -> Axis:
    gains = {"kp": kp, "kv": kd} if kind == "cascade" else {"kp": kp, "kd": kd}
    sensor = {"noise": noise} | ({} if resolution is None else {"resolution": resolution})
    return parse_axis(
        {
            "plant": {"mass": mass, "damping": [380.0, 260.0]},
            "friction": {
                "coulomb_screw": [63.43, 64.95],
                "load_coefficient": 3.66e-4,
                "initial_load": 15_200.0,
                "breakaway_gap": [30.0, 22.98],
                "stribeck_velocity": [0.0010, 0.0014],
                "viscous": [1826.5, 1673.5],
                "bristle_stiffness": 3.35e7,
                "bristle_damping": 4540.0,
            },
            "actuator": {"delay_samples": delay},
            "sensor": sensor,
            "sampling": {"rate": rate},
            "limits": {"stroke": [-0.075, 0.075]},
            "controller": {"kind": kind} | gains | more,
        }
    )


def two_sines(seconds: float = 3.0, rate: float = RATE) -> Motion:
    time = np.arange(int(seconds * rate)) / rate
    return from_array(time, 0.02 * (1 - np.cos(2 * np.pi * 0.6 * time)) + 0.003 * (1 - np.cos(2 * np.pi * 1.9 * time)))


def simulate_log(description: Axis, reference: Motion, seed: int = 1) -> Log:
    run = simulate_loop(description.drive, description.controller, reference, sampling=description.sampling, seed=seed)
    run.require_ok()
    return Log("simulated", time=run.time, position=run.position, command=run.command, reference=run.reference)


DRIVE = axis_of()
SOUND = simulate_log(DRIVE, two_sines())
COUNT = len(SOUND.time)
SPEED = np.gradient(SOUND.reference, SOUND.time)
FASTEST = int(np.argmax(SPEED))
both = {"position": SOUND.position, "reference": SOUND.reference}


def replaced(log: Log = SOUND, **channels) -> Log:
    return dataclasses.replace(log, **channels)


def delayed(signal: np.ndarray, samples: int) -> np.ndarray:
    """Some samples later, ends repeated."""
    return signal[np.clip(np.arange(len(signal)) - samples, 0, len(signal) - 1)]


def frozen(signal: np.ndarray, start: int, stop: int) -> np.ndarray:
    signal = signal.copy()
    signal[start:stop] = signal[start]
    return signal


def spiked(signal: np.ndarray, size: float, at=(700, 1800, 4000)) -> np.ndarray:
    signal = signal.copy()
    signal[list(at)] += size
    return signal


def without_rows(log: Log, rows, *, restamp: bool) -> Log:
    kept = np.delete(np.arange(len(log.time)), rows)
    channels = {name: signal[kept] for name, signal in log.channels.items()}
    if restamp:
        channels["time"] = log.time[: len(kept)]
    return replaced(log, **channels)


def repeated(log: Log, at: int) -> Log:
    rows = np.insert(np.arange(COUNT - 1), at, at)
    return replaced(log, **{name: signal[rows] for name, signal in log.channels.items() if name != "time"})


def decimated(log: Log, skip: int) -> Log:
    return replaced(log, **{name: signal[::skip] for name, signal in log.channels.items()})


def rounded(signal: np.ndarray, step: float) -> np.ndarray:
    return step * np.round(signal / step)


def with_nan(signal: np.ndarray, value: float = np.nan) -> np.ndarray:
    signal = signal.copy()
    signal[100:103] = value
    return signal


def square(size: float) -> np.ndarray:
    return np.where(np.sin(2 * np.pi * SOUND.time) < 0, size, 0.0)


def matching(findings: list[Finding], severity: str, channel: str, text: str) -> list[Finding]:
    return [
        one
        for one in findings
        if one.severity == severity and one.channel == channel and re.search(text, f"{one.message}; {one.remedy}")
    ]


def complaints(findings: list[Finding]) -> list[Finding]:
    return [one for one in findings if one.severity != "note"]
