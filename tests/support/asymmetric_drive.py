"""A drive whose every parameter differs between the directions, so that nothing can be taken from the wrong side."""

from dataclasses import replace

from diffdrive.model.parameters import Drive, Plant
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional

PAPER = paper_drive(quantised=False)
ASYMMETRIC = Drive(
    Plant(mass=110.0, damping=Directional(500.0, 200.0), constant_force=12.0),
    replace(
        PAPER.friction,
        load_coefficient=Directional(4e-4, 3e-4),
        bristle_stiffness=Directional(3e7, 4e7),
        bristle_damping=Directional(4e3, 6e3),
    ),
)
