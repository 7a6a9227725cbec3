"""A diagnosis as diagnosis.json holds it: numbers with their units in their names, and what they say in words."""

import dataclasses
from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.model.quantity import Directional
from diffdrive.results import as_json as plain
from diffdrive.support.spans import format_span
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.fits.goodness_of_fit import comparable_parameters, max_prior_deviation
from tuning.diagnosis.fits.intervals import deviations, parameters
from tuning.diagnosis.gap.dependence_words import dependence_says, dependences_say
from tuning.diagnosis.hypotheses.calibration import DELAY, FORCE, LOGARITHMS, NAMES
from tuning.diagnosis.hypotheses.model import Logged
from tuning.diagnosis.judgement.held_out import HIDDEN, gap_reduction
from tuning.diagnosis.judgement.ladder import ModelComparison, known_floor
from tuning.diagnosis.judgement.verdict import Belief
from tuning.diagnosis.levels import STRAINED
from tuning.diagnosis.limits.limit_words import limit_says, limits_say, rivalry_says
from tuning.diagnosis.next_experiment import Experiment
from tuning.identification.estimates import NORMAL

NOT_NOTHING = 5e-4  # of confidence: what has less has no rivals that anyone would ask for
TOO_FAR = (
    "The drive file is too far from the logs to compute the missing force: the filter loses track. "
    "Check units and signs"
)


def as_json(found: Diagnosis, offer: Experiment) -> dict[str, Any]:
    """The diagnosis as diagnosis.json holds it: numbers, and null where one is infinite or undefined."""
    nominal, recalibrated, last = found.comparisons[0], found.comparisons[1], found.comparisons[-1]
    document = {
        "verdict": found.verdict.verdict,
        "says": found.verdict.says,
        "unexplained": found.verdict.unexplained,
        "gap": {
            "says": _size(found) + (f"; {found.laps.says}" if found.laps else ""),
            "position_rms_m": _in_loop(nominal, "position_rms"),
            "command_rms_N": _in_loop(nominal, "command_rms"),
            "force_rms_N": _force(nominal),
            "force_interval_N": _span(nominal),
            "noise_floor_position_m": _in_loop(last, "position_floor"),
            "noise_floor_command_N": _in_loop(last, "command_floor"),
            "noise_floor_force_N": found.floor,
            "recalibrated_position_rms_m": _in_loop(recalibrated, "position_rms"),
            "recalibrated_command_rms_N": _in_loop(recalibrated, "command_rms"),
            "recalibrated_force_rms_N": _force(recalibrated),
            "judged_on": found.split.says,
            "laps": found.laps and found.laps._asdict(),
        },
        "where": [one._asdict() for one in found.where],
        "causes": [cause(found, one) for one in found.verdict.beliefs],
        "recalibrated": list(_recalibrated(found)),
        "ladder": [_rung(found, one) for one in found.comparisons],
        "closed": _closed(found),
        "rest": found.rest and found.rest._asdict() | {"says": found.rest.says},
        "lacks": [one._asdict() for one in found.excitation_deficits],
        "detection_limits": [one._asdict() | {"says": limit_says(one)} for one in found.limits],
        "logs_would_show": limits_say(found.limits),
        "hardly_told_apart": [
            one.seen._asdict()
            | {"rival": one.rival, "share": one.share, "told_apart": one.isolable, "says": rivalry_says(one)}
            for one in found.alike
        ],
        "left": None if found.left is None else [one._asdict() | {"says": dependence_says(one)} for one in found.left],
        "left_looks_like": "" if found.left is None else dependences_say(found.left, "What is left"),
        "next_experiment": {key: value for key, value in offer._asdict().items() if key != "reference"},
    }
    return cast(dict[str, Any], plain(document))  # of a mapping, it is one


