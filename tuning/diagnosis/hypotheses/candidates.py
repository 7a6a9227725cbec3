"""The catalogue as hypotheses: for each effect, which of its parameters a log may tell, and what they may be."""

import numpy as np

from diffdrive.effects import actuator, forces, friction, machine, scale, transmission
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
SHORTEST_COGGING, LONGEST_COGGING = 5e-5, 0.1  # m


def grid(**values: np.ndarray) -> tuple[dict[str, float], ...]:
    """Every combination of values."""
    names, arrays = list(values), np.meshgrid(*values.values(), indexing="ij")
    return tuple(
        dict(zip(names, map(float, point), strict=True)) for point in zip(*(a.ravel() for a in arrays), strict=True)
    )


def amplitude(name: str, spread: float, session: bool = False) -> Parameter:
    """A size that may as well be of the other sign, and is nothing at 0."""
    return Parameter(name, 0.0, spread, session=session, amplitude=True)


def positive(name: str, middle: float, spread: float, session: bool = False) -> Parameter:
    """A number above zero, known to a factor."""
    return Parameter(name, middle, spread, LOGARITHM, session)


def _share(name: str, middle: float, spread: float) -> Parameter:
    return Parameter(name, middle, spread, LOG_ODDS)


def payload_mass(at: Setting) -> Candidate:
    """What is missing takes no half of the table with it."""
    return Candidate(
        machine.PayloadMass,
        (amplitude("mass", PAYLOAD * at.mass),),
        bounds=(("mass", -LIGHTER * at.mass, np.inf),),
    )


def friction_shape(at: Setting) -> Candidate:
    """Other numbers of the curve of friction over speed than the drive file's."""
    curve = 0.1 * at.viscous / max(at.speed, 1e-3)
    # where the drive file knows how friction grows with load, more Coulomb friction is more load
    level = () if at.load_coefficient > SLIPPERY else (amplitude("coulomb", 0.2 * at.friction),)
    return Candidate(
        machine.FrictionShape,
        (
            amplitude("stribeck_velocity", 0.3),
            amplitude("stribeck_exponent", 0.35),
            amplitude("breakaway_gap", 0.3),
            amplitude("viscous", 0.3 * at.viscous),
            amplitude("curvature", curve),
            *level,
        ),
    )


def friction_asymmetry(at: Setting) -> Candidate:
    """A tenth more one way than the other is usual."""
    return Candidate(
        machine.FrictionAsymmetry, (amplitude("coulomb", 0.1 * at.friction), amplitude("viscous", 0.1 * at.viscous))
    )


def applied_load(at: Setting) -> Candidate:
    """One that comes and goes within the log."""
    load = 0.2 * at.friction / at.load_coefficient
    times = np.linspace(0.1, 0.8, 8) * at.duration
    return Candidate(
        friction.AppliedLoad,
        (
            amplitude("load", load),
            amplitude("more", load),
            Parameter("start", 0.4 * at.duration, 0.4 * at.duration, session=True),
            Parameter("end", 0.8 * at.duration, 0.4 * at.duration, session=True),
            positive("edge", 0.1, 1.5),
        ),
        tuple({"start": float(a), "end": float(b)} for a in times for b in [*times[times > a], 1.2 * at.duration]),
    )


def constant_load(at: Setting) -> Candidate:
    """A load throughout, without the price of a step that is not there."""
    return Candidate(friction.AppliedLoad, (amplitude("load", 0.2 * at.friction / at.load_coefficient),))


def position_friction(at: Setting) -> Candidate:
    """A slope along the travel, and a wave of about its length."""
    stroke = max(at.high - at.low, 1e-4)
    return Candidate(
        friction.PositionFriction,
        (
            amplitude("slope", 0.2 / stroke),
            positive("period", 1.5 * stroke, 0.7),
            amplitude("cosine", 0.1),
            amplitude("sine", 0.1),
        ),
        tuple({"period": float(p), "neutral": 0.5 * (at.low + at.high)} for p in stroke * np.geomspace(0.2, 3.0, 12)),
    )


