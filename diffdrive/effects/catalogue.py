"""The effects by name."""

from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.base import Effect
from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PositionFriction, PreslidingHysteresis, ViscousDrift
from diffdrive.effects.machine import FrictionAsymmetry, FrictionShape, PayloadMass
from diffdrive.effects.scale import InterpolationError, LeadError
from diffdrive.effects.transmission import Backlash, Compliance

PLACES: dict[str, tuple[type[Effect], ...]] = {
    "friction": (
        AppliedLoad,
        FrictionShape,
        FrictionAsymmetry,
        PositionFriction,
        ViscousDrift,
        FrictionDwell,
        PreslidingHysteresis,
    ),
    "plant": (PayloadMass, ConstantForce, PositionSpring),
    "transmission": (Compliance, Backlash),
    "environment": (FrameVibration, ProcessForce),
    "actuator": (Cogging, ForceGain, ActuatorLag, LoopDelay, ForceLimit),
    "sensor": (LeadError, InterpolationError),
}
EFFECTS: dict[str, type[Effect]] = {effect.name: effect for place in PLACES.values() for effect in place}