def _size(found: Diagnosis) -> str:
    """How large the gap is, in words."""
    (nominal, recalibrated), floor = (one.force for one in found.comparisons[:2]), found.floor
    if not recalibrated.is_known:
        return TOO_FAR
    after = f"after recalibration {recalibrated.rms:.3g} N RMS"
    if not nominal.is_known or floor is None:
        return f"{TOO_FAR}; {after}"
    (low, high), within = found.comparisons[0].interval, recalibrated.rms < HIDDEN * floor
    return (
        f"Missing force with the drive file: {nominal.rms:.3g} N RMS ({low:.3g} to {high:.3g}), "
        f"{nominal.rms / floor:.2g} times the noise floor of {floor:.3g} N; {after}, {'at' if within else 'above'} the "
        "floor"
    )


def _force(comparison: ModelComparison) -> float | None:
    """The missing force (N); None where it cannot be computed."""
    return comparison.force.rms if comparison.force.is_known else None


def _span(comparison: ModelComparison) -> tuple[float | None, float | None]:
    """Its interval (N)."""
    return comparison.interval if comparison.force.is_known else (None, None)


def _in_loop(comparison: ModelComparison, name: str) -> float | None:
    """A number of the simulation in closed loop; None where that could not be simulated."""
    return None if comparison.loop is None or comparison.loop.says else getattr(comparison.loop, name)


def cause(found: Diagnosis, belief: Belief) -> dict[str, Any]:
    """One effect as diagnosis.json holds it."""
    # what was found is to be as in augmented.toml: fitted together with everything else that was
    fitted = found.found if belief.found else belief.fitted
    names = [one.candidate.name for one in fitted.model.members]
    numbers = parameters(fitted, names.index(belief.effect))
    kind = EFFECTS[belief.effect]
    units = {field.name: field.metadata["quantity"].unit for field in dataclasses.fields(kind)}
    comparisons = {comparison.name: comparison for comparison in found.comparisons}
    comparison = comparisons.get(f"+ {belief.effect}") if belief.found else None
    before = found.comparisons[found.comparisons.index(comparison) - 1] if comparison else None
    return {
        "effect": belief.effect,
        "confidence": belief.confidence,
        "found": belief.found,
        "round": belief.round + 1,
        "evidence": belief.gain,
        "parameters": {name: value for name, (value, _) in numbers.items()},
        "intervals": {name: interval for name, (_, interval) in numbers.items()},
        "units": {name: units[name] for name in numbers},
        "gap_before": before and _force(before),
        "gap_after": comparison and _force(comparison),
        "held_out": comparison and before and _own_shrink(found, before, comparison),
        "indistinguishable_from": belief.alternatives if belief.found or belief.confidence >= NOT_NOTHING else [],
    }


def _own_shrink(found: Diagnosis, before: ModelComparison, after: ModelComparison) -> dict[str, object]:
    """What one effect takes off the gap beyond the floor that the model before it leaves; no share of nothing."""
    gone = gap_reduction(before, after, found.logged.sampling.rate)
    judged = {"judged_on": found.split.says}
    if gone is None or not after.force.is_known:
        return {"shrink": None, "interval": None, **judged}
    return {"shrink": gone.share, "interval": [gone.low, gone.high]} | judged


def _recalibrated(found: Diagnosis) -> Iterator[dict[str, object]]:
    """The nominal parameters as the drive file has them, recalibrated, and fitted together with what was found."""
    fits = {"recalibrated": found.explanation.base}
    if found.found.model.added:
        fits["with_effects"] = found.found
    spreads = {key: deviations(one) for key, one in fits.items()}
    movable = np.any(found.found.model.prior != 0.0, axis=1)
    for k, parameter in enumerate(NAMES):
        for name, nominal, unit in _nominal(found.logged, parameter) if movable[k] else ():
            row: dict[str, object] = {"parameter": name, "unit": unit, "drive_file": nominal}
            for key, one in fits.items():
                by = one.model.calibration(one.theta)[k] + NORMAL * spreads[key][k] * np.array([0.0, -1.0, 1.0])
                value, *interval = (nominal + by if k >= LOGARITHMS else nominal * np.exp(by)).tolist()
                row |= {key: value, f"{key}_interval": interval}
            yield row