def viscous_drift(at: Setting) -> Candidate:
    """Friction that falls as oil warms up, within a log."""
    return Candidate(
        friction.ViscousDrift,
        (
            amplitude("viscous", 0.2),
            amplitude("coulomb", 0.05),
            positive("time_constant", 0.4 * at.duration, 0.8),
        ),
        grid(time_constant=at.duration * np.array([0.15, 0.4, 1.0])),
    )


def friction_dwell(at: Setting) -> Candidate:
    """A breakaway force that grows at rest; one that falls is none."""
    return Candidate(
        friction.FrictionDwell,
        (
            amplitude("growth", 0.5),
            positive("onset", 0.1, 0.7),
            positive("slip", 4.0 * at.bristle, 0.7),
            positive("rested", 0.3, 2.0, session=True),
        ),
        grid(rested=np.array([0.3]), onset=np.array([0.05, 0.2]), slip=at.bristle * np.array([1.0, 4.0, 16.0])),
        bounds=(("growth", 0.0, np.inf),),
    )


def presliding_hysteresis(at: Setting) -> Candidate:
    """There as a whole or not: what a small share of it does points the wrong way."""
    return Candidate(
        friction.PreslidingHysteresis,
        (
            positive("share", 1.0, 0.5),
            positive("longest", 3.0 * at.bristle, 0.8),
            positive("shortest", 0.2, 0.7),
        ),
        grid(longest=at.bristle * np.array([0.5, 1.0, 2.0, 4.0, 8.0]), shortest=np.array([0.1, 0.2, 0.4])),
        coupled=True,
        bounds=(("share", *WHOLE),),
    )


def constant_force(at: Setting) -> Candidate:
    """A tilted axis, or a counterbalance that is off: a tenth of the friction is usual."""
    return Candidate(forces.ConstantForce, (amplitude("force", 0.1 * at.friction),))


def position_spring(at: Setting) -> Candidate:
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


def cogging(at: Setting) -> Candidate:
    """That of a servo motor on a screw: a small share of the friction."""
    return _cogging_of(at, 0.04 * at.friction)


def strong_cogging(at: Setting) -> Candidate:
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
            *(amplitude(name, share * force, session=True) for name, share in zip(names, shares, strict=True)),
            positive("period", 1.5e-3, 0.7),
        ),
        grid(period=periods),
        bounds=(("period", 0.0, max(stroke, 2.0 * SHORTEST_COGGING)),),
    )


def process_force(at: Setting) -> Candidate:
    """A wave with a mean, for part of the log."""
    force = 0.04 * at.friction
    names = ("mean", "cosine", "sine", "cosine2", "sine2")
    return Candidate(
        forces.ProcessForce,
        (
            *(amplitude(name, force, session=True) for name in names),
            positive("frequency", 60.0, 1.2),
            Parameter("start", 0.3 * at.duration, 0.4 * at.duration, session=True),
            Parameter("end", 0.7 * at.duration, 0.4 * at.duration, session=True),
        ),
        ({"start": 0.25 * at.duration, "end": 0.75 * at.duration},),
    )


def frame_vibration(at: Setting) -> Candidate:
    """A base that swings at any frequency from 4 Hz up to what the log shows."""
    top = 0.2 / at.period
    return Candidate(
        forces.FrameVibration,
        (amplitude("ratio", 0.1), positive("frequency", 25.0, 0.8), positive("damping", 0.03, 0.8)),
        grid(frequency=np.geomspace(4.0, min(150.0, top), 40), damping=np.array([0.03])),
        narrow="frequency",
        bounds=(("ratio", 0.0, np.inf), ("damping", 0.0, MUFFLED)),
        coupled=True,
    )


