"""The controllers: one per file, one interface."""

from diffdrive.controllers.base import (
    Command,
    CommandPart,
    Controller,
    Encoders,
    Feedforward,
    PDGains,
    Reference,
    Tracking,
    Tunable,
)
from diffdrive.controllers.cascade import Cascade
from diffdrive.controllers.catalogue import KINDS, register
from diffdrive.controllers.disturbance_observer import DisturbanceObserver
from diffdrive.controllers.dobvsc import DOBVSC
from diffdrive.controllers.feedforward_dob import PDFeedforwardDOB
from diffdrive.controllers.filters import PT1, PT2, Filter, Notch, SecondOrder
from diffdrive.controllers.friction_compensation import FrictionCompensation
from diffdrive.controllers.kinds import Keys, Kind, Option
from diffdrive.controllers.pd import PD
from diffdrive.controllers.unknown import UnknownController
from diffdrive.model.quantity import quantity, quantity_table

__all__ = [
    "DOBVSC",
    "KINDS",
    "PD",
    "PT1",
    "PT2",
    "Cascade",
    "Command",
    "CommandPart",
    "Controller",
    "DisturbanceObserver",
    "Encoders",
    "Feedforward",
    "Filter",
    "FrictionCompensation",
    "Keys",
    "Kind",
    "Notch",
    "Option",
    "PDFeedforwardDOB",
    "PDGains",
    "Reference",
    "SecondOrder",
    "Tracking",
    "Tunable",
    "UnknownController",
    "quantity",
    "quantity_table",
    "register",
]
