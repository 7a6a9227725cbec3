"""The catalogue as hypotheses: for each effect, which of its parameters a log may tell, and what they may be."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from diffdrive.effects import actuator, forces, friction, machine, scale, transmission
from diffdrive.effects.base import Effect
from diffdrive.effects.catalogue import EFFECTS
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.priors import LOG_ODDS, LOGARITHM, Parameter
from tuning.diagnosis.hypotheses.setting import SLIPPERY, Setting

PAYLOAD, LIGHTER = 0.2, 0.5  # of the moving mass: what is usual, and the most by which it may be less
SHOWN = 0.4  # of a log's rate: a resonance above it swings too fast for the log to show, and for the filter to follow
DIVIDED = 5.0  # counts, into which a scale divides its signal period at least: what is shorter is the counts themselves
STAIRS = 0.4  # counts, more than what their staircase makes of both of a wave's harmonics: 1 / pi and half of that
WHOLE = (0.1, 1.3)  # of the bristle that elements replace: hardly any of it is none, and more than all of it cannot be
MUFFLED = 0.5  # damping ratio, above which nothing of steel swings
MOTOR = (0.05, 0.95)  # of what moves: outside that, motor or table would be next to nothing
TIGHT = 1e-7  # m: a screw with less play has none, and is but elastic
FAR = 3.0  # strokes from its middle, beyond which no spring has its neutral place
AROUND = np.array([-1.0, 0.0, 1.0])  # standard deviations, where the search for a parameter begins
SHORTEST_COGGING, LONGEST_COGGING = 5e-5, 0.1  # m


def _grid(**values: np.ndarray) -> tuple[dict[str, float], ...]:
    """Every combination."""
    names, arrays = list(values), np.meshgrid(*values.values(), indexing="ij")
    return tuple(
        dict(zip(names, map(float, point), strict=True)) for point in zip(*(a.ravel() for a in arrays), strict=True)
    )


def _amplitude(name: str, spread: float, session: bool = False) -> Parameter:
    return Parameter(name, 0.0, spread, session=session, amplitude=True)


def _positive(name: str, middle: float, spread: float, session: bool = False) -> Parameter:
    return Parameter(name, middle, spread, LOGARITHM, session)


def _share(name: str, middle: float, spread: float) -> Parameter:
    return Parameter(name, middle, spread, LOG_ODDS)


def _payload_mass(at: Setting) -> Candidate:
    """What is missing takes no half of the table with it."""
    return Candidate(
        machine.PayloadMass,
        (_amplitude("mass", PAYLOAD * at.mass),),
        bounds=(("mass", -LIGHTER * at.mass, np.inf),),
    )


def _friction_shape(at: Setting) -> Candidate:
    curve = 0.1 * at.viscous / max(at.speed, 1e-3)
    # where the drive file knows how friction grows with load, more Coulomb friction is more load
    level = () if at.load_coefficient > SLIPPERY else (_amplitude("coulomb", 0.2 * at.friction),)
    return Candidate(
        machine.FrictionShape,
        (
            _amplitude("stribeck_velocity", 0.3),
            _amplitude("stribeck_exponent", 0.35),
            _amplitude("breakaway_gap", 0.3),
            _amplitude("viscous", 0.3 * at.viscous),
            _amplitude("curvature", curve),
            *level,
        ),
    )


def _friction_asymmetry(at: Setting) -> Candidate:
    return Candidate(
        machine.FrictionAsymmetry, (_amplitude("coulomb", 0.1 * at.friction), _amplitude("viscous", 0.1 * at.viscous))
    )


def _applied_load(at: Setting) -> Candidate:
    load = 0.2 * at.friction / at.load_coefficient
    times = np.linspace(0.1, 0.8, 8) * at.duration
    return Candidate(
        friction.AppliedLoad,
        (
            _amplitude("load", load),
            _amplitude("more", load),
            Parameter("start", 0.4 * at.duration, 0.4 * at.duration, session=True),
            Parameter("end", 0.8 * at.duration, 0.4 * at.duration, session=True),
            _positive("edge", 0.1, 1.5),
        ),
        tuple({"start": float(a), "end": float(b)} for a in times for b in [*times[times > a], 1.2 * at.duration]),
    )


def _constant_load(at: Setting) -> Candidate:
    """A load throughout, without the price of a step that is not there."""
    return Candidate(friction.AppliedLoad, (_amplitude("load", 0.2 * at.friction / at.load_coefficient),))


def _position_friction(at: Setting) -> Candidate:
    stroke = max(at.high - at.low, 1e-4)
    return Candidate(
        friction.PositionFriction,
        (
            _amplitude("slope", 0.2 / stroke),
            _positive("period", 1.5 * stroke, 0.7),
            _amplitude("cosine", 0.1),
            _amplitude("sine", 0.1),
        ),
        tuple({"period": float(p), "neutral": 0.5 * (at.low + at.high)} for p in stroke * np.geomspace(0.2, 3.0, 12)),
    )


def _viscous_drift(at: Setting) -> Candidate:
    return Candidate(
        friction.ViscousDrift,
        (
            _amplitude("viscous", 0.2),
            _amplitude("coulomb", 0.05),
            _positive("time_constant", 0.4 * at.duration, 0.8),
        ),
        _grid(time_constant=at.duration * np.array([0.15, 0.4, 1.0])),
    )


def _friction_dwell(at: Setting) -> Candidate:
    return Candidate(
        friction.FrictionDwell,
        (
            _amplitude("growth", 0.5),
            _positive("onset", 0.1, 0.7),
            _positive("slip", 4.0 * at.bristle, 0.7),
            _positive("rested", 0.3, 2.0, session=True),
        ),
        _grid(rested=np.array([0.3]), onset=np.array([0.05, 0.2]), slip=at.bristle * np.array([1.0, 4.0, 16.0])),
        bounds=(("growth", 0.0, np.inf),),
    )


def _presliding_hysteresis(at: Setting) -> Candidate:
    """There as a whole or not: what a small share of it does points the wrong way."""
    return Candidate(
        friction.PreslidingHysteresis,
        (
            _positive("share", 1.0, 0.5),
            _positive("longest", 3.0 * at.bristle, 0.8),
            _positive("shortest", 0.2, 0.7),
        ),
        _grid(longest=at.bristle * np.array([0.5, 1.0, 2.0, 4.0, 8.0]), shortest=np.array([0.1, 0.2, 0.4])),
        coupled=True,
        bounds=(("share", *WHOLE),),
    )


def _constant_force(at: Setting) -> Candidate:
    return Candidate(forces.ConstantForce, (_amplitude("force", 0.1 * at.friction),))


def _position_spring(at: Setting) -> Candidate:
    """From a neutral place far away it would be a tilt."""
    stroke, middle = max(at.high - at.low, 1e-4), 0.5 * (at.low + at.high)
    force = 0.1 * at.friction
    return Candidate(
        forces.PositionSpring,
        (
            Parameter("stiffness", 0.0, force / stroke, amplitude=True),
            Parameter("neutral", middle, stroke),
        ),
        tuple({"neutral": at.low + share * stroke} for share in (0.0, 0.25, 0.5, 0.75, 1.0)),
        bounds=(("neutral", middle - FAR * stroke, middle + FAR * stroke),),
    )


def _cogging(at: Setting) -> Candidate:
    """That of a servo motor on a screw: a small share of the friction."""
    return _cogging_of(at, 0.04 * at.friction)


def _strong_cogging(at: Setting) -> Candidate:
    """That of a direct drive, which may be many times its friction."""
    return _cogging_of(at, 0.3 * at.command)


def _cogging_of(at: Setting, force: float) -> Candidate:
    names = ("cosine", "sine", "cosine2", "sine2", "cosine6", "sine6")
    shares = (1.0, 1.0, 0.4, 0.4, 0.4, 0.4)
    # from a direct drive with many poles to a linear motor's magnets, two of them in the stroke; less than one is none
    stroke = at.high - at.low
    periods = np.array([SHORTEST_COGGING, np.clip(0.5 * stroke, 2.0 * SHORTEST_COGGING, LONGEST_COGGING)])
    return Candidate(
        forces.Cogging,
        (
            *(_amplitude(name, share * force, session=True) for name, share in zip(names, shares, strict=True)),
            _positive("period", 1.5e-3, 0.7),
        ),
        _grid(period=periods),
        bounds=(("period", 0.0, max(stroke, 2.0 * SHORTEST_COGGING)),),
    )


def _process_force(at: Setting) -> Candidate:
    force = 0.04 * at.friction
    names = ("mean", "cosine", "sine", "cosine2", "sine2")
    return Candidate(
        forces.ProcessForce,
        (
            *(_amplitude(name, force, session=True) for name in names),
            _positive("frequency", 60.0, 1.2),
            Parameter("start", 0.3 * at.duration, 0.4 * at.duration, session=True),
            Parameter("end", 0.7 * at.duration, 0.4 * at.duration, session=True),
        ),
        ({"start": 0.25 * at.duration, "end": 0.75 * at.duration},),
    )


def _frame_vibration(at: Setting) -> Candidate:
    top = 0.2 / at.period
    return Candidate(
        forces.FrameVibration,
        (_amplitude("ratio", 0.1), _positive("frequency", 25.0, 0.8), _positive("damping", 0.03, 0.8)),
        _grid(frequency=np.geomspace(4.0, min(150.0, top), 40), damping=np.array([0.03])),
        narrow="frequency",
        bounds=(("ratio", 0.0, np.inf), ("damping", 0.0, MUFFLED)),
        coupled=True,
    )


def _compliance(at: Setting) -> Candidate:
    """Its resonance is one that a log of that rate shows."""
    return Candidate(
        transmission.Compliance,
        (
            _positive("frequency", 250.0, 0.8),
            _positive("damping", 0.03, 0.8),
            _share("motor_share", 0.4, 0.5),
            _share("table_friction", 0.5, 1.0),
        ),
        coupled=True,
        searched=True,
        weakens=True,
        bounds=(("frequency", 0.0, SHOWN / at.period), ("damping", 0.0, MUFFLED), ("motor_share", *MOTOR)),
    )


def _backlash(at: Setting) -> Candidate:
    return Candidate(
        transmission.Backlash,
        (
            _positive("gap", 5.6e-6, 1.25),
            _positive("frequency", 400.0, 0.6),
            _positive("damping", 0.08, 0.6),
            _share("motor_share", 0.4, 0.5),
            _share("table_friction", 0.5, 1.0),
        ),
        coupled=True,
        searched=True,
        bare=TIGHT,
        bounds=(("gap", TIGHT, np.inf), ("damping", 0.0, MUFFLED), ("motor_share", *MOTOR)),
    )


def _force_gain(at: Setting) -> Candidate:
    return Candidate(actuator.ForceGain, (_amplitude("gain", 0.15),))


def _force_limit(at: Setting) -> Candidate:
    """One that no command of the log reaches limits nothing."""
    return Candidate(
        actuator.ForceLimit,
        (_positive("limit", 0.8 * at.peak, 0.3),),
        _grid(limit=at.peak * np.r_[np.linspace(0.995, 0.96, 8), 0.94, 0.92, 0.9, 0.87, 0.8, 0.7, 0.6, 0.5]),
        weakens=True,
        bounds=(("limit", 0.0, at.peak),),
    )


def _actuator_lag(at: Setting) -> Candidate:
    return Candidate(
        actuator.ActuatorLag,
        (_positive("time_constant", 8e-4, 0.8),),
        _grid(time_constant=np.array([2e-4, 5e-4, 1.2e-3, 3e-3])),
    )


def _loop_delay(at: Setting) -> Candidate:
    less = [-at.delay, -0.5 * at.delay] if at.delay else []
    return Candidate(
        actuator.LoopDelay, (Parameter("delay", 0.0, 1.5),), _grid(delay=np.array([0.4, 1.1, 2.1, 4.1, *less]))
    )


def _lead_error(at: Setting) -> Candidate:
    """Its wave is larger than what the counts' staircase passes for, as that of a signal period."""
    return Candidate(
        scale.LeadError,
        (
            _amplitude("cosine", 3e-6, session=True),
            _amplitude("sine", 3e-6, session=True),
            _amplitude("linear", 5e-5),
            _positive("lead", 6e-3, 0.4),
        ),
        _grid(lead=1e-3 * np.array([2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0])),
        least=STAIRS * at.count,
    )


