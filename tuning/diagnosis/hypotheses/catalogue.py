"""All hypotheses about a machine and its logs: the effects of the catalogue, those of a user's own, those it has."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from diffdrive.effects.base import Effect
from diffdrive.effects.catalogue import EFFECTS
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.candidates import (
    actuator_lag,
    amplitude,
    applied_load,
    backlash,
    cogging,
    compliance,
    constant_force,
    constant_load,
    force_gain,
    force_limit,
    frame_vibration,
    friction_asymmetry,
    friction_dwell,
    friction_shape,
    grid,
    interpolation_error,
    lead_error,
    loop_delay,
    payload_mass,
    position_friction,
    position_spring,
    positive,
    presliding_hysteresis,
    process_force,
    strong_cogging,
    viscous_drift,
)
from tuning.diagnosis.hypotheses.setting import Setting

AROUND = np.array([-1.0, 0.0, 1.0])  # standard deviations, where the search for a parameter begins

CATALOGUE: tuple[Callable[[Setting], Candidate], ...] = (
    constant_load,
    applied_load,
    friction_shape,
    friction_asymmetry,
    position_friction,
    viscous_drift,
    friction_dwell,
    presliding_hysteresis,
    payload_mass,
    constant_force,
    position_spring,
    compliance,
    backlash,
    frame_vibration,
    process_force,
    cogging,
    strong_cogging,
    force_gain,
    actuator_lag,
    loop_delay,
    force_limit,
    lead_error,
    interpolation_error,
)


def given(effects: Sequence[Effect], at: Setting) -> list[tuple[Candidate, tuple[tuple[str, float], ...]]]:
    """Effects that a drive has already: each as a candidate with nothing free, and its values."""
    known = {one.name: one for one in candidates(at)}
    return [
        (
            known[effect.name]._replace(parameters=()),
            tuple((field.name, float(getattr(effect, field.name) or 0.0)) for field in dataclasses.fields(effect)),
        )
        for effect in effects
    ]


def candidates(at: Setting) -> list[Candidate]:
    """Every effect of the catalogue as a hypothesis about this machine and these logs, and those of a user's own."""
    known = [make(at) for make in CATALOGUE]
    names = {one.name for one in known}
    return [*known, *(_of_its_own(effect) for name, effect in EFFECTS.items() if name not in names)]


def _of_its_own(effect: type[Effect]) -> Candidate:
    """A registered effect, by what its parameters declare that an engineer would expect of them."""
    priors = {one.name: one.metadata["prior"] for one in dataclasses.fields(effect) if "prior" in one.metadata}
    parameters = [
        amplitude(name, prior.usual, prior.session)
        if prior.amplitude
        else positive(name, prior.usual, prior.spread, prior.session)
        for name, prior in priors.items()
    ]
    about = {name: prior.usual * np.exp(prior.spread * AROUND) for name, prior in priors.items() if not prior.amplitude}
    return Candidate(effect, tuple(parameters), grid(**about) if about else ({},))
