"""Axes of several kinds that the study logs: each as its drive file states it, and how it is moved."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import parse_axis

Tables = dict[str, Any]


@dataclass(frozen=True)
class StudyDrive:
    """One axis: its drive file, and what the study needs beyond that.

    `stroke` (m), `speed` (m/s) and `acceleration` (m/s^2) are the largest of its motions; `seconds` is how long a log
    lasts. `hidden_controller` is the one that runs where the drive file names none; `motor_resolution` (m) is that of
    a second encoder at the motor.
    """

    name: str
    tables: Tables
    stroke: float
    speed: float
    acceleration: float
    seconds: float
    load: float = 0.0  # N, logged where it is not zero
    hidden_controller: Mapping[str, object] | None = None
    motor_resolution: float | None = None
    mirrorable: bool = True  # whether the mirrored axis is one with the same drive file
    settling_time: float = 0.0  # s, for which the loop has held the axis before the log begins
    axis: Axis = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", parse_axis(copy.deepcopy(self.tables), self.name))

    @property
    def rate(self) -> float:
        """Of controller and log (Hz)."""
        return self.axis.sampling.rate

    @property
    def kind(self) -> str:
        """Of the drive file's controller."""
        return self.tables["controller"]["kind"]

    @property
    def resolution(self) -> float:
        """Of the scale (m)."""
        return float(self.tables["sensor"]["resolution"])

    @property
    def feedback(self) -> Mapping[str, Any]:
        """The table [controller] of the loop that runs."""
        return self.hidden_controller or self.tables["controller"]

    @property
    def static_stiffness(self) -> float | None:
        """Command per metre of a constant error (N/m), None where an integral or an observer makes it endless."""
        kind, gains = self.feedback["kind"], self.feedback
        if kind == "pd":
            return gains["kp"]
        return gains["kp"] * gains["kv"] if kind == "cascade" and not gains.get("ki") else None

    def with_feedback(self, gains: Mapping[str, object]) -> Axis:
        """The same drive under a controller of the same kind with other values of these keys."""
        tables = copy.deepcopy(self.tables)
        tables["controller"] = {**copy.deepcopy(dict(self.feedback)), **gains}
        return parse_axis(tables, self.name)


def _friction(coulomb: float, gap: float, viscous: float, bristle: float, damping: float, stribeck: float) -> Tables:
    return {
        "coulomb_screw": coulomb, "load_coefficient": 0.0, "initial_load": 0.0, "breakaway_gap": gap,
        "stribeck_velocity": stribeck, "viscous": viscous, "bristle_stiffness": bristle, "bristle_damping": damping,
    }  # fmt: skip


PAPER_FRICTION = {
    "coulomb_screw": [63.43, 64.95],
    "load_coefficient": 3.66e-4,
    "initial_load": 15_200.0,
    "breakaway_gap": [30.0, 22.98],
    "stribeck_velocity": [0.0010, 0.0014],
    "viscous": [1826.5, 1673.5],
    "bristle_stiffness": 3.35e7,
    "bristle_damping": 4540.0,
}


def _tables(
    mass: float, damping: float | list[float], friction: Tables, resolution: float, noise: float, rate: float,
    stroke: float, controller: Tables, **more: object,
) -> Tables:  # fmt: skip
    return {
        "plant": {"mass": mass, "damping": damping, "constant_force": more.pop("constant_force", 0.0)},
        "friction": friction,
        "sensor": {"resolution": resolution, "noise": noise},
        "sampling": {"rate": rate},
        "limits": {"stroke": [-0.5 * stroke, 0.5 * stroke]},
        "controller": controller,
        **more,
    }