def compliance(at: Setting) -> Candidate:
    """Its resonance is one that a log of that rate shows."""
    return Candidate(
        transmission.Compliance,
        (
            positive("frequency", 250.0, 0.8),
            positive("damping", 0.03, 0.8),
            _share("motor_share", 0.4, 0.5),
            _share("table_friction", 0.5, 1.0),
        ),
        coupled=True,
        searched=True,
        weakens=True,
        bounds=(("frequency", 0.0, SHOWN / at.period), ("damping", 0.0, MUFFLED), ("motor_share", *MOTOR)),
    )


def backlash(at: Setting) -> Candidate:
    """A play of micrometres in a screw that is elastic."""
    return Candidate(
        transmission.Backlash,
        (
            positive("gap", 5.6e-6, 1.25),
            positive("frequency", 400.0, 0.6),
            positive("damping", 0.08, 0.6),
            _share("motor_share", 0.4, 0.5),
            _share("table_friction", 0.5, 1.0),
        ),
        coupled=True,
        searched=True,
        bare=TIGHT,
        bounds=(("gap", TIGHT, np.inf), ("damping", 0.0, MUFFLED), ("motor_share", *MOTOR)),
    )


def force_gain(at: Setting) -> Candidate:
    """A force constant that is off: 15 % are usual."""
    return Candidate(actuator.ForceGain, (amplitude("gain", 0.15),))


def force_limit(at: Setting) -> Candidate:
    """One that no command of the log reaches limits nothing."""
    return Candidate(
        actuator.ForceLimit,
        (positive("limit", 0.8 * at.peak, 0.3),),
        grid(limit=at.peak * np.r_[np.linspace(0.995, 0.96, 8), 0.94, 0.92, 0.9, 0.87, 0.8, 0.7, 0.6, 0.5]),
        weakens=True,
        bounds=(("limit", 0.0, at.peak),),
    )


def actuator_lag(at: Setting) -> Candidate:
    """A current loop slower than the drive file says."""
    return Candidate(
        actuator.ActuatorLag,
        (positive("time_constant", 8e-4, 0.8),),
        grid(time_constant=np.array([2e-4, 5e-4, 1.2e-3, 3e-3])),
    )


def loop_delay(at: Setting) -> Candidate:
    """More or less of a delay than the drive file states."""
    less = [-at.delay, -0.5 * at.delay] if at.delay else []
    return Candidate(
        actuator.LoopDelay, (Parameter("delay", 0.0, 1.5),), grid(delay=np.array([0.4, 1.1, 2.1, 4.1, *less]))
    )


def lead_error(at: Setting) -> Candidate:
    """Its wave is larger than what the counts' staircase passes for, as that of a signal period."""
    return Candidate(
        scale.LeadError,
        (
            amplitude("cosine", 3e-6, session=True),
            amplitude("sine", 3e-6, session=True),
            amplitude("linear", 5e-5),
            positive("lead", 6e-3, 0.4),
        ),
        grid(lead=1e-3 * np.array([2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0])),
        least=STAIRS * at.count,
    )


def interpolation_error(at: Setting) -> Candidate:
    """A signal period is longer than the counts that it is divided into, and its error larger than theirs.

    A staircase swings by a count over pi about its slope, once a count; met at even distances it passes for a longer
    wave (its alias).
    """
    names, finest = ("cosine", "sine", "cosine2", "sine2"), DIVIDED * at.count
    periods = 1e-6 * np.array([2.0, 4.0, 8.0, 10.0, 16.0, 20.0, 40.0, 80.0, 100.0])
    return Candidate(
        scale.InterpolationError,
        (
            *(amplitude(name, share * 2e-7, session=True) for name, share in zip(names, (1, 1, 0.3, 0.3), strict=True)),
            positive("period", 2e-5, 0.5),
        ),
        grid(period=periods[periods >= finest] if finest <= periods[-1] else finest * np.array([2.0, 4.0, 20.0])),
        bounds=(("period", finest, np.inf),),
        least=STAIRS * at.count,
    )
