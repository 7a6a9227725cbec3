"""The axes that faults are done to: the paper's, and others that differ from it in size, speed, scale and guides.

Faults are drawn for the paper's axis and then scaled to the axis, dimension by dimension: what is clear on one is about
as clear on the other, and the stream of random numbers is the same.
"""

import dataclasses
from typing import NamedTuple

from diffdrive.errors import ParameterError
from diffdrive.model import presets
from diffdrive.model.parameters import Drive, Friction, Plant
from diffdrive.model.quantity import Directional

# what stands for an effect of the screw, on an axis without one: the first of them that is not drawn already
INSTEAD = {
    "lead_error": ("interpolation_error", "cogging"),
    "backlash": ("frame_vibration", "position_friction"),
    "compliance": ("frame_vibration", "position_friction"),
    "swallowed_screw": ("swallowed_frame",),
}


class StudyAxis(NamedTuple):
    """An axis as its engineer knows it, and the ratios of its dimensions to those of the paper's."""

    drive: Drive  # its sensor's resolution included; noise is drawn
    noise: tuple[float, float]  # m, between which it is drawn
    rates: tuple[float, ...]  # Hz
    rate_probabilities: tuple[float, ...]  # of each rate
    bandwidth: tuple[float, float]  # rad/s, of the position loop; of a cascade that of the velocity loop
    length_ratio: float = 1.0  # strokes and speeds
    force_ratio: float = 1.0  # Coulomb friction
    load_ratio: float = 1.0  # load on the guides with a like share of the friction
    bristle_ratio: float = 1.0  # distance before sliding
    resolution_ratio: float = 1.0  # the scale's counts
    cascaded: bool = False  # a cascade of position and speed, or a PD
    samples_a_row: tuple[int, ...] = (1,)  # of the control, among which it is drawn; with several it is unknown
    gentleness: float = 1.0  # how many times as long it takes to reach a like share of the speed
    wind_up: float | None = None  # m/N, of the screw between table and a motor whose encoder is logged, too
    absent: tuple[str, ...] = ()  # effects that it cannot have, or cannot show: of `INSTEAD`

    @property
    def resolution(self) -> float:
        """Of the scale (m)."""
        assert self.drive.sensor.resolution is not None
        return float(self.drive.sensor.resolution)

    def sizes(self) -> dict[str, float]:
        """The factor of each fault parameter against the paper's axis, by name; 1 for those that are not named."""
        force, length, bristle = self.force_ratio, self.length_ratio, self.bristle_ratio
        return {
            **dict.fromkeys(
                (
                    "constant",
                    "cogging",
                    "process",
                    "process_mean",
                    "chip",
                    "dead",
                    "peak",
                    "droop_force",
                    "spin",
                    "step",
                    "chain",
                    "pulse",
                ),
                force,
            ),
            "windage": force / length**2,
            "lateness": self.resolution_ratio / length,
            **dict.fromkeys(("spring", "bumper"), force / length),
            **dict.fromkeys(
                (
                    "neutral",
                    "wave_period",
                    "cogging_period",
                    "commutation_period",
                    "chip_place",
                    "chip_width",
                    "chain_length",
                ),
                length,
            ),
            "slope": 1.0 / length,
            "extra_load": self.load_ratio,
            **dict.fromkeys(("slip", "longest", "gap"), bristle),
            **dict.fromkeys(("lead_error", "interpolation"), self.resolution_ratio),
            "interpolation_period": max(self.resolution_ratio, 1.0),
            "stiffness": float(self.drive.plant.mass) / float(presets.paper_drive().plant.mass),
        }


def _both(value: float) -> Directional:
    return Directional(value, value)


def _paper() -> StudyAxis:
    """The testbed of Lee et al.: a table on a screw, 0.1 um."""
    return StudyAxis(presets.paper_drive(), (2e-8, 5e-8), (1000.0, 2000.0, 4000.0, 10000.0), (0.15, 0.5, 0.25, 0.1),
                     (130.0, 250.0))  # fmt: skip


def _drive(axis: Drive, mass: float, constant: float, friction: Friction, damping: float, resolution: float) -> Drive:
    plant = Plant(mass=mass, damping=_both(damping), constant_force=constant)
    return dataclasses.replace(
        axis, plant=plant, friction=friction, sensor=dataclasses.replace(axis.sensor, resolution=resolution)
    )