def study_drives() -> tuple[StudyDrive, ...]:
    """The axes of the study."""
    cnc = _friction(180.0, 40.0, 3000.0, 6e7, 9e3, 2e-3)
    gantry = _friction(450.0, 120.0, 2500.0, 9e7, 2e4, 3e-3)
    linear = _friction(8.0, 2.0, 14.0, 2e6, 500.0, 5e-3)
    vertical = _friction(250.0, 80.0, 3500.0, 5e7, 1.2e4, 2e-3)
    cascade = {"kind": "cascade", "kp": 60.0, "kv": 4.5e4, "ki": 6e5, "velocity_feedforward": 1.0}
    return (
        StudyDrive(
            "table, PD, 2 kHz",
            _tables(
                100.0, [380.0, 260.0], PAPER_FRICTION, 1e-7, 3e-8, 2000.0, 0.15, {"kind": "pd", "kp": 4e6, "kd": 3e4}
            ),
            0.05, 0.1, 2.0, 4.0,
        ),
        StudyDrive(
            "table, PD+FC+LE, 10 kHz",
            _tables(
                100.0, [380.0, 260.0], PAPER_FRICTION, 1e-7, 2e-8, 10_000.0, 0.15,
                {
                    "kind": "pd+fc+le", "kp": 7979645.34, "kd": 15959.29,
                    "load_estimator": {"min_speed": 0.03},  # from there on it converges
                },
            ),
            0.05, 0.1, 2.0, 2.0, load=2000.0,
        ),
        StudyDrive(
            "table, PD+FF+DOB, 4 kHz",
            _tables(
                100.0, [380.0, 260.0], PAPER_FRICTION, 1e-7, 2e-8, 4000.0, 0.15,
                {"kind": "pd+ff+dob", "kp": 5e6, "kd": 1.6e4, "cutoff": 30.0},
            ),
            0.05, 0.1, 2.0, 3.0,
        ),
        StudyDrive(
            "CNC axis, cascade, 1 kHz",
            _tables(420.0, 200.0, cnc, 1e-8, 5e-9, 1000.0, 0.6, cascade),
            0.2, 0.3, 2.0, 6.0,
        ),
        StudyDrive(
            "CNC axis, cascade without integral, 4 kHz",
            _tables(
                420.0, 200.0, cnc, 1e-7, 3e-8, 4000.0, 0.6,
                {"kind": "cascade", "kp": 90.0, "kv": 9e4, "velocity_samples": 2, "velocity_feedforward": 0.9},
            ),
            0.2, 0.3, 2.0, 4.0,
        ),
        StudyDrive(
            "linear motor, PD, 8 kHz",
            _tables(
                20.0, 3.0, linear, 1e-8, 5e-9, 8000.0, 0.5,
                {"kind": "pd", "kp": 1.4e6, "kd": 7e3, "feedforward": True},
            ),
            0.2, 0.6, 8.0, 3.0,
        ),
        StudyDrive(
            "gantry of 1.6 t, cascade, 2 kHz",
            _tables(
                1600.0, 300.0, gantry, 5e-7, 1e-7, 2000.0, 2.0,
                {"kind": "cascade", "kp": 25.0, "kv": 1.3e5, "ki": 2e6, "velocity_feedforward": 1.0},
            ),
            0.5, 0.5, 1.0, 6.0,
        ),
        StudyDrive(
            "CNC axis, controller unknown, 2 kHz",
            _tables(420.0, 200.0, cnc, 1e-7, 3e-8, 2000.0, 0.6, {"kind": "unknown"}),
            0.2, 0.3, 2.0, 5.0, hidden_controller={**cascade, "kv": 6e4},
        ),
        StudyDrive(
            "two encoders, compliant screw, PD, 4 kHz",
            _tables(
                300.0, 250.0, cnc, 1e-7, 3e-8, 4000.0, 0.6, {"kind": "pd", "kp": 1.2e6, "kd": 3e4},
                effects={"compliance": {"frequency": 250.0, "damping": 0.08, "motor_share": 0.4}},
            ),
            0.2, 0.2, 1.5, 4.0, motor_resolution=1e-8,
        ),
        StudyDrive(
            "vertical axis, cascade, 4 kHz",
            _tables(
                300.0, 300.0, vertical, 2e-7, 5e-8, 4000.0, 0.6,
                {"kind": "cascade", "kp": 70.0, "kv": 8e4, "ki": 1.5e6, "velocity_feedforward": 1.0},
                constant_force=-900.0,
            ),
            0.2, 0.2, 1.5, 4.0, mirrorable=False, settling_time=0.5,
        ),
    )  # fmt: skip