def _nominal(logged: Logged, parameter: str) -> list[tuple[str, float, str]]:
    """Name, value and unit of a parameter of the calibration; both directions where it moves them together."""
    if parameter == DELAY:
        return [(parameter, float(logged.delay), "rows")]
    drive = logged.drive
    field, _, side = parameter.partition(".")
    owner = drive.plant if field in ("mass", FORCE) else drive.friction
    unit = next(one.metadata["quantity"].unit for one in dataclasses.fields(owner) if one.name == field)
    value = getattr(owner, field)
    if not isinstance(value, Directional):
        return [(parameter, float(value), unit)]
    ways = [side] if side else ["positive", "negative"]
    return [(f"{field}.{way}", float(getattr(value, way)), unit) for way in ways]


def _rung(found: Diagnosis, comparison: ModelComparison) -> dict[str, object]:
    shrink, *span = (
        comparison.shrink if comparison.force.is_known and found.comparisons[0].force.is_known else (None, None, None)
    )
    unknown = "not simulated in closed loop: the controller or the reference is not known"
    return {
        "model": comparison.name,
        "force_rms_N": _force(comparison),
        "force_interval_N": _span(comparison),
        "force_floor_N": known_floor(found.comparisons, comparison),
        "shrink": shrink,
        "shrink_interval": span,
        "position_rms_m": _in_loop(comparison, "position_rms"),
        "position_floor_m": _in_loop(comparison, "position_floor"),
        "command_rms_N": _in_loop(comparison, "command_rms"),
        "command_floor_N": _in_loop(comparison, "command_floor"),
        "loop_says": comparison.loop.says if comparison.loop else unknown,
        "deviance": comparison.deviance,
    }


def _closed(found: Diagnosis) -> dict[str, object]:
    """How much of the force's mean square that recalibration leaves beyond the floor is gone with what was found."""
    before, after, floor, gone = found.comparisons[1].force, found.comparisons[-1].force, found.floor, found.closed
    if len(found.comparisons) == 2:
        return {"share": None, "interval": None, "says": "No effect was added."}
    if not (before.is_known and after.is_known and floor is not None):
        lost = "the recalibrated drive" if after.is_known else "what was found"
        says = f"On {found.split.says}: the missing force is not computed, since the filter loses track with {lost}"
        return {"share": None, "interval": None, "says": says + _in_closed_loop(found)}
    alike = np.array_equal(found.comparisons[1].trusting, found.comparisons[-1].trusting)
    on = (
        f"On {found.split.says}: {before.rms:.3g} N recalibrated, {after.rms:.3g} N with what was found, the floor "
        f"{floor:.3g} N{'' if alike else ' (by a filter of its own that follows it)'}"
    )
    if gone is None:
        among = comparable_parameters(found.explanation.base, found.found)
        moved = max_prior_deviation(found.explanation.base, among)
        hides = (
            f"Recalibration hides the gap, but with a nominal parameter moved by {moved:.0f} standard deviations, "
            f"against {max_prior_deviation(found.found, among):.1f} with it"
        )
        says = f"{on}. {hides if moved >= STRAINED else 'Recalibration alone leaves nothing there to close'}"
        return {"share": None, "interval": None, "says": says + _in_closed_loop(found)}
    share, low, high = format_span((100.0 * gone.share, 100.0 * gone.low, 100.0 * gone.high))
    says = f"{on}: {share} % ({low} to {high}) of what was left beyond the floor is gone"
    return {"share": gone.share, "interval": [gone.low, gone.high], "says": says + _in_closed_loop(found)}


def _in_closed_loop(found: Diagnosis) -> str:
    """How far the simulation is off, in words: backlash shows where the table turns, the force only while it slides."""
    before, after = (
        _in_loop(comparison, "position_rms") for comparison in (found.comparisons[1], found.comparisons[-1])
    )
    floor = _in_loop(found.comparisons[-1], "position_floor")
    if before is None or after is None or floor is None:
        return ""
    off, left, least = (f"{1e6 * one:.3g} um" for one in (before, after, floor))
    return f". In closed loop the position is {off} off recalibrated, {left} with what was found, the floor {least}"