def _gantry() -> StudyAxis:
    """600 kg on roller guides, a CNC's clock and cascade, counts of 0.5 um, an encoder on the motor, too."""
    friction = Friction(
        coulomb_screw=_both(200.0), load_coefficient=_both(4e-3), initial_load=12e3, breakaway_gap=_both(60.0),
        stribeck_velocity=_both(3e-3), viscous=_both(1000.0), bristle_stiffness=_both(4e7), bristle_damping=_both(8e3),
    )  # fmt: skip
    drive = _drive(presets.paper_drive(), 600.0, 0.0, friction, 200.0, 5e-7)
    return StudyAxis(drive, (5e-8, 2e-7), (500.0, 1000.0, 2000.0), (0.3, 0.5, 0.2), (40.0, 100.0),
                     length_ratio=4.0, force_ratio=3.5, load_ratio=0.32, bristle_ratio=3.0,
                     resolution_ratio=5.0, cascaded=True, wind_up=3e-10, gentleness=4.0,
                     absent=("lead_error",))  # fmt: skip


def _linear() -> StudyAxis:
    """A linear motor: 20 kg, fast, hardly any friction, counts of 10 nm."""
    friction = Friction(
        coulomb_screw=_both(6.0), load_coefficient=_both(5e-4), initial_load=4e3, breakaway_gap=_both(2.0),
        stribeck_velocity=_both(5e-3), viscous=_both(12.0), bristle_stiffness=_both(2e6), bristle_damping=_both(500.0),
    )  # fmt: skip
    drive = _drive(presets.paper_drive(), 20.0, 0.0, friction, 3.0, 1e-8)
    return StudyAxis(drive, (3e-9, 1e-8), (4000.0, 8000.0, 10000.0), (0.4, 0.3, 0.3), (200.0, 350.0),
                     length_ratio=3.0, force_ratio=0.12, load_ratio=0.09, bristle_ratio=2.0,
                     resolution_ratio=0.15, absent=tuple(INSTEAD))  # fmt: skip


def _vertical() -> StudyAxis:
    """300 kg that hang on their screw, half of the weight balanced, counts of 0.2 um."""
    friction = Friction(
        coulomb_screw=_both(250.0), load_coefficient=_both(4e-3), initial_load=12e3, breakaway_gap=_both(80.0),
        stribeck_velocity=_both(2e-3), viscous=_both(3500.0), bristle_stiffness=_both(5e7),
        bristle_damping=_both(1.2e4),
    )  # fmt: skip
    drive = _drive(presets.paper_drive(), 300.0, -250.0, friction, 300.0, 2e-7)
    return StudyAxis(drive, (3e-8, 1e-7), (1000.0, 2000.0, 4000.0), (0.4, 0.4, 0.2), (100.0, 180.0),
                     length_ratio=2.0, force_ratio=4.3, load_ratio=0.4, bristle_ratio=2.9,
                     resolution_ratio=2.0)  # fmt: skip


def _cnc() -> StudyAxis:
    """450 kg of a machining centre under a cascade at 4 kHz, counts of 0.1 um."""
    friction = Friction(
        coulomb_screw=_both(180.0), load_coefficient=_both(3.5e-3), initial_load=20e3, breakaway_gap=_both(75.0),
        stribeck_velocity=_both(3e-3), viscous=_both(1300.0), bristle_stiffness=_both(8e7),
        bristle_damping=_both(1.9e5),
    )  # fmt: skip
    drive = _drive(presets.paper_drive(), 450.0, 0.0, friction, 150.0, 1e-7)
    return StudyAxis(drive, (2e-8, 8e-8), (4000.0,), (1.0,), (150.0, 350.0),
                     length_ratio=2.5, force_ratio=3.5, load_ratio=0.37, bristle_ratio=1.5, cascaded=True,
                     gentleness=2.0)  # fmt: skip


AXES = {
    "paper": _paper(),
    "gantry": _gantry(),
    "linear": _linear(),
    "vertical": _vertical(),
    "cnc": _cnc(),
    "cnc-trace": _cnc()._replace(samples_a_row=(4, 8)),
}


def axes_named(names: tuple[str, ...]) -> tuple[StudyAxis, ...]:
    """The axes of these names. Raises `ParameterError` for one that is unknown."""
    for name in names:
        if name not in AXES:
            raise ParameterError(f"--axis {name}: no such axis; known: {', '.join(AXES)}")
    return tuple(AXES[name] for name in names)
