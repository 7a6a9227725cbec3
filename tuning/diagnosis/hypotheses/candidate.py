"""One effect of the catalogue as a hypothesis: what of it a log may tell, and what sets it apart from others."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.effects import actuator, forces, friction, transmission
from diffdrive.effects.base import Effect, MachineEffect, ScaleEffect
from tuning.diagnosis.hypotheses.priors import Parameter

SWINGS = 5.0  # of a process, in the log in which it lasts longest: fewer are no wave
LARGE = 0.3  # of its largest in any log
WAVE = ("cosine", "sine", "cosine2", "sine2")


class Candidate(NamedTuple):
    """One effect of the catalogue as a hypothesis; `grid` are values of the other parameters to begin from."""

    effect: type[Effect]
    parameters: tuple[Parameter, ...]
    grid: tuple[dict[str, float], ...] = ({},)
    coupled: bool = False  # in a loop with the table's velocity and friction: stepped within the filter
    searched: bool = False  # its cost is steep near the truth and flat elsewhere: no slope leads there
    bounds: tuple[tuple[str, float, float], ...] = ()  # between which an engineer would call it that
    least: float = 0.0  # of a wave's amplitude, for the same
    narrow: str = ""  # of the grid, in which what the log shows is narrower than its steps
    weakens: bool = False  # the larger its first parameter, the less of it there is
    bare: float | None = None  # of the first parameter, at which the effect vanishes: a loose screw without play

    @property
    def name(self) -> str:
        """That of the catalogue."""
        return self.effect.name

    @property
    def by_name(self) -> dict[str, Parameter]:
        """Its parameters."""
        return {one.name: one for one in self.parameters}

    def excludes(self, other: "Candidate") -> bool:
        """Whether a machine cannot have both: it has one screw."""
        screws = all(issubclass(one.effect, transmission.Transmission) for one in (self, other))
        return self.name == other.name or screws

    def plausible(self, values: Mapping[str, Float[np.ndarray, " logs"]], lasts: Float[np.ndarray, " logs"]) -> bool:
        """Whether an engineer would call it that: within its bounds; a wave that is large enough in some log; and a
        process that swings several times while it is on in a log of that many seconds in which it is large.
        """
        if any(np.min(values[name]) < low or np.max(values[name]) > high for name, low, high in self.bounds):
            return False
        if not self.least and self.effect is not forces.ProcessForce:
            return True
        large = np.sqrt(sum(values[name] ** 2 for name in WAVE if name in values))
        if np.max(large) < self.least:
            return False
        if self.effect is not forces.ProcessForce:
            return True
        on = np.minimum(values["end"], lasts) - np.maximum(values["start"], 0.0)
        return bool(np.max((on * values["frequency"])[large >= LARGE * np.max(large)]) >= SWINGS)

    @property
    def kind(self) -> tuple[str, ...]:
        """The effect and what of it is free: two of one kind differ in how large they are expected to be."""
        return (self.name, *(one.name for one in self.parameters))

    @property
    def coarse(self) -> bool:
        """Whether its details differ from machine to machine, so that the right kind of effect leaves some of it."""
        return self.coupled or self.effect is friction.FrictionDwell

    @property
    def twists(self) -> bool:
        """Whether a second encoder would see it, `second_encoder.predicted_twist`."""
        return issubclass(self.effect, transmission.Transmission | ScaleEffect)

    @property
    def unseen(self) -> bool:
        """Whether it may act though no force is missing: nominal parameters make up for it, it passes for noise, or it
        acts at a few samples only.
        """
        return self.absorbable or self.noisy or self.effect is actuator.ForceLimit

    @property
    def noisy(self) -> bool:
        """Whether it may pass for noise of the measurement."""
        return issubclass(self.effect, ScaleEffect)

    @property
    def absorbable(self) -> bool:
        """Whether nominal parameters, moved far, could do the same."""
        alike = (MachineEffect, actuator.ForceGain, friction.AppliedLoad, forces.ConstantForce)
        return issubclass(self.effect, alike)