def _interpolation_error(at: Setting) -> Candidate:
    """A signal period is longer than the counts that it is divided into, and its error larger than theirs.

    A staircase swings by a count over pi about its slope, once a count; met at even distances it passes for a longer
    wave (its alias).
    """
    names, finest = ("cosine", "sine", "cosine2", "sine2"), DIVIDED * at.count
    periods = 1e-6 * np.array([2.0, 4.0, 8.0, 10.0, 16.0, 20.0, 40.0, 80.0, 100.0])
    return Candidate(
        scale.InterpolationError,
        (
            *(
                _amplitude(name, share * 2e-7, session=True)
                for name, share in zip(names, (1, 1, 0.3, 0.3), strict=True)
            ),
            _positive("period", 2e-5, 0.5),
        ),
        _grid(period=periods[periods >= finest] if finest <= periods[-1] else finest * np.array([2.0, 4.0, 20.0])),
        bounds=(("period", finest, np.inf),),
        least=STAIRS * at.count,
    )


CATALOGUE: tuple[Callable[[Setting], Candidate], ...] = (
    _constant_load,
    _applied_load,
    _friction_shape,
    _friction_asymmetry,
    _position_friction,
    _viscous_drift,
    _friction_dwell,
    _presliding_hysteresis,
    _payload_mass,
    _constant_force,
    _position_spring,
    _compliance,
    _backlash,
    _frame_vibration,
    _process_force,
    _cogging,
    _strong_cogging,
    _force_gain,
    _actuator_lag,
    _loop_delay,
    _force_limit,
    _lead_error,
    _interpolation_error,
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
        _amplitude(name, prior.usual, prior.session)
        if prior.amplitude
        else _positive(name, prior.usual, prior.spread, prior.session)
        for name, prior in priors.items()
    ]
    about = {name: prior.usual * np.exp(prior.spread * AROUND) for name, prior in priors.items() if not prior.amplitude}
    return Candidate(effect, tuple(parameters), _grid(**about) if about else ({},))
