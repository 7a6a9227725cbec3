from .actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from .base import (
    Acts,
    ActuatorEffect,
    Effect,
    Envelope,
    MachineEffect,
    Push,
    ScaleEffect,
    Seen,
    Stage,
    StaticActuatorEffect,
    StaticTableEffect,
    StepOrder,
    TableEffect,
    TableForce,
)
from .catalogue import EFFECTS, register
from .forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce
from .friction import AppliedLoad, FrictionDwell, PositionFriction, PreslidingHysteresis, ViscousDrift
from .machine import FrictionAsymmetry, FrictionShape, PayloadMass
from .prior import amplitude, positive
from .scale import InterpolationError, LeadError
from .transmission import Backlash, Compliance

__all__ = [
    "EFFECTS",
    "Acts",
    "ActuatorEffect",
    "ActuatorLag",
    "AppliedLoad",
    "Backlash",
    "Cogging",
    "Compliance",
    "ConstantForce",
    "Effect",
    "Envelope",
    "ForceGain",
    "ForceLimit",
    "FrameVibration",
    "FrictionAsymmetry",
    "FrictionDwell",
    "FrictionShape",
    "InterpolationError",
    "LeadError",
    "LoopDelay",
    "MachineEffect",
    "PayloadMass",
    "PositionFriction",
    "PositionSpring",
    "PreslidingHysteresis",
    "ProcessForce",
    "Push",
    "ScaleEffect",
    "Seen",
    "Stage",
    "StaticActuatorEffect",
    "StaticTableEffect",
    "StepOrder",
    "TableEffect",
    "TableForce",
    "ViscousDrift",
    "amplitude",
    "positive",
    "register",
]
